"""Minimax-regret curricula and domain randomisation: shared parts of both experiments."""

from dataclasses import replace
from functools import partial
from typing import Any

import polars as pl
from matplotlib.figure import Figure

from astray.analysis.estimates import Estimate, estimate_difference, estimate_mean
from astray.analysis.outcomes import INTENDED, MISGENERALIZED, matrix
from astray.experiments import outcomes
from astray.experiments.outcomes import of
from astray.experiments.spec import Experiment, Plan, Work, tests_of
from astray.figures import charts
from astray.report.claims import Claim, above, below, near_zero, rounded
from astray.report.findings import Findings, Plot, Table
from astray.training.config import PRESETS, Config

FRACTIONS = (0.0, 0.001, 0.01, 0.1)  # of training distinguishing levels, alpha in the paper
DR, PLR, IDENTITY, CONSTANT = "DR", "PLR", "ACCEL, identity", "ACCEL, constant"
METHODS: dict[str, dict[str, Any]] = {
    DR: {},
    PLR: {"sampler": "plr", "score": "regret"},
    IDENTITY: {"sampler": "accel", "score": "regret", "mutation": "identity"},
    CONSTANT: {"sampler": "accel", "score": "regret", "mutation": "constant"},
}
FEW, SOME, MANY = FRACTIONS[1:]
OFTEN, SELDOM, BETTER, MORE, NEAR = 0.5, 0.2, 0.1, 2.0, 0.1  # bounds of the claims
DOSES = (0.5, 0.9)  # more fractions of DR: as many as the buffers of ACCEL come to hold
TIMES = 16  # size of the larger buffer
LARGE = f"PLR, {TIMES} times the buffer, 1\u00a0%"
ORACLE = "trained in the test's levels throughout"  # a ceiling for every method
LAST = 0.25  # of a training, over which the buffer is looked at
TRAINED, TESTED = "in training", "in the test"


def name_of(method: str, fraction: float) -> str:
    """Return the name of the agents of a method and a fraction."""
    return f"{method}, {100 * fraction:g}\u00a0%"


def plan(
    shift: str, knobs: dict[str, Any], seeds: int, levels: int, differences: str, **training: Any
) -> Plan:
    """Return a plan with agents of every method and fraction, on a shift's training variant."""
    tests = tests_of("maze", shift)
    train, test = (one.variant for one in tests.values())
    base = replace(PRESETS["small"], variant=train, validation=test, knobs=knobs, **training)
    agents: dict[str, Config] = {}
    for method, settings in METHODS.items():
        for fraction in FRACTIONS:
            few = knobs | ({"shift_probability": fraction} if fraction else {})
            agents[name_of(method, fraction)] = base.changed(knobs=few, **settings)
    for dose in DOSES:
        agents[name_of(DR, dose)] = base.changed(knobs=knobs | {"shift_probability": dose})
    few = knobs | {"shift_probability": SOME}
    agents[LARGE] = base.changed(knobs=few, **METHODS[PLR], buffer=TIMES * base.sampler.buffer)
    agents[ORACLE] = base.changed(variant=test)
    return Plan(agents=agents, seeds=seeds, tests=tests, levels=levels, differences=differences)


def find(proxy: str, work: Work) -> Findings:
    table, buffers, ceiling = by_fraction(work), in_buffers(work), against_training(work)
    told = {
        method: ", ".join(
            rounded(row["mean"])
            for row in table.filter(method=method, what=MISGENERALIZED).to_dicts()
        )
        for method in METHODS
    }
    fractions = ", ".join(f"{100 * fraction:g}\u00a0%" for fraction in FRACTIONS)
    return Findings(
        answer=f"In distinguishing levels, mice go to the {proxy} first, with {fractions} "
        "of training levels that do: "
        + "; ".join(f"{told[method]} ({method})" for method in METHODS)
        + ".",
        claims=claims(work, buffers),
        plots=[
            Plot(
                "misgeneralization",
                f"Episodes that reach the {proxy} first, in distinguishing levels, "
                "with 95\u00a0% intervals, the spread between agents pooled over all kinds.",
                over_fractions(
                    table.filter(what=MISGENERALIZED),
                    "fraction of episodes",
                    whiskers=True,
                    limits=(-0.02, 1.02),
                    percent="y",
                ),
                table.filter(what=MISGENERALIZED),
            ),
            Plot(
                "return",
                "Mean return in the same levels; 10 is all there is.",
                over_fractions(table.filter(what="return"), "return", whiskers=True),
                table.filter(what="return"),
            ),
            Plot(
                "ceiling",
                "The goal in distinguishing levels against the goal in levels like those of the "
                "training, a point for each fraction. Methods are better to the upper right; no "
                f"method is expected above the mice {ORACLE}.",
                ceiling_figure(ceiling),
                ceiling,
            ),
            Plot(
                "buffer",
                "The fraction of the buffer's levels whose goal is placed as in the test, in the "
                f"last quarter of training, a dot an agent; {DR} plays new levels as they come.",
                buffer_figure(buffers),
                buffers,
            ),
        ],
        videos=outcomes.videos(work, agent=name_of(DR, 0.0)),
        tables=[
            Table("by-fraction", "Distinguishing levels", table),
            Table("ceiling", "The goal in both kinds of levels", ceiling),
            Table("buffers", "Levels of the test's kind in the buffer", buffers),
            *outcomes.outcome_tables(work),
        ],
        settings=outcomes.settings(work.plan)
        | {
            "steps": f"{work.plan.config.steps:,} that are learned from; PLR and ACCEL play about "
            "two more for each of those, to score levels",
            "levels of the test": "none that any training draws under any number; a level that "
            "ACCEL makes by mutation may be one of them",
        },
    )


def by_fraction(work: Work) -> pl.DataFrame:
    """Return columns method, fraction, what (outcome or return) and those of an estimate."""
    values = {
        MISGENERALIZED: pl.col("outcome") == MISGENERALIZED,
        INTENDED: pl.col("outcome") == INTENDED,
        "return": pl.col("return"),
    }
    rows = []
    for what, value in values.items():
        kinds = {
            name: matrix(of(work, TESTED, name).filter("distinguishing"), value)
            for name in work.plan.agents
        }
        rows += [
            {"method": method, "fraction": fraction, "what": what}
            | vars(estimate_mean(kinds[name_of(method, fraction)], pool=list(kinds.values())))
            for method in METHODS
            for fraction in FRACTIONS
        ]
    return pl.DataFrame(rows)


def against_training(work: Work) -> pl.DataFrame:
    """Return how often each kind of agents reaches the goal first in the test and in training.

    Columns: method, fraction (null for the oracle and the larger buffer), training (rate), mean,
    low, high (rate in distinguishing levels).
    """
    kinds = outcomes.first(work, TESTED, INTENDED)
    named = {name_of(m, f): (m, f) for m in METHODS for f in (*FRACTIONS, *DOSES)}
    rows = []
    for name, came in kinds.items():
        method, fraction = named.get(name, (name, None))
        mine = of(work, TRAINED, name)
        found = estimate_mean(came, pool=list(kinds.values()))
        rows.append(
            {"method": method, "fraction": fraction}
            | {"training": (mine["outcome"] == INTENDED).mean()}
            | {"mean": found.mean, "low": found.low, "high": found.high}
        )
    return pl.DataFrame(rows, schema_overrides={"fraction": pl.Float64})


def in_buffers(work: Work) -> pl.DataFrame:
    """Return columns method, fraction, seed, in_buffer (of its levels), amplified (ratio)."""
    measured = outcomes.curves(work.runs)
    rows = []
    for method in METHODS:
        for fraction in FRACTIONS if METHODS[method] else ():
            part = measured.filter(agent=name_of(method, fraction))
            last = part.filter(pl.col("steps") > pl.col("steps").max() * (1 - LAST))
            means = last.group_by("seed").agg(pl.col("levels/shifted_in_buffer").mean())
            for seed, mean in means.sort("seed").rows():
                amplified = mean / fraction if fraction else None
                rows.append(
                    {"method": method, "fraction": fraction, "seed": seed}
                    | {"in_buffer": mean, "amplified": amplified}
                )
    return pl.DataFrame(rows, schema_overrides={"amplified": pl.Float64})


def claims(work: Work, buffers: pl.DataFrame) -> list[Claim]:
    """Return the claims of the paper's abstract, with bounds set before any run."""
    wrong, right = (outcomes.first(work, TESTED, which) for which in (MISGENERALIZED, INTENDED))
    kinds = list(wrong.values())

    def often(method: str, fraction: float) -> Estimate:
        return estimate_mean(wrong[name_of(method, fraction)], pool=kinds)

    def gain(method: str, fraction: float) -> Estimate:
        names = name_of(DR, fraction), name_of(method, fraction)
        return estimate_difference(*(wrong[name] for name in names), pool=kinds)

    amplified = buffers.filter(pl.col("method") != DR, fraction=SOME)["amplified"].to_list()
    least = min(amplified)
    without = [often(method, 0.0) for method in METHODS]
    lowest = min(without, key=lambda estimate: estimate.low)
    percent = f"{100 * FEW:g}\u00a0%", f"{100 * SOME:g}\u00a0%", f"{100 * MANY:g}\u00a0%"
    return [
        above(
            f"Domain randomisation misgeneralizes where {percent[0]} of levels distinguish the "
            "goals.", "fails at small fractions (no figure at hand)", name_of(DR, FEW),
            often(DR, FEW), OFTEN,
        ),
        below(
            f"Domain randomisation does not where {percent[2]} of levels do.",
            "enough such levels help (no figure at hand)", name_of(DR, MANY),
            often(DR, MANY), SELDOM,
        ),
        *(
            above(
                f"{method} misgeneralizes less than domain randomisation at {percent[k]}.",
                "curricula of regret hold longer (no figure at hand)",
                f"{name_of(DR, fraction)} minus {name_of(method, fraction)}",
                gain(method, fraction), BETTER,
            )
            for method, k, fraction in (
                (PLR, 1, SOME), (IDENTITY, 1, SOME), (CONSTANT, 1, SOME), (CONSTANT, 0, FEW)
            )
        ),
        Claim(
            "The buffers hold more distinguishing levels than are generated, at "
            f"{percent[1]}.", "amplified (no figure at hand)",
            f"least of {len(amplified)} agents: {least:.1f} times; "
            f"supported if above {MORE:g} times",
            least > MORE,
        ),
        near_zero(
            f"At {percent[1]}, ACCEL with identity edits reaches the cheese first as often as mice "
            f"{ORACLE}.",
            "not measured", f"{ORACLE} minus {name_of(IDENTITY, SOME)}",
            estimate_difference(
                right[ORACLE], right[name_of(IDENTITY, SOME)], pool=[*right.values()]
            ),
            NEAR,
        ),
        above(
            "Without any such level every method misgeneralizes.",
            "not in all cases (no figure at hand)", "the method that does least", lowest, OFTEN,
        ),
    ]  # fmt: skip


def ceiling_figure(table: pl.DataFrame) -> Figure:
    """Plot the goal in distinguishing levels against that in training's, a line a method."""
    return charts.curves(
        table.sort("fraction", nulls_last=True), x="training", line="method",
        label="cheese first in distinguishing levels", percent="xy", limits=(-0.02, 1.02),
        whiskers=True, x_label="cheese first in levels like those of the training",
    )  # fmt: skip


def buffer_figure(buffers: pl.DataFrame) -> Figure:
    """Plot the fraction of distinguishing levels in the buffers over the fraction generated."""
    each = buffers.select("method", "fraction", "seed", mean="in_buffer")
    means = each.group_by("method", "fraction", maintain_order=True).agg(pl.col("mean").mean())
    new = pl.DataFrame({"method": DR, "fraction": FRACTIONS, "mean": FRACTIONS})
    every = pl.concat([new, each, means], how="diagonal_relaxed")  # methods have their colours
    return over_fractions(every, "fraction of the buffer's levels", each="seed", percent="y")


def over_fractions(table: pl.DataFrame, label: str, **how: Any) -> Figure:
    """Plot a line for each method over the fractions, which are evenly spaced."""
    named = pl.col("fraction").replace_strict(
        FRACTIONS, [f"{100 * fraction:g} %" for fraction in FRACTIONS]
    )
    below = "training levels that may distinguish the goals"
    return charts.curves(
        table.with_columns(named), x="fraction", line="method", label=label, x_label=below, **how
    )


def experiment(
    title: str, shift: str, proxy: str, knobs: dict[str, Any], seen: str = "", *, steps: int,
    **training: Any,
) -> Experiment:  # fmt: skip
    """Return the experiment on a shift of Maze, in small worlds.

    Args:
        seen: Change of the observations from the paper's.
        training: Other settings of the trainings that are not the preset's.
    """
    differences = (
        "worlds of 7 cells instead of 13, seen as symbols by a network of two hidden layers; "
        f"{steps // 10**6} million steps instead of 250 and more; rollouts of 64 steps instead "
        "of 128; 4 of the 11 fractions; regret as the solver gives it, which the paper has "
        "beside its estimate"
    )
    return Experiment(
        title=title,
        reproduces="Abdel Sadek et al. 2025, in small",
        question=f"Do curricula of regret keep mice from the {proxy}, where few training levels "
        "tell it from the cheese?",
        sizes={"smoke": plan(shift, knobs, 3, 500, differences + seen, steps=steps, **training)},
        find=partial(find, proxy),
    )
