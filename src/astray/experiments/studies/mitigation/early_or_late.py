"""When must distinguishing levels come: early, late, or throughout?"""

from dataclasses import replace

import polars as pl

from astray.analysis.estimates import estimate_difference, estimate_mean
from astray.analysis.outcomes import INTENDED
from astray.estimate import Estimate
from astray.experiments import outcomes
from astray.experiments.outcomes import rate
from astray.experiments.spec import Experiment, Plan, Work, tests_of
from astray.experiments.studies.maze.maze_corner import SYMBOLS
from astray.report.claims import above, near_zero, rounded
from astray.report.findings import Findings, Table

FRACTION = 0.02  # of training levels whose cheese is anywhere
BEGUN = 3_600  # such levels, in all: 2 % of the 180,000 that a training of mice begins
WITHIN = 0.1  # of the steps, at the beginning or at the end
NEVER, THROUGHOUT, EARLY, LATE, ANNEALED = "never", "throughout", "early", "late", "annealed"
TESTED = "in the test"
BETTER, CAPABLE, ALIKE = 0.1, 0.95, 0.1  # bounds of the claims


def find(work: Work) -> Findings:
    """Measure the goals of agents whose few distinguishing levels came at different times."""
    train, test = work.plan.tests
    wrong = {name: outcomes.misgeneralized(work, test, name) for name in work.plan.agents}

    def minus(one: str, other: str) -> Estimate:
        return estimate_difference(wrong[one], wrong[other], pool=list(wrong.values()))

    right = {name: outcomes.first(work, test, name, INTENDED) for name in work.plan.agents}
    told = ", ".join(
        " and ".join(rounded(estimate_mean(which[name]).mean) for which in (wrong, right))
        + f" ({name})"
        for name in wrong
    )
    poorest = min(
        (rate(work.episodes.filter(pl.col("agent") == name), train, INTENDED) for name in wrong),
        key=lambda estimate: estimate.low,
    )
    return outcomes.findings_of(
        work,
        f"With {BEGUN:,} levels whose cheese is anywhere, {100 * FRACTION:g}\u00a0% "
        "of all, at other times of training, mice go to the corner first and to the cheese first, "
        f"in levels that distinguish the goals: {told}.",
        [
            above(
                "Distinguishing levels help more at the end of training than at its beginning.",
                "none",
                f"{EARLY} minus {LATE}",
                minus(EARLY, LATE),
                BETTER,
            ),
            above(
                "Throughout, they help more than at the beginning.",
                "none",
                f"{EARLY} minus {THROUGHOUT}",
                minus(EARLY, THROUGHOUT),
                BETTER,
            ),
            near_zero(
                "At the beginning they leave no trace.",
                "none",
                f"{NEVER} minus {EARLY}",
                minus(NEVER, EARLY),
                ALIKE,
            ),
            above(
                "Whenever they come, the mice learn to reach the cheese of the training levels.",
                "none",
                "the schedule with the lowest rate",
                poorest,
                CAPABLE,
            ),
        ],
        [outcomes.curve_plot(work)],
        tables=[Table("begun", "Levels that were begun in training", begun(work))],
        agent=EARLY,
    )


def begun(work: Work) -> pl.DataFrame:
    """Return columns agent, seed, levels (begun in training), shifted (of those)."""
    measured = outcomes.curves(work).filter(pl.col("agent") != NEVER)
    last = measured.sort("steps").group_by("agent", "seed", maintain_order=True).last()
    return last.select(
        "agent",
        "seed",
        levels=pl.col("levels/begun").cast(pl.Int64),
        shifted=pl.col("levels/shifted").cast(pl.Int64),
    )


MOUSE = replace(SYMBOLS, steps=4_000_000)
MIXED = MOUSE.changed(
    knobs={"shift_probability": FRACTION}, sampler="mixed", fraction=WITHIN, shifted_levels=BEGUN
)
EXPERIMENT = Experiment(
    title="Early, late, or throughout",
    reproduces="nothing, a question of our own",
    question="Training distinguishing levels are few. Does it matter when they come?",
    sizes={
        "smoke": Plan(
            agents={
                NEVER: MOUSE,
                THROUGHOUT: MIXED,
                EARLY: MIXED.changed(schedule="early"),
                LATE: MIXED.changed(schedule="late"),
                ANNEALED: MIXED.changed(schedule="annealed"),
            },
            seeds=3,
            tests=tests_of("maze", "corner-small"),
            levels=500,
            differences="worlds of 7 cells, seen as symbols by a network of two hidden layers, and "
            f"4 million steps; {EARLY} and {LATE} are the first and the last "
            f"{100 * WITHIN:g}\u00a0% of steps; the learning rate falls to 0 in all trainings "
            "alike, so that what comes late is learned with smaller steps",
        )
    },
    find=find,
)
