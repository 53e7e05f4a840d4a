"""Names of the outcomes that an episode of any game can have.

`analysis.outcomes` assigns them to episodes, and `figures` draws them in their colours.
"""

INTENDED = "intended goal"  # reached no later than any proxy
MISGENERALIZED = "goal misgeneralization"  # a proxy came first
FAILED = "capability failure"  # no goal, and no other end of the game
OUTCOMES = (INTENDED, MISGENERALIZED, FAILED)
