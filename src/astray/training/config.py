"""The settings of a training."""

from __future__ import annotations

import contextlib
import itertools
import json
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING, Annotated, Any, Literal

from tyro.conf import Positional, Suppress

from astray import imports, world
from astray.agents.names import check_network
from astray.game import OWN, Game, Variant
from astray.record import LEVELS
from astray.training.named import name_of_variant, same_levels, stored
from astray.training.settings import SCORING, Fast, Sampling, check, otherwise
from astray.validation import of_kind, one_of, shown
from astray.world import World

if TYPE_CHECKING:
    Named = Any  # a name, or the thing that has it; the settings hold the name
else:
    Named = str
SOLVER = "solver"  # the teacher that is no agent
Device = Literal["cpu", "cuda", "mps"]
Tracking = Literal["wandb", "trackio"]  # where else a training's metrics go
MACHINE = ("device", "threads")  # settings that may differ when a training is resumed
RECORDS = {"sampler": Sampling, "fast": Fast}  # settings that hold several


class LeftOut(UserWarning):
    """Warning that test levels lack some knobs of the training."""


@dataclass(frozen=True)
class Config:
    """Settings of a training by PPO. The defaults are those of the preset `small`.

    `PRESETS` has others, such as `replace(PRESETS["paper"], game="maze", variant="corner")`. Where
    the paper's text and code differ, that preset follows the code: minibatches of 8,192 (the text:
    2,048 for each of 4 workers), a learning rate annealed linearly to 0, and rewards normalised
    with a discount of their own. One departure: an episode cut by the time limit is bootstrapped;
    `timeouts="terminate"` is the original's treatment.

    A `Game`, a `Variant` and the name of a sampler are accepted too. The settings then store names
    and changed knobs, and a `Sampling` of that kind. A `World`, or its name as module:WORLD, is
    registered and stored by its own name.

    Examples:
        >>> config = astray.Config("maze", "corner-small", levels=1000)
        >>> config.batch, config.milestones[0]
        (16384, 21484)

    Raises:
        ValueError: If a setting has another type, is out of its bounds, or contradicts others.
    """

    game: Positional[Named] = "maze"  # Name of the game, or a World of your own as module:WORLD.
    variant: Positional[Named] = "corner"  # Name of the variant to train on.
    # Changed knobs of the variant.
    knobs: Annotated[dict[str, Any], Suppress] = field(default_factory=dict)
    # Variant that is played during training without learning from it.
    validation: Annotated[Named | None, otherwise("none")] = None
    first_level: int = 0  # Number of the first training level.
    levels: int = 100_000  # Number of training levels; validation draws from the rest.
    seed: int = 0  # Seed of the weights, the order of levels and all actions.

    sampler: Sampling = Sampling()  # Sampler of training levels.

    # Observations of the agent: images, or symbolic planes.
    observation: Literal["image", "symbolic"] = "symbolic"
    # Art that images are drawn with: own, or original after `astray art import`.
    art: str = OWN
    # Network: mlp for symbols; impala, patch or another for images; or your own as module:Class.
    network: str = "mlp"
    scale: int = 1  # Factor of the channels of convolutions; 4 in the paper's sweeps.
    width: int = 256  # Number of hidden units of the mlp.

    steps: int = 5_500_000  # Total number of environment steps, in whole rollouts.
    num_envs: int = 256  # Number of parallel environments.
    num_steps: int = 64  # Number of steps per environment between updates.
    epochs: int = 3  # Number of passes over each rollout.
    minibatches: int = 16  # Number of minibatches per pass.
    gamma: float = 0.98  # Discount of rewards.
    lam: float = 0.95  # Lambda of generalised advantage estimation (GAE).
    learning_rate: float = 5e-4  # Initial learning rate of Adam.
    anneal: bool = True  # Anneal the learning rate linearly to 0.
    # Clip range of the probability ratio, and of the value (in normalised rewards).
    clip: float = 0.2
    value_weight: float = 0.5  # Weight of the value loss.
    entropy_weight: float = 0.003  # Weight of the entropy bonus.
    gradient_norm: float = 0.5  # Maximum gradient norm over all parameters.
    normalise_reward: bool = True  # Divide rewards by the standard deviation of discounted returns.
    # Discount of the returns used to normalise rewards.
    reward_gamma: float = 0.99
    normalise_advantage: bool = True  # Normalise advantages over the whole rollout.
    # Treatment of episodes that the time limit truncates: bootstrap the value, or terminate.
    timeouts: Literal["bootstrap", "terminate"] = "bootstrap"
    # Reward function of your own that replaces the game's, as module:function: see `loop.train`.
    reward: Annotated[str | None, otherwise("the game's")] = None
    # Loss function of your own, as module:function.
    loss: Annotated[str | None, otherwise("PPO's")] = None
    # Agent to distil from, by name, or "solver" for the game's exact solver.
    teacher: Annotated[str | None, otherwise("none")] = None
    # Fraction of the steps that learn from the teacher; later steps learn from rewards.
    taught: float = 1.0
    # Levels of lessons: whole episodes, or new ones in every rollout, begun anywhere in them.
    lessons: Literal["episodes", "anywhere"] = "episodes"
    # Initial learning rate of lessons, annealed within them; learning_rate begins after them.
    lesson_rate: Annotated[float | None, otherwise("one learning_rate for all steps")] = None
    # Agent, by name or folder, with whose weights the training begins.
    start: Annotated[str | None, otherwise("new weights")] = None

    validation_every: int = 10  # Number of iterations between validations.
    checkpoint_every: int = 50  # Number of iterations between checkpoints.
    device: Device = "cpu"  # Device of the network.
    threads: int = 1  # Number of threads for environments and, on a CPU, for torch.

    fast: Fast = Fast()  # Acceleration.

    def __post_init__(self) -> None:
        self._take_objects()
        check(self)
        if self.batch % self.minibatches:
            raise ValueError(
                f"{self.num_envs} environments x {self.num_steps} steps = {self.batch} samples "
                f"are not divided by {self.minibatches} minibatches"
            )
        if self.batch < 2:
            told = "2 samples, by whose spread advantages are normalised; got 1 of 1 environment"
            raise ValueError(f"a rollout must have {told}")
        if self.fast.groups and self.num_envs % self.fast.groups:
            raise ValueError(
                f"{self.num_envs} environments are not divided into {self.fast.groups} groups"
            )
        if self.training_levels.stop >= LEVELS.stop:
            raise ValueError(
                f"training levels must be below {LEVELS.stop - 1}, as some are left for tests; "
                f"got {self.first_level} to {self.training_levels.stop - 1}"
            )
        check_network(self.network)
        for name in ("taught", "lessons", "lesson_rate"):
            usual, given = getattr(Config, name), getattr(self, name)
            if self.teacher is None and given != usual:
                raise ValueError(f"{name} must be {usual} without a teacher; got {given}")
        if self.lessons == "anywhere":
            self.find_game().places.put  # noqa: B018  # says that there is none
        if self.teacher == SOLVER:
            self.find_game().solver.expert  # noqa: B018  # says that there is none
            self.intended_goal()
        if self.teacher is not None and self.sampler.kind in SCORING:
            raise ValueError(
                f"a student needs a sampler that does not score levels; got {self.sampler.kind!r}"
            )
        if self.teacher is not None and (self.fast.groups or 1) > 1:
            raise ValueError(
                f"a student must have one group of environments; got {self.fast.groups} groups"
            )
        for name in ("loss", "reward"):
            given = getattr(self, name)
            if given is not None and not imports.is_name(given):
                raise ValueError(f"{name} must be module:function; got {given!r}")
        variant = self.training_variant()
        # What text says is the same setting as the value itself.
        object.__setattr__(self, "knobs", {name: getattr(variant, name) for name in self.knobs})
        for name, value in self.knobs.items():  # of a World they may be anything
            with contextlib.suppress(TypeError, ValueError):
                if json.loads(json.dumps(value)) == value:
                    continue
            told = "what a file of JSON gives back: numbers, text, lists, or dictionaries by text"
            raise ValueError(f"the knob {name!r} of a training must be {told}; got {shown(value)}")
        self.find_game().drawn(self.art)
        how = self.sampler.kind, self.teacher
        if self.reward is not None and self.sampler.score == "regret" and how[0] in SCORING:
            raise ValueError(f"score 'regret' needs the game's own reward; got {self.reward!r}")
        if isinstance(self.find_game(), World) and how != ("uniform", None):
            raise ValueError(
                f"levels of {self.game} are drawn uniformly, and no agent teaches there, as its "
                f"states cannot be set; got the sampler {how[0]!r} and the teacher {how[1]}"
            )
        if self.validation is not None:
            self.variant_for(self.validation)

    def _take_objects(self) -> None:
        """Replace objects by the names, knobs and records that stand for them."""
        given = stored(self.game, self.variant, self.knobs)
        if isinstance(self.sampler, str):
            given["sampler"] = Sampling(self.sampler)
        for name, value in given.items():
            object.__setattr__(self, name, value)
        if isinstance(self.validation, Variant):
            name, _ = name_of_variant(self.find_game(), self.validation)
            if self.variant_for(name) != self.validation:
                raise ValueError(
                    f"validation is the variant {name} with other knobs than the training's; "
                    "register the game with a variant of its own for it"
                )
            object.__setattr__(self, "validation", name)

    @property
    def batch(self) -> int:
        """Number of samples per iteration."""
        return self.num_envs * self.num_steps

    @property
    def learns_values_of_teacher(self) -> bool:
        """Return whether its values are a teaching agent's, in the unit of that agent's rewards."""
        return self.teacher not in (None, SOLVER) and self.taught == 1

    @property
    def caveat(self) -> str:
        """Return a sentence on what its values are of, if not of the game's rewards; else ""."""
        told = f"Its values are of the reward {self.reward}; advantages mix them with the game's."
        return told if self.reward else ""

    @property
    def iterations(self) -> int:
        return -(-self.steps // self.batch)

    @property
    def milestones(self) -> list[int]:
        """Steps at which agents are kept: doubling at first, then every tenth of the training."""
        return [self.steps >> k for k in range(8, 3, -1)] + [
            self.steps * k // 10 for k in range(1, 11)
        ]

    def rate(self, steps: int) -> float:
        """Return the learning rate after `steps` environment steps."""
        lessons = 0 if self.lesson_rate is None else self.taught * self.steps
        first, begun, end = self.learning_rate, lessons, self.steps
        if steps < lessons:
            first, begun, end = self.lesson_rate or 0.0, 0, lessons
        return first * (1 - (steps - begun) / (end - begun) if self.anneal else 1)

    @property
    def training_levels(self) -> range:
        return range(self.first_level, self.first_level + self.levels)

    @property
    def unseen_levels(self) -> range:
        """All level numbers after the training levels."""
        return range(self.training_levels.stop, LEVELS.stop)

    @property
    def sizes(self) -> dict[str, Any]:
        """The fields of an agent's `Architecture` that are settings."""
        return {"name": self.network, "scale": self.scale, "width": self.width}

    def find_game(self) -> Game:
        """Return the game or, typed as a game, the `World` that is played."""
        return world.find(self.game)

    def custom(self) -> dict[str, Any]:
        """Import the user's own objects that settings name; return them by setting.

        Raises:
            ValueError: If one does not exist, or cannot be called.
        """
        named = {"network": self.network, "loss": self.loss, "reward": self.reward}
        named |= {"sampler": self.sampler.kind}
        return {n: imports.find(x, True) for n, x in named.items() if x and imports.is_name(x)}

    def code(self) -> list[object]:
        """Return the code that such agents depend on: the game, and the user's own objects."""
        return [self.find_game(), *self.custom().values()]

    def training_variant(self) -> Variant:
        """Return the variant to train on."""
        return self.variant_for(self.variant)

    def intended_goal(self) -> str:
        """Return the intended goal of the training variant's shifts, or else of the validation's.

        Goals that are no events, such as "more right than wrong", have no way to them.

        Raises:
            ValueError: If no shift of the game has either variant.
        """
        game = self.find_game()
        shifts = [shift for shift in game.shifts.values() if shift.intended in game.event_goals]
        for variant, shift in itertools.product((self.variant, self.validation), shifts):
            if variant in (shift.train, shift.test):
                return shift.intended
        none = f"none in {game.name}" + ", whose goals no event shows" * bool(game.shifts)
        known = ", ".join(dict.fromkeys(shift.train for shift in shifts)) or none
        raise ValueError(
            "score 'regret' and a solver as teacher need a variant of a shift, which names the "
            f"goal; got {self.variant!r}, and there are: {known}"
        )

    def variant_for(
        self, variant: str | Variant, changes: Mapping[str, Any] | None = None
    ) -> Variant:
        """Return a variant for these agents, with further `changes` of its knobs.

        A variant given by name also takes the knobs that were changed in training, if both variants
        agreed in them before. Knobs that it cannot have are dropped, such as a region where cheese
        is anywhere: see `left_out`.

        Raises:
            ValueError: If it cannot have `changes`.
        """
        of_kind("knobs", changes or {}, Mapping)
        if isinstance(variant, str):
            changes = self.knobs_for(variant, changes or {})
        return self.find_game().variant(variant).with_knobs(changes or {})

    def played_variant(
        self, variant: str | Variant, changes: Mapping[str, Any] | None = None
    ) -> Variant:
        """Return the result of `variant_for`, and warn of the training's dropped knobs."""
        made = self.variant_for(variant, changes)
        if left := self.left_out(variant, changes or {}):
            told = ", ".join(f"{name}={value}" for name, value in left.items())
            own = ", ".join(f"{name}={getattr(made, name, None)}" for name in left)
            name = variant if isinstance(variant, str) else made.about
            warnings.warn(
                f"{name} is played with {own}: the training's {told} are not for it",
                LeftOut,
                stacklevel=3,
            )
        return made

    def left_out(self, variant: str | Variant, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return the training's knobs that `variant_for` drops."""
        made = self.variant_for(variant, changes)
        return {
            name: value
            for name, value in self.knobs.items()
            if name not in changes and getattr(made, name, None) != value
        }

    def knobs_for(self, name: str, changes: Mapping[str, Any]) -> dict[str, Any]:
        """Return `changes` and those of the training's knobs that are compatible with them."""
        if name == self.variant:
            return {**self.knobs, **changes}
        game = self.find_game()
        other = game.variant(name)
        kept = game.variant(self.variant).alike(self.knobs, other)
        for count in range(len(kept), 0, -1):
            for some in itertools.combinations(kept.items(), count):
                with contextlib.suppress(ValueError):
                    other.with_knobs({**dict(some), **changes})
                    return {**dict(some), **changes}
        return dict(changes)

    @staticmethod
    def names() -> list[str]:
        """Return the names of all settings, including those in nested records."""
        return list(SMALL.flat())

    def flat(self) -> dict[str, Any]:
        """Return all settings by name in one flat mapping, as in files and tables."""
        found: dict[str, Any] = {}
        for one in fields(self):
            value = getattr(self, one.name)
            if one.name in RECORDS:
                values = vars(value)
                found |= {one.name if name == "kind" else name: values[name] for name in values}
            else:
                found[one.name] = dict(value) if one.name == "knobs" else value
        return found

    def identity(self) -> dict[str, Any]:
        """Return the settings that a resumed training must share: all but those of a machine."""
        own = {*MACHINE, *vars(self.fast)}
        return {name: value for name, value in self.to_json().items() if name not in own}

    def changed(self, **settings: Any) -> Config:
        """Return the settings with some changed, by their names in `flat`.

        Raises:
            ValueError: If there is no such setting, or the value is invalid.
        """
        own = {f.name for f in fields(self)} - set(RECORDS)
        values = {name: value for name, value in settings.items() if name in own}
        for name, kind in RECORDS.items():
            words = {"kind" if n == name else n: v for n, v in settings.items() if n not in own}
            values[name] = replace(
                getattr(self, name),
                **{f.name: words[f.name] for f in fields(kind) if f.name in words},
            )
        for name in settings:
            one_of("setting", name, self.names())
        return replace(self, **values)

    def to_json(self) -> dict[str, Any]:
        """Return all settings, with the variant written out."""
        return self.flat() | {"training_variant": self.training_variant().to_json()}

    @staticmethod
    def from_json(data: Any) -> Config:
        """Return the settings that `to_json` wrote, also in older versions.

        Raises:
            ValueError: If they are invalid or of a later version.
        """
        if not isinstance(data, dict):
            raise ValueError(f"settings must be an object; got {shown(data)}")
        values: dict[str, Any] = {k: v for k, v in data.items() if k != "training_variant"}
        world.find(values.get("game", SMALL.game))  # a file has nothing imported
        unknown = [name for name in values if name not in Config.names()]
        if unknown:
            raise ValueError(f"this version has no setting {unknown[0]!r}; a later one may")
        config = PRESETS["paper"].changed(**values)  # which older versions had as defaults
        now = config.training_variant()
        told = data.get("training_variant")
        if told is not None and not same_levels(told, now):
            raise ValueError(f"its {config.game} {config.variant} is not that of this version")
        return config


# For a CPU. One thread a run is steadier than two, and two runs at once do more than one with two
# threads. Many small updates of a wide network learned more in the same minutes than few large
# ones or convolutions.
SMALL = Config()
PAPER = replace(
    SMALL,
    observation="image",
    network="impala",
    width=64,
    steps=200_000_000,
    num_steps=256,
    minibatches=8,  # of 256 x 256 / 8 = 8,192 samples
    gamma=0.999,
    entropy_weight=0.01,
    validation_every=1,
    checkpoint_every=25,
)
PRESETS = {
    "paper": PAPER,
    # The paper's worlds on a core, overnight: a network of few products, and long rollouts.
    "night": replace(
        PAPER,
        network="patch-impala",
        steps=40_000_000,
        num_steps=64,
        epochs=2,
        minibatches=16,
        entropy_weight=0.003,  # with the paper's 0.01, runners learned to wait
        validation_every=40,
        checkpoint_every=20,
    ),
    "small": SMALL,
    # The paper's images, by a network of few products; updates are as large as they need be, and
    # four times as many: mice learn from half the steps.
    "pixels": replace(
        SMALL,
        observation="image",
        network="patch",
        steps=4_000_000,
        num_envs=64,
        validation_every=40,
        checkpoint_every=200,
    ),
}
