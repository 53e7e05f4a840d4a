"""What is told of thieves: against scripted ones, and against sums over their episodes."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from astray.analysis.estimates import estimate_mean
from astray.analysis.policies import Walk
from astray.analysis.runs import play_all
from astray.experiments import outcomes
from astray.experiments.catalogue import load
from astray.experiments.outcomes import AGENTS, fair
from astray.experiments.spec import Work
from astray.experiments.studies.keys import _hoarding as hoarding
from astray.experiments.studies.keys._hoarding import (
    ALL_FIRST,
    BEYOND,
    IN_HAND,
    LEFT,
    LOST,
    NEED,
    PER_CHEST,
)

LEVELS = np.arange(100_000, 100_030)
PLAN = replace(load("keys-and-chests").sizes["smoke"], levels=len(LEVELS))


@pytest.fixture(scope="module")
def episodes(tmp_path_factory):
    """Those of scripted thieves, told; in both tests."""
    played = [
        play_all(
            PLAN.game,
            test.variant,
            test.variant_for(PLAN.config),
            test.shift,
            LEVELS,
            [],
            measures=PLAN.measures,
        ).with_columns(test=pl.lit(name))
        for name, test in PLAN.tests.items()
    ]
    folder = tmp_path_factory.mktemp("work")
    return hoarding.told(Work("keys", "smoke", PLAN, folder, "", {}, pl.concat(played)))


def mean(episodes, test, policy, measure):
    return episodes.filter(test=test, policy=policy)[measure].cast(pl.Float64).mean()


def test_who_fetches_what_it_needs_loses_little_and_leaves_no_chest(episodes):
    for test in PLAN.tests:
        assert -1e-9 < mean(episodes, test, NEED, LOST) < 0.1  # the fewest steps, undiscounted
        assert mean(episodes, test, NEED, PER_CHEST) == 1
        assert mean(episodes, test, NEED, LEFT) == 0
        assert mean(episodes, test, "random", LOST) > 0.5


def test_who_cares_for_keys_alone_takes_all_and_leaves_chests(episodes):
    keys = Walk("keys").name
    for measure in (BEYOND, ALL_FIRST, LEFT, LOST):
        assert mean(episodes, "in the test", keys, measure) > 0.5
        assert mean(episodes, "in the test", keys, measure) > mean(
            episodes, "in the test", NEED, measure
        )


def made(values):
    """Episodes of two agents and the walker: `values` are (test, policy, seed, level, value)."""
    names = ["test", "policy", "seed", "level", "value"]
    return pl.DataFrame(values, schema=names, orient="row")


def test_agents_are_compared_with_the_walker_level_by_level():
    agents = [("t", AGENTS, seed, level, 10 * level + seed) for seed in (0, 1) for level in (3, 1)]
    walker = [("t", NEED, None, level, 10.0 * level) for level in (1, 3)]
    work = Work("keys", "smoke", PLAN, Path(), "", {}, made(agents + walker))
    ours = outcomes.beyond(work, "t", "value", NEED)
    half = 12.7062 * 0.5  # Student's, of 0 for one agent and 1 for the other
    assert (ours.mean, ours.high - ours.mean) == (0.5, pytest.approx(half, rel=1e-4))
    assert (ours.agents, ours.levels) == (2, 2)


def test_a_change_is_of_the_levels_that_both_tests_have():
    before = [("a", AGENTS, 0, level, level) for level in (1, 2, 3)]
    after = [("b", AGENTS, 0, level, level + 0.25) for level in (2, 3, 9)]
    ours = hoarding.change(made(before + after), "value", "a", "b")
    assert (ours.mean, ours.levels) == (0.25, 2) and ours.low < 0.25 < ours.high


def test_an_estimate_is_of_levels_in_which_every_agent_has_a_value():
    values = {(0, 1): 1.0, (0, 2): None, (0, 3): 2.0, (1, 1): 3.0, (1, 2): 9.0, (1, 3): 4.0}
    rows = [("t", AGENTS, seed, level, value) for (seed, level), value in values.items()]
    assert hoarding.estimate(made(rows), "t", "value") == estimate_mean(np.array([[1, 2], [3, 4]]))
    nothing = hoarding.estimate(made(rows).with_columns(value=pl.lit(None, float)), "t", "value")
    assert math.isnan(nothing.mean) and nothing.levels == 0


def test_keys_in_hand_are_told_only_where_a_chest_was_opened(episodes):
    assert (episodes[IN_HAND].is_null() == episodes["first_chest"].is_null()).all()
    assert 0 < episodes[IN_HAND].null_count() < len(episodes)


def test_curves_begin_when_episodes_could_have_timed_out():
    config = replace(PLAN.config, num_steps=64, validation_every=4)  # 200 steps an episode
    table = pl.DataFrame({"steps": np.arange(1, 17) * config.batch}).with_columns(
        pl.lit(1.0).alias(f"{which}/return") for which in ("training", "validation")
    )
    told = table.with_columns(**fair(table, config))
    assert told["training/return"].null_count() == 3  # 4 x 64 steps are enough
    assert told["validation/return"].null_count() == 12  # the fourth is after iteration 12
