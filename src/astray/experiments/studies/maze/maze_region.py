"""Mice trained with cheese in ever larger regions at the corner, tested with cheese anywhere."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl

from astray.analysis.estimates import estimate_difference, estimate_mean, over_agents
from astray.analysis.outcomes import MISGENERALIZED, OUTCOMES, matrix
from astray.analysis.policies import Walk
from astray.experiments import outcomes
from astray.experiments.outcomes import of, table_of
from astray.experiments.spec import Experiment, Plan, Work, tests_of
from astray.experiments.studies.maze import maze_corner
from astray.figures import charts
from astray.games.maze.rules import REWARD
from astray.games.maze.variants import EASY, SMALL
from astray.report.claims import above, rounded
from astray.report.findings import Findings, Plot, Table
from astray.training.config import PRESETS, Config

BASE_RATES = {Walk("corner").name: "walk to the corner", "random": "random"}
REACHED = pl.col("reached_goal").is_not_null()
LAST = 10  # the part of a training's iterations that its end is: the last tenth


def find(work: Work) -> Findings:
    (test,) = work.plan.tests
    regions = {name: region(config) for name, config in work.plan.agents.items()}
    smallest, *_, largest = regions
    middle = list(regions)[(len(regions) - 1) // 2]
    success = {name: matrix(of(work, test, name), REACHED) for name in regions}
    corner = outcomes.first(work, test, MISGENERALIZED)
    reached = {
        ("where it is anywhere", regions[name]): estimate_mean(came)
        for name, came in success.items()
    } | {
        (who, None): estimate_mean(matrix(work.episodes.filter(policy=name), REACHED))
        for name, who in BASE_RATES.items()
    }
    shown = table_of(reached, "who", "region").drop("n")  # null: base rate
    shown = pl.concat([shown, at_end_of_training(work, regions)])
    came_first = {
        (outcome, regions[name]): estimate_mean(came)
        for outcome in OUTCOMES
        for name, came in outcomes.first(work, test, outcome).items()
    }
    first = table_of(came_first, "outcome", "region").drop("n")
    sides = {name: f"{side} x {side} cells" for name, side in regions.items()}
    both = pl.concat([shown, first.rename({"outcome": "who"})])
    titles = ["The cheese is reached"] * len(shown)
    titles += ["Reached first, in distinguishing levels"] * len(first)
    lines = charts.curves(
        both.with_columns(panel=pl.Series(titles)), x="region", line="who", panel="panel",
        columns=1, percent="y", limits=(-0.02, 1.02), label="fraction of levels",
        x_label="region of the cheese in training (cells a side)",
    )  # fmt: skip
    return Findings(
        answer="Where the cheese is anywhere, a mouse whose cheese was in the corner's "
        f"{sides[smallest]} reaches it in {rounded(success[smallest].mean())} of levels, one "
        f"whose cheese was in {sides[middle]} in {rounded(success[middle].mean())}, and in "
        f"{sides[largest]} in {rounded(success[largest].mean())}. In distinguishing "
        f"levels they go to the corner first in {rounded(corner[smallest].mean())}, "
        f"{rounded(corner[middle].mean())} and {rounded(corner[largest].mean())}.",
        claims=[
            above(
                "The larger the region in training, the more often the cheese is reached where it "
                "is anywhere.",
                "performance improves as the region grows (a curve without figures)",
                f"reached after {sides[largest]} minus after {sides[smallest]}",
                estimate_difference(
                    success[largest], success[smallest], pool=list(success.values())
                ),
            ),
            above(
                f"A mouse whose cheese was anywhere in {sides[middle]} still goes to the corner, "
                f"more often than one that found it in {sides[largest]}.",
                "uses location as a proxy until the region is quite large (no figure given)",
                f"{MISGENERALIZED} after {sides[middle]} minus after {sides[largest]}",
                estimate_difference(corner[middle], corner[largest], pool=list(corner.values())),
            ),
        ],
        videos=outcomes.videos(work, agent=middle),
        plots=[
            Plot(
                "regions",
                "The rate at which the cheese is reached within the time limit, which is the "
                "paper's measure, and the goal that is reached first, with 95 % intervals. In "
                "training: its last tenth, on its own levels.",
                lines,
                both,
            )
        ],
        tables=[
            Table("success", "The rate at which the cheese is reached if it is anywhere", shown),
            *outcomes.outcome_tables(work),
        ],
        settings=outcomes.settings(work.plan),
    )


def region(config: Config) -> int:
    """Return the side, in cells, of the region with the cheese; 1 for the corner."""
    variant: Any = config.training_variant()
    return variant.region


def at_end_of_training(work: Work, regions: Mapping[str, int]) -> pl.DataFrame:
    """Return how often the cheese is reached in the last tenth: who, region, mean, low, high."""
    curves, rows = outcomes.curves(work.runs), []
    for name, side in regions.items():
        seeds = curves.filter(agent=name).partition_by("seed")
        ends = [s.sort("steps")["training/return"].tail(-(-len(s) // LAST)).mean() for s in seeds]
        mean, *between = over_agents(np.array(ends, float)[:, None] / REWARD)[:, 0]
        low, high = np.clip(between, 0, 1)
        rows.append({"who": "in training", "region": side, "mean": mean, "low": low, "high": high})
    return pl.DataFrame(rows).fill_nan(None)


def sweep(first: Config, regions: Sequence[int], **settings: Any) -> dict[str, Config]:
    """Return the settings by name: the first, and one for each further region."""
    others = [replace(first, variant=f"region-{side}", **settings) for side in regions]
    return {f"region {region(config)}": config for config in (first, *others)}


HOUR = maze_corner.EXPERIMENT.sizes["hour"]
SMALL_TEST = {"in the test": tests_of("maze", "corner-small")["in the test"]}
# The text has 100,000 levels and IMPALA as it is; this sweep's scripts have four times its
# channels, and levels without end.
PAPER = replace(
    PRESETS["paper"],
    variant="region-1",
    validation="anywhere",
    scale=4,
    steps=80_000_000,
    num_envs=512,
    minibatches=16,
    device="cuda",
)

EXPERIMENT = Experiment(
    title="The region of the cheese",
    reproduces="Figure 4",
    question="How far from the corner must cheese be seen before a mouse looks for it?",
    sizes={
        "smoke": Plan(
            # An even side adds no junctions, only passages.
            agents=sweep(maze_corner.SYMBOLS, (3, 5, 7), knobs=dict(SMALL)),
            seeds=10,
            first_seed=20,
            tests=SMALL_TEST,
            levels=1000,
            differences="regions of 1, 3, 5 and 7 cells, in worlds of 7 instead of 25, seen as "
            "symbols instead of a picture; a mouse that starts anywhere and has 100 steps instead "
            "of 500; a network of two hidden layers, and 5.5 million steps instead of 80 million",
        ),
        "pixels": Plan(
            agents=sweep(maze_corner.PIXELS, (3, 5, 7), knobs=dict(SMALL)),
            seeds=3,
            first_seed=20,
            tests=SMALL_TEST,
            levels=1000,
            differences="regions of 1, 3, 5 and 7 cells, in worlds of 7 instead of 25; a mouse "
            "that starts anywhere and has 100 steps instead of 500; a network of patches, and 2 "
            "million steps instead of 80 million",
        ),
        "night": Plan(
            agents=sweep(maze_corner.NIGHT, (4, 10)),
            seeds=2,
            first_seed=1,
            tests={"in the test": tests_of("maze", "corner")["in the test"]},
            levels=1000,
            differences=f"regions of 1, 4 and 10 cells; {maze_corner.BY_NIGHT}",
            speed=maze_corner.SPEED,
        ),
        "hour": Plan(
            agents=sweep(HOUR.config, (4, 8, 15), knobs=dict(EASY)),
            tests={"in the test": HOUR.tests["in the test"]},
            levels=1000,
            differences="regions of 1, 4, 8 and 15 cells, in worlds of 15 instead of 25; a network "
            "with a quarter of the channels, and 25 million steps instead of 80 million",
        ),
        "paper": Plan(
            agents=sweep(PAPER, range(2, 17)),
            seeds=3,
            tests={"in the test": tests_of("maze", "corner")["in the test"]},
            levels=10_000,
            differences="",
        ),
    },
    find=find,
)
