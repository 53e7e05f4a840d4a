"""What an experiment found: tables, verdicts, figures and videos, in one report."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import polars as pl

from astray import games
from astray.analysis import video
from astray.analysis.outcomes import (
    FAILED,
    INTENDED,
    MISGENERALIZED,
    load_shift,
    matrix,
    shares,
)
from astray.analysis.policies import Walk
from astray.analysis.runs import open_run, playing
from astray.analysis.statistics import Estimate, bootstrap
from astray.experiments import figures, report
from astray.experiments.spec import Claim, Experiment, Plan, Size
from astray.game import Shift
from astray.training import checkpoint

AGENTS = "sampled"  # the policy that stands for the agents; as the original, actions are drawn
LONGEST = 120  # steps of an episode that are filmed


def tell(
    experiment: Experiment,
    name: str,
    size: Size,
    plan: Plan,
    runs: Sequence[Path],
    episodes: pl.DataFrame,
    folder: Path,
) -> Path:
    """Write tables, figures, videos and report.html of `episodes` to `folder`; the report."""
    shift = load_shift(plan.config.game, plan.shift)
    everywhere, apart = shares(episodes), shares(episodes.filter("tells_apart"))
    write_table(everywhere, folder / "tables", "outcomes")
    write_table(apart, folder / "tables", "outcomes-telling-apart")
    learned = curves(runs)
    write_table(learned, folder / "tables", "curves")
    verdicts = [verdict(claim, episodes) for claim in experiment.claims]
    names = {shift.train: "in training", shift.test: "in the test"}

    figures.save(figures.outcome_bars(named(everywhere, plan, shift, names)), folder, "outcomes")
    figures.save(figures.outcome_bars(named(apart, plan, shift, names)), folder, "telling-apart")
    series = {"training/return": "training variant", "validation/return": "test variant"}
    figures.save(figures.learning_curves(learned, series, "return"), folder, "curves")

    settings = asdict(plan.config) | {"seeds": plan.seeds, "levels evaluated": plan.levels}
    told = report.Report(
        name=name,
        title=experiment.title,
        reproduces=experiment.reproduces,
        question=experiment.question,
        answer=answer(everywhere, apart, shift),
        size=size,
        smaller=plan.smaller,
        verdicts=verdicts,
        videos=film(plan, shift, runs[0], episodes, folder / "videos"),
        figures=[
            report.Show("Which goal was reached first, in all levels.", folder / "outcomes.png"),
            report.Show(
                "Likewise, in the levels that tell the goals apart: the shortest way to either "
                "does not pass the other.",
                folder / "telling-apart.png",
            ),
            report.Show("Mean return of recent episodes while training.", folder / "curves.png"),
        ],
        tables=[
            report.Table("All levels", everywhere),
            report.Table("Levels that tell the goals apart", apart),
        ],
        settings={name: str(value) for name, value in settings.items()},
        command=f"astray reproduce {name} --size {size}",
    )
    (folder / "verdicts.json").write_text(json.dumps([vars(v) for v in verdicts], indent=2))
    return report.write(told, folder)


def verdict(claim: Claim, episodes: pl.DataFrame) -> report.Verdict:
    """Whether the agents' episodes bear the claim out."""
    part = episodes.filter(pl.col("where") == claim.where, pl.col("policy") == AGENTS)
    value = (pl.col("outcome") == claim.outcome).cast(pl.Float64)
    ours = claim.outcome
    if claim.minus:
        value -= (pl.col("outcome") == claim.minus).cast(pl.Float64)
        ours += f" less {claim.minus}"
    estimate = bootstrap(matrix(part, value))
    return report.Verdict(
        claim.text,
        claim.paper,
        f"{ours}: {percent(estimate)}; holds above {100 * claim.above:g}\u00a0%",
        estimate.low > claim.above,
    )


def percent(estimate: Estimate) -> str:
    """A share and its interval, in words."""
    mean, low, high = (100 * x for x in (estimate.mean, estimate.low, estimate.high))
    return f"{mean:.1f}\u00a0% (95\u00a0% interval {low:.1f} to {high:.1f})"


def answer(everywhere: pl.DataFrame, apart: pl.DataFrame, shift: Shift) -> str:
    """The finding in a sentence or two."""

    def share(table: pl.DataFrame, variant: str, outcome: str) -> str:
        row = table.filter(policy=AGENTS, variant=variant, outcome=outcome).row(0, named=True)
        return f"{100 * row['mean']:.0f}\u00a0%"

    proxy = " or ".join(shift.proxies)
    return (
        f"On unseen training levels the agents reach the {shift.intended} in "
        f"{share(everywhere, shift.train, INTENDED)}. In the test, where the two goals come apart, "
        f"they go to the {proxy} first in {share(apart, shift.test, MISGENERALIZED)} of "
        f"levels, to the {shift.intended} in {share(apart, shift.test, INTENDED)}, and to neither "
        f"in {share(apart, shift.test, FAILED)}."
    )


def named(table: pl.DataFrame, plan: Plan, shift: Shift, names: dict[str, str]) -> pl.DataFrame:
    """`shares` as `figures.outcome_bars` wants them: who did it, where."""
    who = {AGENTS: f"{plan.seeds} agents"}
    who |= {Walk(shift.intended).name: f"walks to the {shift.intended}"}
    who |= {Walk(goal).name: f"walks to the {goal}, blind to all else" for goal in shift.proxies}
    order = [AGENTS, *(Walk(g).name for g in (*shift.proxies, shift.intended)), "random"]
    where = {variant: f"{variant}: {what}" for variant, what in names.items()}
    return (
        table.with_columns(
            who=pl.col("policy").replace(who), where=pl.col("variant").replace(where)
        )
        .sort(pl.col("policy").replace_strict(order, range(len(order))), maintain_order=True)
        .sort(pl.col("variant").replace_strict(list(names), range(len(names))), maintain_order=True)
        .select("who", "where", "outcome", "mean", "low", "high")
    )


def curves(runs: Sequence[Path]) -> pl.DataFrame:
    """The metrics of all runs in one table, with their seed."""
    tables = []
    for run in runs:
        seed = checkpoint.read_config(run).seed
        table = pl.DataFrame(checkpoint.metrics(run), infer_schema_length=None)
        tables.append(table.with_columns(seed=pl.lit(seed)))
    return pl.concat(tables, how="diagonal_relaxed")


def write_table(table: pl.DataFrame, folder: Path, name: str) -> None:
    """`table` as CSV, for people, and Parquet."""
    folder.mkdir(exist_ok=True)
    table.write_csv(folder / f"{name}.csv")
    table.write_parquet(folder / f"{name}.parquet")


def film(
    plan: Plan, shift: Shift, run: Path, episodes: pl.DataFrame, folder: Path
) -> list[report.Show]:
    """An agent in the training and the test variant of a level, side by side, for each outcome.

    The commonest outcome first; of each the first level that tells the goals apart and has a
    longer way to the proxy than most.
    """
    agent, config = open_run(run)
    game = games.load(config.game)
    tested = episodes.filter("tells_apart", where="test")
    way = pl.col(game.goals[shift.proxies[0]])
    far = tested.filter(policy=Walk(shift.proxies[0]).name).filter(way > way.median())
    mine = tested.filter(policy=AGENTS, seed=config.seed)
    common = mine["outcome"].value_counts(sort=True)
    shown = []
    for outcome, count in common.rows():
        levels = mine.filter(outcome=outcome).join(far, on="level", how="semi")["level"]
        for level in levels[:1].to_list():
            pair = [
                video.play(agent, game.name, made, level, pixels=288, longest=LONGEST)
                for made in (playing(config, n, {}) for n in (shift.train, shift.test))
            ]
            captions = [f"{shift.train} {level}", f"{shift.test} {level}"]
            frames = video.beside(*(episode.frames for episode in pair), captions=captions)
            path = folder / f"{outcome.replace(' ', '-')}.mp4"
            video.write_mp4(frames, path, fps=8)
            video.write_gif(frames, path.with_suffix(".gif"), fps=8)
            share = f"{100 * count / len(mine):.0f}\u00a0%"
            caption = f"{outcome.capitalize()}, as in {share} of these levels: one agent in level "
            caption += f"{level} as in training, and in the test."
            shown.append(report.Show(caption, path))
    return shown
