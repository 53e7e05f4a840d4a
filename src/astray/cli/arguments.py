"""Options and output that several verbs share: agents, levels, knobs, actions, JSON."""

from __future__ import annotations

import inspect
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
from rich.console import Console, RenderableType
from tyro.conf import Positional, UseAppendAction, arg

from astray import games, imports, world
from astray.game import OWN, Game, Variant
from astray.level import Level
from astray.level_files import read_level
from astray.record import LEVELS
from astray.training.settings import KNOB, SHORT, otherwise
from astray.validation import AT_ONCE, bounded, command_of, of_kind, one_of
from astray.world import World

if TYPE_CHECKING:
    from astray.acting import Policy
    from astray.analysis.trained import Agent as Trained
    from astray.training.config import Config

MOST_WORKERS = 1024  # processes
WALK = "walk:"

Mode = Literal["sampled", "greedy"]
Preset = Literal["paper", "night", "small", "pixels"]
# Several after one --set, or one after each of several.
Words = tuple[tuple[str, ...], ...]

# Options of several verbs.
SET: Any = {"name": "set", "metavar": "NAME=VALUE"}
AN_AGENT = "Run folder, checkpoint in one, or name of a pretrained or imported agent."
Agent = Positional[Annotated[Path, arg(help=AN_AGENT)]]
Json = Annotated[bool, arg(help="Print the result as JSON.")]
Rewards = Annotated[
    tuple[str, ...],
    otherwise("none", "Rewards of your own, as module:function, to tell the mean returns of, too."),
]
Knobs = UseAppendAction[Annotated[Words, arg(**SET, help="Override a parameter of the variant.")]]
Settings = UseAppendAction[
    Annotated[
        Words, arg(**SET, help="Override a parameter of the variant, or a setting of the training.")
    ]
]
NUMBERS = "Level numbers and ranges, such as 5,17,100:200."
Shift = Annotated[
    str | None,
    otherwise(
        "the one that the agent was trained for",
        "Shift, which names the intended goal and its proxies.",
    ),
]
TestVariant = Annotated[
    str | None, otherwise("the test variant of the shift", "Variant that levels are drawn from.")
]
TrainingVariant = Annotated[
    str | None, otherwise("the variant of its training", "Variant that levels are drawn from.")
]
Longest = Annotated[
    int | None,
    otherwise(
        "none; needed if episodes can last forever", "Maximum number of steps of an episode."
    ),
]
Workers = Annotated[
    int | None,
    otherwise("one per processor", "Number of agents to train in parallel on this machine."),
]


@dataclass(frozen=True)
class Acting:
    """Options of the agent's observations and actions."""

    # Choice of actions: sample them from the policy, or take the most likely one.
    mode: Mode = "sampled"
    # Art that images are drawn with: own or original.
    art: Annotated[str | None, otherwise("the art of its training")] = None

    def open(self, agent: Path) -> tuple[Trained, Config]:
        """Return the agent of a run folder or a name, and the settings of its training."""
        from astray.analysis.runs import open_run

        return open_run(agent, self.mode, self.art)

    def check_seen(self, policy: Policy) -> None:
        """Raise ValueError for art of a policy that sees no images."""
        if self.art is not None and policy.observation != "image":
            raise ValueError(f"--art draws images; this policy sees {policy.observation} planes")


@dataclass(frozen=True)
class OwnPolicy:
    """Options of a policy that plays instead of an agent."""

    # Policy: random, walk:GOAL, or module:name, where the name is a policy, a function without
    # arguments that returns one, or a function from observations [N, ...] to actions [N].
    policy: Annotated[str | None, otherwise("none")] = None
    # Game that the policy plays; the lab also shows a game without a policy.
    game: Annotated[str | None, otherwise("that of the agent")] = None
    # World of your own that the policy plays or the agent was trained on, as module:WORLD.
    world: Annotated[str | None, otherwise("none")] = None
    # Kind of observations that the policy gets.
    observation: Annotated[
        Literal["image", "symbolic"] | None, otherwise("those of the agent; image for a policy")
    ] = None

    def named(self) -> World:
        """Return the world that --world names; raise ValueError if it is not a world."""
        found = imports.find(self.world or "")
        of_kind("--world", found, World)
        return found

    def rules(self) -> Game | World:
        """Return the policy's game or world; raise ValueError unless exactly one is given."""
        if (self.game is None) == (self.world is None):
            raise ValueError("a policy needs either --game or --world")
        return self.named() if self.game is None else games.find(self.game)

    def check_game(self, verb: str) -> None:
        """Raise ValueError for a world, whose environments cannot be set to a state."""
        if self.world is not None:
            raise ValueError(
                f"astray {verb} sets states, which environments of a World do not let it: it takes "
                "--game; evaluate, record, agency, export and audit take --world"
            )

    def open(
        self, agents: Any, acting: Acting, needs: Mapping[str, Any]
    ) -> tuple[Policy, Any, Config | None]:
        """Return the first agent, or this policy instead, its game or world, and its settings.

        Raises:
            ValueError: As `replaces` does.
        """
        if self.replaces(agents, needs):
            return self.make(acting, rules := world.find(self.rules())), rules, None
        player, config = acting.open(agents if isinstance(agents, Path) else agents[0])
        return player, config.find_game(), config

    def replaces(self, agents: Any, needs: Mapping[str, Any]) -> bool:
        """Return whether there is a policy, which plays in the place of `agents`.

        The world that agents were trained on is registered, so that their runs can be opened.

        Raises:
            ValueError: If neither or both are given, a policy without one of the options that it
                `needs`, or agents with other options of a policy or a world that is not theirs.
        """
        if self.policy is not None:
            if agents:
                raise ValueError(f"--policy {self.policy} replaces an agent: give one of them")
            for option in (option for option, given in needs.items() if not given):
                there = getattr(self.rules(), f"{option.removeprefix('--')}s")
                if option != "--shift" or len(there) != 1:
                    raise ValueError(f"--policy needs {option}; there are: {', '.join(there)}")
            return True
        agents = [agents] if isinstance(agents, Path) else agents
        for name in ("game", "observation"):
            if (given := getattr(self, name)) is not None:
                raise ValueError(f"--{name} {given} needs --policy; a run says which it has")
        if not agents:
            raise ValueError("name an agent or a run folder, or give a --policy")
        for own in filter(imports.is_name, map(str, agents)):
            raise ValueError(f"unknown agent {own!r}; a policy is named as --policy {own}")
        if self.world is not None:
            from astray.training.folders import AgentFolder

            world.register(named := self.named())
            for agent in agents:
                if (its := AgentFolder.open(agent).config().game) != named.name:
                    raise ValueError(f"{agent} plays {its}, and --world {self.world} is another")
        return False

    def make(self, acting: Acting, rules: Game | World) -> Policy:
        """Return the policy; raise ValueError if the name, or a walk's goal, is unknown."""
        from astray.analysis.adapters import Function
        from astray.analysis.policies import Random, Walk

        assert self.policy is not None
        if acting.mode != "sampled":
            raise ValueError(f"a --policy chooses by itself; it has no mode {acting.mode!r}")
        seen, art = self.observation or "image", OWN if acting.art is None else acting.art
        if self.policy == "random":
            return Random(observation=seen, art=art)
        if self.policy.startswith(WALK):
            one_of("goal", goal := self.policy.removeprefix(WALK), rules.walked)
            return Walk(goal, seen, art)
        if not imports.is_name(self.policy):
            one_of("policy", self.policy, ("random", f"{WALK}GOAL", "module:name"))
        found = imports.find(self.policy)
        if _takes_nothing(found):
            found = found()
        return found if hasattr(found, "actions") else Function(found, self.policy, seen, art)


def _takes_nothing(function: Any) -> bool:
    """Whether it is a function, or a class, that is called without arguments."""
    try:
        return not hasattr(function, "actions") and not inspect.signature(function).parameters
    except (TypeError, ValueError):  # nothing to call, or compiled
        return False


@dataclass(frozen=True)
class Player:
    """An agent, or a policy in its place, and the variant that it plays."""

    agent: Positional[Annotated[Path | None, otherwise("none", AN_AGENT)]] = None
    variant: TrainingVariant = None
    knobs: Knobs = ()
    acting: Acting = Acting()
    policy: OwnPolicy = OwnPolicy()

    def open(self) -> tuple[Policy, Any, Any, Config | None]:
        """Return the policy, its game or world, the variant, and the agent's settings.

        Raises:
            ValueError: If no agent and no policy is named, or both are.
        """
        needs = {"--variant": self.variant}
        player, rules, config = self.policy.open(self.agent, self.acting, needs)
        of = config.variant if self.variant is None else self.variant  # pyrefly: ignore
        return player, rules, played(rules, of, self.knobs, config), config


def played(rules: Any, variant: str, knobs: Words, config: Config | None = None) -> Any:
    """Return a variant with knobs set, and with those of an agent's training."""
    if config:
        return config.played_variant(variant, pairs(knobs))
    return rules.variant(variant).with_knobs(pairs(knobs))


@dataclass(frozen=True)
class Tested:
    """The variant and the goals that agents are tested with, and how they act."""

    variant: TestVariant = None
    shift: Shift = None
    knobs: Knobs = ()
    acting: Acting = Acting()

    def words(self) -> dict[str, Any]:
        """Return these options as keyword arguments of the functions that test agents."""
        others = {"variant": self.variant, "shift": self.shift, "knobs": pairs(self.knobs)}
        return vars(self.acting) | others


@dataclass(frozen=True)
class TestedPlayer:
    """An agent, or a policy in its place, and the variant and goals that it is tested with."""

    agent: Positional[Annotated[Path | None, otherwise("none", AN_AGENT)]] = None
    tested: Tested = Tested()
    policy: OwnPolicy = OwnPolicy()

    @property
    def words(self) -> str:
        """The agent or the policy, as given on the command line."""
        if self.agent:
            return command_of(str(self.agent))
        return command_of("--policy", str(self.policy.policy), "--game", str(self.policy.game))

    def open(self) -> tuple[Policy, Any, str, Any, str, Config | None]:
        """Return policy, game or world, the variant's name, the variant, shift and settings.

        Raises:
            ValueError: If no agent and no policy is named, or both are, or a policy has no shift.
        """
        from astray.analysis.outcomes import load_shift
        from astray.analysis.runs import shift_of

        tested = self.tested
        needs = {"--shift": tested.shift}
        player, rules, config = self.policy.open(self.agent, tested.acting, needs)
        shift = shift_of(config, rules) if tested.shift is None else tested.shift
        name = load_shift(rules, shift).test if tested.variant is None else tested.variant
        return player, rules, name, played(rules, name, tested.knobs, config), shift, config


@dataclass(frozen=True)
class Drawn:
    """Game, variant and its knobs."""

    game: Positional[str]  # Name of the game.
    variant: Positional[str]  # Name of the variant that levels are drawn from.
    knobs: Knobs = ()

    def open(self) -> tuple[Game, Variant]:
        """Return the game, and the variant with its knobs set."""
        rules = games.find(self.game)
        return rules, played(rules, self.variant, self.knobs)


@dataclass(frozen=True)
class GivenLevel:
    """A level, by its number or in a file."""

    # Number of the level.
    level: Annotated[int | None, otherwise("chosen by the command")] = None
    # File that holds the level, in the format that `astray level` prints.
    level_file: Annotated[Path | None, otherwise("none")] = None

    def find(self, game: Game, variant: Variant, solvable: bool = False) -> int | Level | None:
        """Return the level given by number or file, or None; raise ValueError for several."""
        self.check()
        if self.level_file is None:
            return self.level
        return read_level(self.level_file, game, variant, solvable=solvable)

    def check(self) -> None:
        """Raise ValueError if the number is not a level's, or a file is given too."""
        if self.level is not None:
            bounded("level", self.level, LEVELS.start, LEVELS.stop - 1)
            if self.level_file is not None:
                raise ValueError("a level is given by its number or in a file, not both")


@dataclass(frozen=True)
class PlayedLevel(GivenLevel):
    """A level that is played, by its number or in a file."""

    # Accept a level from a file whose objects cannot be reached.
    unsolvable: bool = False

    def begun(self, game: Game, variant: Variant) -> int | Level | None:
        """Return the given level; raise ValueError if its objects must be, and are not, reached."""
        if self.unsolvable and self.level_file is None:
            raise ValueError("--unsolvable goes with --level-file")
        return self.find(game, variant, solvable=not self.unsolvable)


def level_numbers(text: str) -> np.ndarray:
    """Parse level numbers like 5,17,100:200 to [N] int64; raise ValueError if they are invalid."""
    spans = []
    try:
        for part in text.split(","):
            first, colon, after = part.partition(":")
            spans.append(range(int(first), int(after) if colon else int(first) + 1))
    except ValueError:
        raise ValueError(f"levels are numbers and ranges as 5,17,100:200; got {text!r}") from None
    if not all(spans):
        raise ValueError(f"a range of levels must have some, as 5:6 has one; got {text!r}")
    if any(s[0] < 0 or s[-1] >= LEVELS.stop for s in spans):
        raise ValueError(f"levels must be numbers from 0 to {LEVELS.stop - 1}; got {text!r}")
    count = sum(map(len, spans))
    if count > AT_ONCE:
        raise ValueError(f"{count} levels are given; at most {AT_ONCE} are taken at once")
    return np.concatenate([np.arange(span.start, span.stop) for span in spans])


def pairs(knobs: Words) -> dict[str, Any]:
    """Parse NAME=VALUE pairs into text by name; `variant.NAME` is NAME.

    Raises:
        ValueError: If a knob has no value, or two.
    """
    found: dict[str, Any] = {}
    for knob in (knob for together in knobs for knob in together or ("",)):
        name, equals, value = knob.partition("=")
        name = SHORT.get(name, name).removeprefix(KNOB)
        if not equals:
            raise ValueError(f"a knob must be set as NAME=VALUE; got {knob!r}")
        if name in found:
            raise ValueError(f"knob {name!r} is set twice: to {found[name]!r} and to {value!r}")
        found[name] = value
    return found


def show(*what: RenderableType, width: int | None = None) -> None:
    """Print tables and markup, as wide as the terminal or `width` characters."""
    console = Console(width=width)
    with console.capture() as shown:  # rich ends the process by itself where nobody reads
        for one in what:
            console.print(one)
    print(shown.get(), end="")


def print_json(data: Any) -> None:
    print(json.dumps(data))
