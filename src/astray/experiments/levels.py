"""The levels that a study plays, none that an agent met in training, and the episodes there."""

from __future__ import annotations

import functools
from collections.abc import Iterable

import numpy as np
import polars as pl

from astray.analysis.overlap import met, unseen
from astray.analysis.runs import play_all
from astray.experiments.spec import Plan, Runs, Test, open_agents
from astray.game import Game, Variant
from astray.published.imported import SPARED
from astray.training.config import Config


def levels_of(plan: Plan, test: Test) -> np.ndarray:
    """The numbers of a test's levels, which no agent of the plan has met under any number.

    Agents of others are trusted not to know the plan's, which are the same in all tests.
    """
    if plan.own:
        return np.arange(plan.first_level, plan.first_level + plan.levels)
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


def check_levels(plan: Plan) -> None:
    """Raise ValueError where a test has too few levels that no training of the plan meets."""
    for test in (*plan.tests.values(), *plan.visited.values()):
        levels_of(plan, test)


@functools.lru_cache(maxsize=1)
def met_in(game: Game, trainings: tuple[tuple[Variant, range], ...]) -> set[bytes]:
    """`overlap.met`, once for all tests of a plan."""
    return met(game, trainings)


def play(plan: Plan, runs: Runs) -> pl.DataFrame:
    """Play the episodes of all agents, and of scripted policies, in all tests.

    As `analysis.runs.play_all`; beside: agent (its name, null for scripts), test (its name),
    and the plan's measures.
    """
    players = [player for made in open_agents(plan, runs).values() for player in made]
    owners = pl.DataFrame(
        [{"run": str(run), "agent": name} for name, made in runs.items() for run in made]
    )
    parts = []
    for name, test in plan.tests.items():
        played = play_all(
            plan.game,
            test.name,
            plan.variant_of(test),
            test.shift,
            levels_of(plan, test),
            players,
            measures=plan.measures,
        )
        parts.append(played.with_columns(test=pl.lit(name)))
    return pl.concat(parts).join(owners, on="run", how="left", maintain_order="left")
