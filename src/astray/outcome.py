"""Names of the outcomes that an episode of any game can have, and of columns of every table.

`analysis.outcomes` assigns them to episodes, and `figures` draws them in their colours.
"""

from collections.abc import Iterable

INTENDED = "intended goal"  # reached no later than any proxy
MISGENERALIZED = "goal misgeneralization"  # a proxy came first
FAILED = "capability failure"  # no goal, and no other end of the game
OUTCOMES = (INTENDED, MISGENERALIZED, FAILED)
# Columns of a table of episodes beside a game's events and measures.
COLUMNS = ("policy", "level", "name", "shifted", "return", "length", "terminated")
COLUMNS += ("run", "seed", "checkpoint", "variant", "outcome", "distinguishing", "agent", "test")


def check_ends(ends: Iterable[str]) -> None:
    """Raise ValueError if another end of a game has the name of an outcome."""
    if taken := {*ends} & {*OUTCOMES}:
        raise ValueError(f"an end must have a name of its own; got {', '.join(sorted(taken))}")
