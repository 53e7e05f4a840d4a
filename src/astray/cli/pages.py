"""Verbs that write pages: explain or audit one agent, compare several."""

import sys
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from tyro.conf import Positional, arg

from astray import imports
from astray.cli.arguments import (
    AN_AGENT,
    NUMBERS,
    Acting,
    GivenLevel,
    Knobs,
    Longest,
    OwnPolicy,
    Rewards,
    Shift,
    Tested,
    TestedPlayer,
    level_numbers,
    pairs,
    played,
)
from astray.files import check_free, check_writable
from astray.training.folders import AgentFolder, names
from astray.training.settings import otherwise
from astray.validation import bounded, command_of, one_of
from astray.world import register

MOST_LEVELS = 10_000  # for probes
SOME = 1000  # levels to compare in, by default


def explain(
    player: Annotated[TestedPlayer, arg(name="")] = TestedPlayer(),
    level: GivenLevel = GivenLevel(),
    layers: Annotated[str | None, otherwise("three layers, including the last")] = None,
    num_levels: int = 100,
    out: Path = Path("explained"),
) -> None:
    """Write a page that shows how a policy behaves in a level, and why.

    The page shows policy and value at every place, the effects of edits to the level, the parts
    that the value depends on, probes of the layers, the evidence for each goal, and the episode
    step by step. By default the level is a large unseen one that distinguishes the goals. For a
    policy without a network, the parts that need one say so.

    Example: astray explain maze-corner

    Args:
        layers: Layers that probes read, separated by commas.
        num_levels: Number of levels to fit the probes on.
        out: Folder for explain.html with its figures and tables.
    """
    from astray.acting import check_ending, initial_states
    from astray.analysis.outcomes import load_shift
    from astray.analysis.runs import rehearse
    from astray.analysis.trained import Agent, looked_into
    from astray.insight.activations import check_layers
    from astray.insight.explain import PAGE, SIGN, Asked, default_layers, written
    from astray.insight.explain import explain as write
    from astray.lab.goals import typical
    from astray.level import Level

    bounded("num_levels", num_levels, 2, MOST_LEVELS)
    level.check()
    player.policy.check_game("explain")
    policy, game, name, levels, named, config = player.open()
    game.drawn(policy.art, levels)  # it is drawn, also where the policy sees symbols
    agent = looked_into(policy, game)
    reads = default_layers(agent) if layers is None else tuple(layers.split(","))
    if reads:
        check_layers(agent, reads)  # pyrefly: ignore
    check_free(out, PAGE, SIGN, written(game))
    check_writable(out / PAGE)
    check_ending(game, levels, None)
    number, why = level.find(game, levels), ""
    rehearse([policy], game, levels, [0])
    unseen = config.unseen_levels if config else range(MOST_LEVELS + 2)
    if number is None:
        first, shift = int(unseen[0]), load_shift(game, named)
        number, why = typical(game, levels, shift, agent, first)
    if not isinstance(number, Level):
        drawn = Level.of(game, levels, initial_states(game, levels, [number])[0])
        where, given = f"{name} level {number}", f"--level {number}"
    else:
        drawn, where = number, f"{name} {level.level_file}"
        given = f"--level-file {command_of(str(level.level_file))}"
    # Probes do not learn from the level that they read.
    after = [one for one in unseen[1 : num_levels + 2] if one != number][:num_levels]
    told: Any = {"lab": f"astray lab {player.words} --variant {name} {given}", "why": why}
    if config and isinstance(agent, Agent):
        deviation = AgentFolder.of(agent.path).deviation()
        told |= {"gamma": config.gamma, "lam": config.lam, "deviation": deviation}
        told["why"] = f"{why} {config.caveat}".strip()
    asked = Asked(agent, levels, drawn, named, reads, np.array(after), **told)
    who = player.agent.name if player.agent else policy.name
    print(write(asked, out, f"{who} in {game.name} {where}", progress=True))


def audit(
    agent: Positional[Annotated[Path | None, otherwise("none", AN_AGENT)]] = None,
    shift: Shift = None,
    ghost: Annotated[
        str | None, otherwise("none", "Variant without the intended object, for comparison.")
    ] = None,
    levels: Annotated[int, arg(name="num_levels")] = 1000,
    knobs: Knobs = (),
    rewards: Rewards = (),
    longest: Longest = None,
    acting: Acting = Acting(),
    policy: OwnPolicy = OwnPolicy(),
    out: Path = Path("reports"),
) -> None:
    """Write a report on which goal one agent pursues.

    Example: astray audit maze-corner

    Args:
        levels: Number of levels to play in each variant.
        out: Folder of reports; this one is written to audit-<agent>-<shift>-smoke.
    """
    from astray.experiments.audit import audit as write

    how: dict[str, Any] = {"ghost": ghost, "levels": levels, "knobs": pairs(knobs)}
    how |= {"rewards": imports.find_each(rewards), "out": out, "longest": longest}
    how["command"] = command_of("astray", *sys.argv[1:])
    if policy.replaces(agent, {"--shift": shift}):
        print(write(policy.make(acting, rules := policy.rules()), rules, shift, **how))
    else:
        assert agent is not None
        print(write(agent, shift=shift, **vars(acting), **how))


def compare(
    agents: Positional[
        Annotated[
            tuple[str, ...],
            arg(
                help="Two or more run folders, names of agents, or policies: random, walk:GOAL, "
                "module:name.",
                help_behavior_hint="(required)",
            ),
        ]
    ],
    tested: Annotated[Tested, arg(name="")] = Tested(),
    game: Annotated[str | None, otherwise("that of the agents")] = None,
    world: Annotated[str | None, otherwise("none")] = None,
    levels: Annotated[
        str | None, otherwise("the first 1,000 that no training draws from", NUMBERS)
    ] = None,
    longest: Longest = None,
    out: Path = Path("compared"),
) -> None:
    """Write a page that compares agents and other policies in the same levels.

    It shows outcomes and differences with intervals, learning curves and a video, side by side.

    Example: astray compare maze-corner walk:cheese random --shift corner-small

    Args:
        game: Game that the policies play; needed if no agent is among them.
        world: World of your own that the policies play, or the agents were trained on, as
            module:WORLD.
        out: Folder for compare.html, its figures and videos.

    Raises:
        ValueError: If agents play different games or have different knobs, or a shift is missing.
    """
    from astray.analysis.outcomes import load_shift
    from astray.analysis.runs import shift_of
    from astray.experiments.compare import PAGE
    from astray.experiments.compare import compare as write

    check_writable(out / PAGE)
    own = OwnPolicy(policy="random", game=game, world=world)
    if world is not None:
        register(own.named())  # agents that were trained on it name it
    for name in agents:
        if not _is_policy(name) and not Path(name).exists() and len(Path(name).parts) == 1:
            one_of("agent or policy", name, [*names(), "random", "walk:GOAL", "module:name"])
    opened = {name: tested.acting.open(Path(name)) for name in agents if not _is_policy(name)}
    configs = [config for _, config in opened.values()]
    found = {c.find_game().name for c in configs} | ({own.rules().name} if game or world else set())
    if len(found) > 1:
        raise ValueError(f"agents must play one game; got {', '.join(sorted(found))}")
    if any(config.knobs != configs[0].knobs for config in configs):
        raise ValueError(
            "agents must be trained with the same knobs, for the test to have them; got "
            + "; ".join(str(dict(config.knobs)) for config in configs)
        )
    config = configs[0] if configs else None
    rules = config.find_game() if config else own.rules()
    shift = shift_of(config, rules) if tested.shift is None else tested.shift
    name = load_shift(rules, shift).test if tested.variant is None else tested.variant
    variant = played(rules, name, tested.knobs, config)
    first = max((config.unseen_levels.start for config in configs), default=0)
    numbers = level_numbers(f"{first}:{first + SOME}" if levels is None else levels)
    acting = replace(tested.acting, mode="sampled") if opened else tested.acting  # the agents' mode
    policies = [
        opened[one][0] if one in opened else OwnPolicy(policy=one).make(acting, rules)
        for one in agents
    ]
    how: Any = {"command": command_of("astray", *sys.argv[1:]), "longest": longest}
    print(write(policies, rules, shift, numbers, out, variant=variant, **how))


def _is_policy(name: str) -> bool:
    """Return whether a word names a policy rather than an agent: module:name, walk:GOAL, random."""
    return not Path(name).exists() and (":" in name or name == "random")
