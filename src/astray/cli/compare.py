"""The verb that compares agents."""

import sys
from pathlib import Path
from typing import Annotated

from tyro.conf import Positional, arg

from astray.cli.arguments import NUMBERS, Longest, OwnPolicy, Tested, level_numbers, played
from astray.files import check_writable
from astray.training.folders import names
from astray.training.settings import otherwise
from astray.validation import command_of, one_of
from astray.world import register

SOME = 1000  # levels, by default


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
    found = {config.find_game().name for config in configs} | ({game} if game else set())
    if len(found) > 1:
        raise ValueError(f"agents must play one game; got {', '.join(sorted(found))}")
    if len({str(config.knobs) for config in configs}) > 1:
        raise ValueError(
            "agents must be trained with the same knobs, for the test to have them; got "
            + "; ".join(str(dict(config.knobs)) for config in configs)
        )
    config = configs[0] if configs else None
    rules = config.find_game() if config else own.rules()
    if tested.shift is None and config is None:
        raise ValueError("policies need --shift: which goal is intended, and which are proxies")
    shift = tested.shift or shift_of(config)  # pyright: ignore[reportArgumentType]
    name = tested.variant or load_shift(rules, shift).test
    variant = played(rules, name, tested.knobs, config)
    first = max((config.unseen_levels.start for config in configs), default=0)
    numbers = level_numbers(levels or f"{first}:{first + SOME}")
    policies = [
        opened[one][0] if one in opened else OwnPolicy(policy=one).make(tested.acting)
        for one in agents
    ]
    command = command_of("astray", *sys.argv[1:])
    print(
        write(
            policies, rules, shift, numbers, out, variant=variant, command=command, longest=longest
        )
    )


def _is_policy(name: str) -> bool:
    """Return whether a word names a policy rather than an agent: module:name, walk:GOAL, random."""
    return not Path(name).exists() and (":" in name or name == "random")
