"""What the experiments with mazes and the training curves compute, on made-up episodes."""

import math
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

from astray.analysis.outcomes import FAILED, INTENDED, MISGENERALIZED
from astray.experiments import catalogue, run
from astray.experiments.studies.maze import colour_or_shape, maze_region
from astray.experiments.studies.training import training_curves
from astray.experiments.studies.training.training_curves import TEST, TRAIN
from astray.games.maze.variants import COLOURS, SHAPES


def folders(plan):
    return {run.run_folder(Path(), c) for configs in plan.trainings().values() for c in configs}


@pytest.mark.parametrize("size", training_curves.EXPERIMENT.sizes)
def test_curves_train_no_agents_of_their_own_and_show_each_once(size):
    plan = training_curves.EXPERIMENT.sizes[size]
    # Itself, and what is no figure's.
    beyond = ("training_curves", ".mitigation.", ".insight.", ".networks.", ".pottery.", ".field.")
    others = [
        catalogue.load(name)
        for name, module in catalogue.MODULES.items()
        if not any(part in module for part in beyond)
    ]
    plans = [one.sizes[size] for one in others if size in one.sizes and one.sizes[size].agents]
    assert folders(plan) <= set().union(*map(folders, plans))
    trained = [made[0] for one in plans for made in [*one.trainings().values()][:1]]
    first = {run.run_folder(Path(), config).parent for config in trained}  # whatever their seeds
    trainings = plan.trainings()
    assert {run.run_folder(Path(), trainings[name][0]).parent for name in plan.agents} == first
    assert len(first) == len(plan.agents)


@pytest.mark.parametrize("size", ["pixels", "hour"])
def test_the_smallest_region_is_the_corner_mouse(size):
    corner = catalogue.load("maze-corner").sizes[size]
    region = maze_region.EXPERIMENT.sizes[size]
    shared, mice = folders(corner) & folders(region), corner.seeds * len(corner.agents)
    assert len(shared) == min(mice, region.seeds)
    sides = [maze_region.region(config) for config in region.agents.values()]
    assert sides == sorted(set(sides)) and sides[0] == 1
    worlds = {c.training_variant().world for c in region.agents.values()}
    assert worlds == {c.variant_for(c.validation).world for c in region.agents.values()}
    assert worlds == {region.tests["in the test"].variant_for(region.config).world}


def measured(seeds=5, iterations=1000):
    """Returns of `seeds` agents that end at 9 in training, at 1 to 5 in the test."""
    random = np.random.default_rng(0)
    return pl.DataFrame(
        [
            {
                "agent": "mouse",
                "seed": seed,
                "steps": 64 * (k + 1),
                TRAIN: 9 * min(1, k / 500) + random.normal(0, 0.1),
                TEST: None if k % 10 else 1.0 + seed,
            }
            for seed in range(seeds)
            for k in range(iterations)
        ]
    )


def test_a_point_of_a_curve_is_the_mean_of_the_agents():
    shown = training_curves.curves(measured())
    train, test = (shown.filter(series=name) for name in (TRAIN, TEST))
    assert len(train) == len(test) == training_curves.POINTS
    assert train["steps"].to_list() == [640 * (k + 1) for k in range(100)]
    assert train["mean"][-1] == pytest.approx(9, abs=0.1)
    assert test["mean"].to_list() == [3.0] * 100  # of 1 to 5
    assert (test["low"] < 3).all() and (test["high"] > 3).all()


def test_the_gap_at_the_end_is_judged_by_its_interval():
    (row,) = training_curves.ends(measured()).to_dicts()
    assert (row[TRAIN], row[TEST]) == (pytest.approx(9, abs=0.1), 3)
    assert row["lower by"] == pytest.approx(6, abs=0.1)
    assert training_curves.ends_lower(row).supported
    assert not training_curves.ends_lower(row | {"low": -0.1}).supported
    (row,) = training_curves.ends(measured(seeds=1)).to_dicts()
    assert row["low"] is None and not training_curves.ends_lower(row).supported
    (row,) = training_curves.ends(measured().with_columns(pl.lit(None).alias(TEST))).to_dicts()
    assert not training_curves.ends_lower(row).supported


def offered(outcome):
    """What two agents go to in 300 levels, offered all pairs."""
    return pl.DataFrame(
        [
            {
                "colour": colour,
                "shape": shape,
                "seed": seed,
                "level": level,
                "outcome": FAILED if level % 3 == 0 else outcome(colour, shape),
            }
            for colour in COLOURS[1:]
            for shape in SHAPES[1:]
            for seed in range(2)
            for level in range(300)
        ]
    )


def test_rates_are_of_those_that_go_to_either():
    pairs = offered(lambda colour, shape: MISGENERALIZED if shape == "gem" else INTENDED)
    table = colour_or_shape.pair_table(pairs)
    assert table.filter(shape="gem")["keeps_colour"].to_list() == [1] * 6
    assert table.filter(shape="star")["keeps_colour"].to_list() == [0] * 6
    assert table["neither"].to_list() == [pytest.approx(1 / 3)] * 36
    none = colour_or_shape.pair_table(pairs.with_columns(outcome=pl.lit(FAILED)))
    assert none["keeps_colour"].null_count() == 36


def test_a_preference_flips_where_agents_surely_differ():
    pairs = offered(lambda colour, shape: MISGENERALIZED)
    told = colour_or_shape.flips(colour_or_shape.pair_table(pairs, "seed"))
    assert not told.supported and "2 of 2 agents go to the gem, 0 to the line" in told.ours
    seldom = pl.when(seed=1, outcome=MISGENERALIZED).then(pl.lit(INTENDED))
    pairs = pairs.with_columns(outcome=seldom.otherwise("outcome"))
    told = colour_or_shape.flips(colour_or_shape.pair_table(pairs, "seed"))
    assert told.supported and "1 of 2 agents go to the gem, 1 to the line" in told.ours


@pytest.mark.parametrize("sign, rate", [(1, "100.0"), (-1, "0.0")])
def test_near_codes_are_told_from_far_ones(sign, rate):
    def outcome(colour, shape):
        # Steps of 60 degrees from yellow and from a line.
        new_colour = math.cos(math.pi / 3 * (COLOURS.index(colour) - COLOURS.index("yellow")))
        new_shape = math.cos(math.pi / 3 * (SHAPES.index(shape) - SHAPES.index("line")))
        return MISGENERALIZED if sign * (new_shape - new_colour) > 0 else INTENDED

    work = SimpleNamespace(plan=colour_or_shape.EXPERIMENT.sizes["smoke"])
    told = colour_or_shape.near_codes(work, offered(outcome))
    assert rate in told.ours and told.supported == (sign > 0)
