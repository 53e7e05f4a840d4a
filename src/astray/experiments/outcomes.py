"""What agents reached first, as findings: shares, plots and videos of a work's episodes.

Everywhere the policy "sampled" stands for the agents: as in the original, actions are drawn.
"""

from __future__ import annotations

import numpy as np
import polars as pl

from astray.analysis import video
from astray.analysis.estimates import Estimate, estimate_mean, estimate_paired
from astray.analysis.outcomes import MISGENERALIZED, load_shift, matrix, outcomes_of, shares
from astray.analysis.policies import Walk
from astray.analysis.runs import open_run
from astray.experiments import figures
from astray.experiments.report import Plot, Scene, Table, Video
from astray.experiments.spec import SPREADS, Plan, Test, Work
from astray.report.claims import rounded
from astray.training import checkpoint
from astray.training.config import Config
from astray.training.folders import read_config

AGENTS = "sampled"
LONGEST = 120  # steps of an episode that are recorded


def share(episodes: pl.DataFrame, test: str, outcome: str, *, minus: str | None = None) -> Estimate:
    """The share of the agents' episodes in a test with an outcome, less that with another."""
    part = episodes.filter(pl.col("test") == test, pl.col("policy") == AGENTS)
    came = matrix(part, pl.col("outcome") == outcome)
    if minus:
        return estimate_paired(came, matrix(part, pl.col("outcome") == minus))
    return estimate_mean(came)


def first(work: Work, test: str, agent: str, outcome: str) -> np.ndarray:
    """Whether an outcome came about, [agents, levels], in a test's levels that tell goals apart."""
    played = work.episodes.filter("distinguishing", policy=AGENTS, test=test, agent=agent)
    return matrix(played, pl.col("outcome") == outcome)


def misgeneralized(work: Work, test: str, agent: str) -> np.ndarray:
    """Whether the proxy came first, [agents, levels], in a test's levels that tell goals apart."""
    return first(work, test, agent, MISGENERALIZED)


def outcome_tables(work: Work) -> tuple[Table, Table]:
    """How often each outcome came about, in all levels and in the distinguishing ones."""
    by = ("agent", "policy", "test")
    apart, names = work.episodes.filter("distinguishing"), outcomes_of(work.plan.game)
    return (
        Table("outcomes", "All levels", shares(work.episodes, by, names)),
        Table("distinguishing", "Distinguishing levels", shares(apart, by, names)),
    )


def outcome_plots(work: Work, tables: tuple[Table, Table]) -> tuple[Plot, Plot]:
    """Bars of `outcome_tables`, a panel a test."""
    captions = (
        "Which goal was reached first, in all levels.",
        "Likewise, in the distinguishing levels: the shortest way to either does not "
        "pass the other.",
    )
    shown = [_who_and_where(work.plan, table.frame) for table in tables]
    first, second = (
        Plot(table.name, caption, figures.outcome_bars(data), data)
        for table, caption, data in zip(tables, captions, shown, strict=True)
    )
    return first, second


def _who_and_where(plan: Plan, table: pl.DataFrame) -> pl.DataFrame:
    """`shares` as `figures.outcome_bars` wants them, the agents first."""
    shift = load_shift(plan.game, next(iter(plan.tests.values())).shift)
    scripts = {Walk(goal).name: f"walks to the {goal}, blind to all else" for goal in shift.proxies}
    scripts |= {Walk(shift.intended).name: f"walks to the {shift.intended}", "random": "random"}
    count = f"{plan.seeds} agents" if plan.seeds > 1 else "one agent"
    named = [f"{name}: {count}" if len(plan.agents) > 1 else count for name in plan.agents]
    order = {**dict(zip(plan.agents, named, strict=True)), **scripts}
    where = {name: f"{test.name}: {name}" for name, test in plan.tests.items()}
    return (
        table.with_columns(
            who=pl.coalesce("agent", "policy").replace(order), where=pl.col("test").replace(where)
        )
        .sort(
            pl.col("where").replace_strict(list(where.values()), range(len(where))),
            pl.col("who").replace_strict(list(order.values()), range(len(order))),
            maintain_order=True,
        )
        .select("who", "where", "outcome", "mean", "low", "high")
    )


def curves(work: Work) -> pl.DataFrame:
    """What all trainings measured: agent (its name), seed, steps, and the metrics.

    What episodes were like is null until the first could have timed out: till then only those
    had ended that ended early.
    """
    tables = []
    for name, runs in work.runs.items():
        for run in runs:
            config = read_config(run)
            table = pl.DataFrame(checkpoint.metrics(run), infer_schema_length=None)
            tables.append(
                table.with_columns(
                    agent=pl.lit(name), seed=pl.lit(config.seed), **fair(table, config)
                )
            )
    return pl.concat(tables, how="diagonal_relaxed")


def fair(table: pl.DataFrame, config: Config) -> dict[str, pl.Expr]:
    """The columns of a training's metrics that tell of episodes, null where those are few."""
    iteration = pl.col("steps") // config.batch
    rounds = {"training": (iteration, config.training_variant())}
    if config.validation:
        every = config.validation_every
        rounds["validation"] = ((iteration + every - 1) // every, config.validation_variant())
    return {
        column: pl.when(rounds[which][0] * config.num_steps >= rounds[which][1].time_limit).then(
            pl.col(column)
        )
        for column in table.columns
        if (which := column.split("/")[0]) in rounds
    }


def curve_plot(
    work: Work,
    metric: str = "return",
    label: str = "return",
    caption: str = "Mean return of recent episodes while training.",
) -> Plot:
    """A metric of recent episodes while training, on both variants, for agents of each name."""
    data = curves(work)
    series = {f"training/{metric}": "training variant", f"validation/{metric}": "test variant"}
    there = {column: name for column, name in series.items() if column in data.columns}
    name = "curves" if metric == "return" else f"curves-{metric.replace('_', '-')}"
    return Plot(name, caption, figures.learning_curves(data, there, label), data)


def settings(plan: Plan) -> dict[str, str]:
    """The settings of the agents; of those of several names, all that differs with its names."""
    every = {name: config.flat() for name, config in plan.agents.items()}
    told = {}
    for key in plan.config.flat():
        values = {name: str(config[key]) for name, config in every.items()}
        alike = len(set(values.values())) == 1
        told[key] = (
            values.popitem()[1] if alike else ", ".join(f"{n}: {v}" for n, v in values.items())
        )
    near, far = (f"{100 * effect:.0f}\u00a0%" for effect in plan.power()[: len(SPREADS)])
    return told | {
        "seeds": str(plan.seeds),
        "levels evaluated": str(plan.levels),
        "found with a power of 80\u00a0%": f"shares {near} from their bound, or {far} where agents "
        f"differ most, by a standard deviation of {100 * max(SPREADS):g}\u00a0%",
    }


def videos(work: Work, *, trained: Test, tested: Test, agent: str | None = None) -> list[Video]:
    """An agent in a training level and a test level of one number, for each outcome of the test.

    The commonest outcome first; of each the first level that distinguishes the goals and has a
    longer way to the proxy (without one, the intended goal) than most.
    """
    plan = work.plan
    name = agent or next(iter(work.runs))
    player, config = open_run(work.runs[name][0])
    game, shift = plan.game, load_shift(plan.game, tested.shift)
    where = next(key for key, test in plan.tests.items() if test == tested)
    apart = work.episodes.filter("distinguishing", test=where)
    goal = (*shift.proxies, shift.intended)[0]
    way = pl.col(game.event(goal))
    far = apart.filter(policy=Walk(goal).name).filter(way > way.median())
    mine = apart.filter(policy=AGENTS, agent=name, seed=config.seed)
    common = mine["outcome"].value_counts(sort=True)
    shown = []
    for outcome, count in common.rows():
        levels = mine.filter(outcome=outcome).join(far, on="level", how="semi")["level"]
        for level in levels[:1].to_list():
            pair = [
                video.play(
                    player, game, test.variant_for(config), level, pixels=288, longest=LONGEST
                )
                for test in (trained, tested)
            ]
            captions = [f"{test.name} {level}" for test in (trained, tested)]
            frames = video.beside(*(episode.frames for episode in pair), captions=captions)
            path = work.folder / "videos" / f"{outcome.replace(' ', '-')}.mp4"
            video.write_mp4(frames, path, fps=8)
            video.write_gif(frames, path.with_suffix(".gif"), fps=8)
            shown.append(
                Video(
                    f"{outcome.capitalize()}, as in {rounded(count / len(mine))} of the levels "
                    f"that distinguish the goals: level {level} as in training, and in the test.",
                    path,
                    None
                    if tested.knobs or tested.name != tested.variant
                    else Scene(work.runs[name][0], tested.variant, level),
                )
            )
    return shown
