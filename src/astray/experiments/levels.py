"""The levels that a study plays: none that an agent of its plan met in training."""

from __future__ import annotations

import functools
from collections.abc import Iterable

import numpy as np

from astray.analysis.overlap import met, unseen
from astray.experiments.spec import Plan, Test
from astray.game import Game, Variant
from astray.published.imported import SPARED
from astray.training.config import Config


def levels_of(plan: Plan, test: Test) -> np.ndarray:
    """The numbers of a test's levels, which no agent of the plan has met under any number."""
    return unmet(plan.agents.values(), test.variant_for(plan.config), plan.levels)


def unmet(agents: Iterable[Config], variant: Variant, count: int) -> np.ndarray:
    """The first numbers of a variant's levels that no agent has met under any number, [count].

    Published agents that were trained on all levels may have met some, of two thousand million;
    these levels are as good as any.
    """
    agents = list(agents)
    game = agents[0].find_game()
    after = max((config.unseen_levels for config in agents), key=lambda left: left.start)
    if len(after) <= SPARED:
        return np.array(after[:count])
    trainings = tuple((c.training_variant(), c.training_levels) for c in agents)
    try:
        return unseen(game, met_in(game, trainings), variant, after, count)
    except ValueError as error:
        most = max(config.levels for config in agents)
        raise ValueError(f"{error}; lower `levels` of the training, {most:,}") from error


def see_levels(plan: Plan) -> None:
    """Raise ValueError where a test has too few levels that no training of the plan meets."""
    for test in (*plan.tests.values(), *plan.visited.values()):
        levels_of(plan, test)


@functools.lru_cache(maxsize=1)
def met_in(game: Game, trainings: tuple[tuple[Variant, range], ...]) -> set[bytes]:
    """`overlap.met`, once for all tests of a plan."""
    return met(game, trainings)
