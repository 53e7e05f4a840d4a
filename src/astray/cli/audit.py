"""The verb that audits one agent."""

import sys
from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional, arg

from astray import imports
from astray.cli.arguments import AN_AGENT, Acting, Knobs, Longest, OwnPolicy, Rewards, Shift, pairs
from astray.training.settings import otherwise
from astray.validation import command_of


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
    folder: Path = Path("reports"),
) -> None:
    """Write a report on which goal one agent pursues.

    Example: astray audit maze-corner

    Args:
        levels: Number of levels to play in each variant.
        folder: Folder of reports.

    Raises:
        ValueError: If options do not go together.
    """
    from astray.experiments.audit import audit as write

    how: dict[str, Any] = {"ghost": ghost, "levels": levels, "knobs": pairs(knobs)}
    how |= {"rewards": imports.find_each(rewards), "folder": folder, "longest": longest}
    how["command"] = command_of("astray", *sys.argv[1:])
    if policy.replaces(agent, {"--shift": shift}):
        print(write(policy.make(acting), policy.rules(), shift, **how))
    else:
        assert agent is not None
        print(write(agent, shift=shift, **vars(acting), **how))
