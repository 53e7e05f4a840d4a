"""Names of the outcomes that an episode of any game can have, and of columns of every table.

`analysis.outcomes` assigns them to episodes, and `figures` draws them in their colours.
"""

from collections.abc import Iterable

INTENDED = "intended goal"  # reached no later than any proxy
MISGENERALIZED = "goal misgeneralization"  # a proxy came first
FAILED = "capability failure"  # no goal, and no other end of the game
OUTCOMES = (INTENDED, MISGENERALIZED, FAILED)
NO_GOALS = OTHER, DEVICE, UNDECIDED, NEITHER = "another cell", "device", "undecided", "neither"
# Columns of a table of episodes beside a game's events and measures.
COLUMNS = ("policy", "level", "name", "shifted", "return", "length", "terminated")
COLUMNS += ("run", "seed", "checkpoint", "variant", "outcome", "distinguishing", "agent", "test")


def check_ends(ends: Iterable[str], goals: Iterable[str]) -> None:
    """Raise ValueError if an end has the name of an outcome, or a goal a name for none."""
    for what, names, others in (("an end", ends, OUTCOMES), ("a goal", goals, NO_GOALS)):
        if taken := {*names} & {*others}:
            raise ValueError(f"{what} must have a name of its own; got {', '.join(sorted(taken))}")
