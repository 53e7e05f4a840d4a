"""Returns during training, for the first agents of every study that trains its own."""

from dataclasses import replace

import numpy as np
import polars as pl

from astray.analysis.estimates import over_agents
from astray.estimate import Estimate
from astray.experiments import outcomes
from astray.experiments.spec import PUBLISHED, Experiment, Plan, Size, Work
from astray.experiments.studies.coinrun import critic_value
from astray.experiments.studies.keys import keys_and_chests
from astray.experiments.studies.maze import colour_or_shape, maze_corner, maze_region
from astray.figures import charts
from astray.report.claims import Claim, above
from astray.report.findings import Findings, Plot, Table
from astray.training.config import Config

# The other studies of CoinRun have the runners of this one.
STUDIES = (
    critic_value.EXPERIMENT,
    colour_or_shape.EXPERIMENT,
    keys_and_chests.EXPERIMENT,
    maze_corner.EXPERIMENT,
    maze_region.EXPERIMENT,
)
TRAIN, TEST = "training variant", "test variant"
SERIES = {TRAIN: "training/return", TEST: "validation/return"}
POINTS = 100  # of a curve, at most; each is the mean over several iterations
LAST = 10  # the end of a training: its last tenth


def find(work: Work) -> Findings:
    measured = returns(work)
    shown, ended = curves(measured), ends(measured)
    told = [
        f"{row['agent']}: {row[TRAIN]:.1f} and {row[TEST]:.1f}"
        for row in ended.drop_nulls(TEST).to_dicts()
    ]
    lines = charts.curves(
        shown.with_columns(pl.col("steps") / 1e6), x="steps", line="series", panel="agent",
        label="return", x_label="million environment steps", sharey=False,
    )  # fmt: skip
    return Findings(
        answer="Returns at the end of training, on the training and on the test variant. "
        f"{'; '.join(told)}.",
        claims=[
            ends_lower(row) for row in ended.to_dicts() if work.plan.agents[row["agent"]].validation
        ],
        plots=[
            Plot(
                "curves",
                "Return of recent episodes while training: the mean of "
                f"{outcomes.settings(work.plan)['seeds']} agents and its 95 % interval over them. "
                "The largest possible return can differ between the variants.",
                lines,
                shown,
            )
        ],
        tables=[Table("ends", "Returns in the last tenth of training, mean of agents", ended)],
        settings=outcomes.settings(work.plan),
    )


def returns(work: Work) -> pl.DataFrame:
    """Return the trainings' metrics: agent, seed, steps, and returns on both variants."""
    measured = outcomes.curves(work.runs)
    missing = [pl.lit(None).alias(c) for c in SERIES.values() if c not in measured.columns]
    return measured.with_columns(missing).select(
        "agent",
        "seed",
        "steps",
        *(pl.col(c).cast(pl.Float64).fill_nan(None).alias(name) for name, c in SERIES.items()),
    )


def curves(measured: pl.DataFrame) -> pl.DataFrame:
    """Return the mean over agents of each name: agent, series, steps, mean, low, high.

    Points are those at which all agents have a value.
    """
    iteration = pl.col("steps").rank("dense").over("agent").cast(pl.Int64) - 1
    per_point = iteration.max().over("agent") // POINTS + 1
    points = (
        measured.with_columns(point=iteration // per_point)
        .unpivot(list(SERIES), index=["agent", "seed", "steps", "point"], variable_name="series")
        .group_by("agent", "series", "point", "seed", maintain_order=True)
        .agg(pl.col("steps").max(), pl.col("value").mean())
        .group_by("agent", "series", "point", maintain_order=True)
        .agg(pl.col("steps").max(), "value")
        .filter(pl.col("value").list.drop_nulls().list.len() == pl.col("value").list.len())
    )
    parts = []
    for part in points.partition_by("agent", "series", maintain_order=True):
        mean, low, high = over_agents(np.array(part["value"].to_list()).T)
        band = pl.DataFrame({"mean": mean, "low": low, "high": high}).fill_nan(None)
        parts.append(part.select("agent", "series", "steps").hstack(band))
    return pl.concat(parts)


def ends(measured: pl.DataFrame) -> pl.DataFrame:
    """Return the ends of training: agent, both returns, "lower by" in the test and interval."""
    last = measured.filter(pl.col("steps") > pl.col("steps").max().over("agent") * (1 - 1 / LAST))
    seeds = (
        last.group_by("agent", "seed", maintain_order=True)
        .agg(pl.col(*SERIES).mean())
        .with_columns(lower=pl.col(TRAIN) - pl.col(TEST))
    )
    rows = []
    for (agent,), part in seeds.group_by(["agent"], maintain_order=True):
        means = {name: middle_of(part[name])[0] for name in SERIES}
        lower, low, high = middle_of(part["lower"])
        told = {"lower by": lower, "low": low, "high": high, "agents": len(part)}
        rows.append({"agent": agent} | means | told)
    return pl.DataFrame(rows, infer_schema_length=None).fill_nan(None)


def middle_of(values: pl.Series) -> list[float | None]:
    """Return the mean over agents with its interval; None if not measured."""
    if values.null_count():
        return [None] * 3
    return over_agents(values.to_numpy()[:, None])[:, 0].tolist()


def ends_lower(row: dict) -> Claim:
    """Test whether the return ends lower on the test variant than on the training variant."""
    sentence = (
        f"{row['agent']}: training ends with a lower return on the test variant than on the "
        "training variant."
    )
    paper, lower, agents = "lower (a curve)", row["lower by"], row["agents"]
    if row["low"] is None:
        known = "too few episodes ended to tell"
        if lower is not None:
            known = f"lower by {lower:.2f}, without an interval"
        return Claim(sentence, paper, f"{known}; supported if above 0", False)
    found = Estimate(lower, row["low"], row["high"], agents, 1, agents, agents - 1)
    return above(sentence, paper, "lower by", found, told=Estimate.change)


def collected(size: Size) -> Plan:
    """Return a plan with the first agents of each of `STUDIES`."""
    firsts: dict[str, Plan] = {}
    for study in STUDIES:
        plan = study.sizes[size]
        if plan.config not in [first.config for first in firsts.values()]:
            name = f"{plan.config.game} {plan.config.variant}"
            firsts[f"{name}, {study.title}" if name in firsts else name] = plan
    differences = [f"{name}: {plan.differences}" for name, plan in firsts.items()]
    return Plan(
        agents={name: replace(its.config, seed=its.first_seed) for name, its in firsts.items()},
        teachers={
            name: replace(teacher, seed=plan.first_seed)
            for name, plan in firsts.items()
            if isinstance(teacher := plan.teachers.get(next(iter(plan.agents))), Config)
        },
        seeds=min(plan.seeds for plan in firsts.values()),
        levels=1,  # there are no tests
        # Of all that are trained in turn, the slowest.
        speed=min(plan.speed for plan in firsts.values()),
        differences="" if size == "paper" else "; ".join(differences),
    )


EXPERIMENT = Experiment(
    title="Training curves",
    reproduces="Figures 9 to 11",
    question="How do returns on the training and on the test variant change while training?",
    sizes={size: collected(size) for size in STUDIES[0].sizes if size != PUBLISHED},
    find=find,
)
