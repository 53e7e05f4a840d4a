"""The levels that a study plays: none that an agent of its plan met in training."""

from __future__ import annotations

import functools

import numpy as np

from astray.analysis.overlap import met, unseen
from astray.experiments.spec import Plan, Test
from astray.game import Game, Variant


def levels_of(plan: Plan, test: Test) -> np.ndarray:
    """The numbers of a test's levels, which no agent of the plan has met under any number.

    Published agents that were trained on all levels may have met some, of two thousand million;
    these levels are as good as any.
    """
    if plan.published:
        return np.array(plan.config.unseen_levels[: plan.levels])
    trainings = tuple((c.training_variant(), c.training_levels) for c in plan.agents.values())
    after = max((c.unseen_levels for c in plan.agents.values()), key=lambda left: left.start)
    return unseen(
        plan.game, met_in(plan.game, trainings), test.variant_for(plan.config), after, plan.levels
    )


@functools.lru_cache(maxsize=1)
def met_in(game: Game, trainings: tuple[tuple[Variant, range], ...]) -> set[bytes]:
    """`overlap.met`, once for all tests of a plan."""
    return met(game, trainings)
