"""A page that compares agents in the same levels: outcomes, differences, curves, videos."""

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from astray import world
from astray.acting import Policy
from astray.analysis import video
from astray.analysis.estimates import CONFIDENCE, estimate_paired, quantile
from astray.analysis.outcomes import INTENDED, MISGENERALIZED, load_shift, matrix, name_of
from astray.analysis.policies import scripts_of
from astray.analysis.results import APART, Result
from astray.analysis.runs import evaluate_policies, names_of
from astray.analysis.trained import Agent
from astray.estimate import Estimate
from astray.experiments.outcomes import STREAMS, curve_plot, table_of
from astray.experiments.videos import repeats
from astray.figures import charts
from astray.files import check_free, check_writable, files_aside
from astray.game import Game, Shift, Variant
from astray.report.claims import holm, nonzero
from astray.report.findings import Code, Item, Plot, Section, Table, Video
from astray.report.page import write_page
from astray.training.folders import AgentFolder
from astray.training.log import METRICS
from astray.validation import of_kind, path_of
from astray.world import Failed, Silent, World, WorldVariant

PAGE, WRITER = "compare.html", "astray compare"
SIGN = f'<meta name="generator" content="{WRITER}">'.encode()  # in it
MOST = 8  # agents beside each other
SIDE, LONGEST = 224, 120  # pixels of a video, steps of an episode in it
COMPARED = (INTENDED, MISGENERALIZED)
DIFFERENCES = (
    "Rate of the first agent minus the second's, in the levels that distinguish the goals if there "
    "are any; whether two differ is corrected for the number of rows (Holm)"
)


def compare(
    policies: Sequence[Policy],
    game: str | Game | World,
    shift: str | Shift,
    levels: np.ndarray | range,
    folder: str | Path,
    *,
    variant: str | Variant | WorldVariant | None = None,
    command: str = "",
    longest: int | None = None,
) -> Path:
    """Play agents in the same levels, and write a page that compares them; return its path.

    Args:
        policies: Two to eight agents or other policies, in the order of the page.
        variant: None for the shift's test variant.
        folder: Folder for compare.html, its figures and videos.
        command: Command that repeats the page, to be shown on it.
        longest: Steps after which an episode is truncated; None for no limit.

    Raises:
        ValueError: If there are fewer or more policies, two of one name, or a World of streams.
        OSError: If the folder has files of these names that astray did not write, or no room.
    """
    of_kind("policies", policies, Sequence)
    names = names_of(policies)
    if not 2 <= len(names) <= MOST or len({*names}) < len(names):
        raise ValueError(f"compare takes 2 to {MOST} agents of different names; got {names}")
    check_free(folder := path_of("folder", folder), PAGE, SIGN, ("figures", "videos"))
    check_writable(folder / PAGE)
    between, rules = load_shift(game, shift), world.find(game)
    where: Any = variant or between.test
    if isinstance(rules, World) and not rules.repeats:
        raise ValueError(f"{rules.name} has no levels to compare agents in: {STREAMS}")
    for one in policies:
        rules.drawn(one.art, rules.variant(where))  # in the videos, also where it sees symbols
    short = _short(names, {one.name for one in scripts_of(rules, between)})
    players = dict(zip(short.values(), policies, strict=True))
    curves = _curves(players)  # before the work, as metrics may be damaged
    result = evaluate_policies(policies, game, shift, levels, variant=variant, longest=longest)
    names = [*short.values()]
    called = dict(zip(result.agents, names, strict=True))  # a training may write checkpoints now
    rates, episodes = (one.with_columns(pl.col("policy").replace(called)) for one in result)
    result = replace(result, rates=rates, episodes=episodes, agents=(*names,))
    place = pl.col("policy").cast(pl.Enum([*dict.fromkeys([*names, *result.rates["policy"]])]))
    rates = result.rates.sort(pl.col("levels_played") != APART, place, maintain_order=True)
    differences = paired(result, names)
    named = (name for name, one in rules.variants.items() if one == where)
    told: dict[str, Sequence[Item]] = {
        "": [*result.verdict.splitlines(), Code(command or WRITER)],
        "Outcomes": [_outcomes(rates), Table("outcomes", "Which goal was reached first", rates)],
        "In the same levels": [Table("differences", DIFFERENCES, differences)],
    }
    with files_aside(folder, PAGE, SIGN) as aside:
        told["Side by side"] = _videos(players, game, where, result, aside, longest)
        told["Learning curves"] = curves
        write_page(
            aside / PAGE, f"{', '.join(names)} in {next(named, name_of(where))}",
            [Section(heading, items) for heading, items in told.items()],
            figures=aside / "figures", answer=_answer(differences, between), sign=WRITER,
        )  # fmt: skip
    return folder / PAGE


def _short(names: Sequence[str], scripts: set[str]) -> dict[str, str]:
    """Return names without the folders that all runs among them lie in, if none is a script's."""
    folders = [Path(name).parent.parts for name in names if len(Path(name).parts) > 1]
    alike = itertools.takewhile(lambda parts: len({*parts}) == 1, zip(*folders, strict=False))
    shared = f"{Path(*(part for part, *_ in alike))}{os.sep}"
    short = {name: name.removeprefix(shared) for name in names}
    alone = {*short.values()}.isdisjoint(scripts.difference(names))
    return short if alone and len({*short.values()}) == len(names) else {n: n for n in names}


def paired(result: Result, names: Sequence[str]) -> pl.DataFrame:
    """Return the difference of each two agents in the same levels: a row per pair and outcome.

    Columns: first, second, outcome, mean, low and high (rate of the first minus the second's, with
    a 95 % interval over levels), differ (whether the interval excludes 0), levels.
    """
    pairs: dict[tuple[str, str, str], Estimate] = {}
    apart = APART in result.rates["levels_played"]
    part = result.episodes.filter("distinguishing") if apart else result.episodes
    for first, second in itertools.combinations(names, 2):
        for outcome in COMPARED:
            came = pl.col("outcome") == outcome
            one, other = (matrix(part.filter(policy=name), came) for name in (first, second))
            pairs[first, second, outcome] = estimate_paired(one, other)
    table = table_of(pairs, "first", "second", "outcome").rename({"n": "levels"})
    differ = pl.Series("differ", holm([*map(nonzero, pairs.values())]))
    return table.insert_column(table.width - 1, differ)


def _answer(differences: pl.DataFrame, shift: Shift) -> str:
    """Return the verdict: the largest certain difference in misgeneralization.

    In a shift without proxies, it is that in the intended goal.
    """
    outcome, does, goal = (
        (MISGENERALIZED, "misgeneralizes", "a proxy")
        if shift.proxies
        else (INTENDED, f"reaches {shift.intended}", shift.intended)
    )
    rows = differences.filter("differ", outcome=outcome)
    if rows.is_empty():
        pairs = differences.select("first", "second").unique()
        who = "They do not" if len(pairs) == 1 else "No two of them"
        return f"{who} differ for certain in how often {goal} comes first."
    most = rows.sort(pl.col("mean").abs(), descending=True).row(0, named=True)
    sign = 1 if most["mean"] > 0 else -1
    more, less = (most["first"], most["second"])[::sign]
    pairs, freedom = len(differences.filter(outcome=outcome)), most["levels"] - 1
    wider = quantile(freedom, 1 - (1 - CONFIDENCE) / 2 / pairs) / quantile(freedom)
    ends = (most["mean"] + wider * (most[end] - most["mean"]) for end in ("low", "high"))
    low, high = sorted(100 * min(1.0, max(0.0, sign * end)) for end in ends)
    among = f", as the largest of {pairs} (Bonferroni)" * (pairs > 1)
    return (
        f"{more} {does} more often than {less}: {goal} comes first in "
        f"{abs(100 * most['mean']):.1f} percentage points more of the same {most['levels']:,} "
        f"levels (95\u00a0% interval {low:z.1f} to {high:z.1f}{among})."
    )


def _outcomes(rates: pl.DataFrame) -> Plot:
    which = rates["levels_played"][0]
    data = (
        rates.filter(levels_played=which)
        .with_columns(who="policy", where=pl.lit(f"{which} levels"))
        .select("who", "where", "outcome", "mean", "low", "high")
    )
    return Plot("outcomes", "Which goal was reached first.", charts.outcome_bars(data), data)


def _curves(players: Mapping[str, Policy]) -> list[Plot]:
    """Plot the returns of trainings, of those agents whose folder has them; in short ones none."""
    runs = {
        name: [AgentFolder.of(one.path).path]
        for name, one in players.items()
        if isinstance(one, Agent) and (AgentFolder.of(one.path).path / METRICS).exists()
    }
    plots = [curve_plot(runs)] if runs else []
    return [plot for plot in plots if any(axes.has_data() for axes in plot.figure.axes)]


def _videos(
    players: Mapping[str, Policy],
    game: Any,
    variant: Any,
    result: Result,
    folder: Path,
    longest: int | None,
) -> Sequence[Item]:
    """Record all agents in the first level in which most of their outcomes differ."""
    mine = result.episodes.filter(pl.col("policy").is_in(players))
    kinds = mine.group_by("level", maintain_order=True).agg(
        pl.col("outcome").n_unique(), pl.col("distinguishing").first()
    )
    differing = kinds.sort("outcome", "distinguishing", descending=True, maintain_order=True)
    level = int(differing["level"][0])
    most = min(longest or LONGEST, LONGEST)
    try:
        shown = {
            name: video.play(one, game, variant, level, pixels=SIDE, longest=most)
            for name, one in players.items()
        }
    except (Failed, Silent) as error:
        return [f"There is no video: {error}."]
    rows = {row["policy"]: row for row in mine.filter(level=level).to_dicts()}
    anew = [name for name, one in shown.items() if not repeats(one, rows[name], most)]
    captions = [f"{name}: {rows[name]['outcome']}" for name in players]
    path = folder / "videos" / "together.mp4"
    together = video.beside(*(one.frames for one in shown.values()), captions=captions)
    video.write(together, path, fps=8)
    told = "in it they have the same outcome, as in all levels"
    if differing["outcome"][0] > 1:
        told = "the first in which most of their outcomes differ"
    if anew:
        told += f". Played again for this video, {', '.join(anew)} did otherwise"
    return [Video(f"Level {level}: {told}.", path)]
