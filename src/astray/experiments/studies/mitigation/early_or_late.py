"""When must distinguishing levels come: early, late, or throughout?

Every kind of mice begins with the same competent mice, one of each seed, and plays as many steps in
distinguishing levels. Each is then paid for cheese anywhere for a short time, which tells mice that
no longer can fetch it from those that do not try.
"""

from dataclasses import replace

import polars as pl

from astray.analysis.estimates import estimate_difference, estimate_mean, estimate_paired
from astray.analysis.outcomes import INTENDED, MISGENERALIZED
from astray.estimate import Estimate
from astray.experiments import outcomes
from astray.experiments.outcomes import rate
from astray.experiments.spec import Experiment, Plan, Work, tests_of
from astray.experiments.studies.maze.maze_corner import SYMBOLS
from astray.report.claims import above, near_zero, rounded
from astray.report.findings import Findings, Table

FRACTION = 0.02  # of the steps, and of the training levels, whose cheese is anywhere
WITHIN = 0.1  # of the steps, at the beginning or at the end
BEFORE = "before"  # mice that all others begin with
NEVER, THROUGHOUT, EARLY, LATE, ANNEALED = "never", "throughout", "early", "late", "annealed"
KINDS = (NEVER, THROUGHOUT, EARLY, LATE, ANNEALED)
ALWAYS = "always"  # mice for whom the cheese is anywhere: the best that this training can do
NEW = "new mice"  # that are paid without any training before
BETTER, CAPABLE, ALIKE = 0.1, 0.95, 0.1  # bounds of the claims


def paid(name: str) -> str:
    """Return the name of mice that are paid for cheese anywhere, after another training."""
    return f"{name}, then paid"


def find(work: Work) -> Findings:
    train, test = work.plan.tests
    wrong, right = (outcomes.first(work, test, which) for which in (MISGENERALIZED, INTENDED))

    def minus(one: str, other: str) -> Estimate:
        # They began with the same mice: these are pairs.
        return estimate_paired(wrong[one], wrong[other])

    told = ", ".join(
        " and ".join(rounded(estimate_mean(which[name]).mean) for which in (wrong, right))
        + f" ({name})"
        for name in (*KINDS, ALWAYS)
    )
    poorest = min(
        (rate(work.episodes.filter(pl.col("agent") == name), train, INTENDED) for name in KINDS),
        key=lambda estimate: estimate.low,
    )
    return outcomes.findings_of(
        work,
        f"With {100 * FRACTION:g}\u00a0% of the steps in levels whose cheese is anywhere, at other "
        "times of training, mice go to the corner first and to the cheese first, "
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
                "Whenever they come, the mice still reach the cheese of the training levels.",
                "none",
                "the schedule with the lowest rate",
                poorest,
                CAPABLE,
            ),
            near_zero(
                "Paid for it, mice that had them early fetch the cheese as often as those that had "
                "none.",
                "none",
                f"{paid(EARLY)}, minus {paid(NEVER)}",
                estimate_paired(right[paid(EARLY)], right[paid(NEVER)]),
                ALIKE,
            ),
            above(
                "And more often than new mice that are paid as long.",
                "none",
                f"{paid(EARLY)}, minus {paid(NEW)}",
                estimate_difference(
                    right[paid(EARLY)], right[paid(NEW)], pool=list(right.values())
                ),
                BETTER,
            ),
        ],
        [outcomes.curve_plot(work)],
        tables=[Table("dose", "Steps in levels whose cheese is anywhere", dose(work))],
        agent=EARLY,
    )


def dose(work: Work) -> pl.DataFrame:
    """Return columns agent, seed, levels (begun), shifted (of these), steps (in shifted ones)."""
    measured = outcomes.curves(work.runs).filter(pl.col("agent").is_in([*MIXED]))
    last = measured.sort("steps").group_by("agent", "seed", maintain_order=True).last()
    names = {"levels": "begun", "shifted": "shifted", "steps": "shifted_steps"}
    counts = {to: pl.col(f"levels/{name}").cast(pl.Int64) for to, name in names.items()}
    return last.select("agent", "seed", **counts)


FIRST = replace(SYMBOLS, steps=4_000_000, anneal=False)
MOUSE = replace(FIRST, steps=2_000_000)
SOME = MOUSE.changed(
    knobs={"shift_probability": FRACTION},
    sampler="mixed",
    fraction=WITHIN,
    shifted_steps=round(FRACTION * MOUSE.steps),
)
MIXED = {
    THROUGHOUT: SOME,
    EARLY: SOME.changed(schedule="early"),
    LATE: SOME.changed(schedule="late"),
    ANNEALED: SOME.changed(schedule="annealed"),
}
PAID = replace(MOUSE, variant="anywhere-small", steps=250_000)
EXPERIMENT = Experiment(
    title="Early, late, or throughout",
    reproduces="nothing, a question of our own",
    question="Training distinguishing levels are few. Does it matter when they come?",
    sizes={
        "smoke": Plan(
            agents={
                BEFORE: FIRST,
                NEVER: MOUSE,
                **MIXED,
                ALWAYS: replace(MOUSE, variant="anywhere-small"),
                **{paid(name): PAID for name in (*KINDS, NEW)},
            },
            starts={name: BEFORE for name in (*KINDS, ALWAYS)}
            | {paid(name): name for name in KINDS},
            seeds=10,
            first_seed=20,
            tests=tests_of("maze", "corner-small"),
            levels=500,
            differences="worlds of 7 cells, seen as symbols by a network of two hidden layers; "
            f"{FIRST.steps / 1e6:g} million steps without such levels, then {MOUSE.steps / 1e6:g} "
            f"million, of which {EARLY} and {LATE} are the first and the last "
            f"{100 * WITHIN:g}\u00a0%, all at one learning rate; then {PAID.steps / 1e6:g} million "
            "with cheese anywhere for those that are paid",
        )
    },
    find=find,
)
