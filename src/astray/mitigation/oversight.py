"""Asking for help: a novice hands over to an expert if a score says so, at a cost.

    scores = [OfLogits(agent, "entropy"), Chance()]
    trial = Trial("maze", shift, training, range(500), test, range(100_000, 100_500))
    table = curves(agent, Walk("cheese"), scores, trial)
    areas = area(table)

As in Trinh et al. (2024) and Danesh et al. (2025), thresholds are percentiles of the score when
the novice plays training levels alone, so nothing about the test is needed.
"""

import itertools
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import polars as pl

from astray import games
from astray.acting import Levels, Policy
from astray.analysis.estimates import ends, estimate_mean, quantile
from astray.analysis.outcomes import INTENDED, MISGENERALIZED, label
from astray.game import Game, Shift, Variant
from astray.mitigation.helped import (
    MOMENTS,
    Alone,
    Granularity,
    Helped,
    Watch,
    play,
    play_alone,
    unheeded,
)
from astray.mitigation.uncertainty import Always, Score
from astray.validation import finite, of_kind, one_of

PERCENTILES = (5.0, 10.0, 25.0, 50.0, 75.0, 90.0, 95.0, 99.0)


@dataclass(frozen=True, eq=False)
class Trial:
    """Conditions of a trial of asking for help: calibration levels, test levels, and goals."""

    game: str | Game
    shift: Shift
    training: Variant
    training_levels: Levels
    test: Variant
    test_levels: Levels
    watch: Watch | None = None

    def __post_init__(self) -> None:
        of_kind("shift", self.shift, Shift)
        of_kind("watch", self.watch, Watch | None)


def training_scores(
    novice: Policy, score: Score, game: str | Game, variant: Variant, levels: Levels
) -> pl.DataFrame:
    """Return the score at each step of the novice alone in training levels, by level."""
    _, said = play_alone(Alone(novice, [score]), game, variant, levels)
    return said.select("level", score="0")


def threshold(scores: pl.DataFrame, percentile: float, granularity: Granularity) -> float:
    """Return the percentile of the score over steps, or over the maxima of levels.

    In "level" mode a single noisy step hands over the rest of the level, so its threshold is
    computed from per-level maxima.

    Args:
        scores: Result of `training_scores`.

    Raises:
        ValueError: If an argument is invalid.
    """
    of_kind("scores", scores, pl.DataFrame)
    finite("percentile", percentile, 0, 100)
    one_of("granularity", granularity, Granularity)
    if granularity == "level":
        scores = scores.group_by("level").agg(pl.col("score").max())
    return float(np.percentile(scores["score"].to_numpy(), percentile))


def curve(
    novice: Policy,
    expert: Policy,
    score: Score,
    trial: Trial,
    granularity: Granularity = "step",
    percentiles: Sequence[float] = PERCENTILES,
) -> pl.DataFrame:
    """Return the `curves` for one score and one granularity."""
    return curves(novice, expert, [score], trial, [granularity], percentiles)


def curves(
    novice: Policy,
    expert: Policy,
    scores: Sequence[Score],
    trial: Trial,
    granularities: Sequence[Granularity] = ("step",),
    percentiles: Sequence[float] = PERCENTILES,
) -> pl.DataFrame:
    """Return the effect of each amount of help: a row per percentile, and for no and full help.

    It covers each score and granularity. Shared episodes, of the novice and the expert alone, are
    played once.

    Columns: score, granularity, percentile (null for no and full help), threshold, help (fraction
    of steps or levels with help), queries (expert's steps per level), return, low, high (95 % over
    levels), intended and misgeneralized (fractions of episodes that reached the intended goal, or
    a proxy, first), seconds (of this curve and its part of shared episodes), the fraction of
    helped levels for each of `MOMENTS` (null without a watch), and gain (return minus that without
    help in the same levels) with its standard error, and levels.
    """
    of_kind("trial", trial, Trial)
    began = time.perf_counter()
    alone, test = Alone(novice, scores), (trial.game, trial.test, trial.test_levels, trial.watch)
    _, known = play_alone(alone, trial.game, trial.training, trial.training_levels)
    of_novice, said = play_alone(alone, *test)
    of_expert = unheeded(*play_alone(Alone(expert, [Always()]), *test), "0", 0.5)
    pairs = list(itertools.product(enumerate(scores), granularities))
    shared, tables = (time.perf_counter() - began) / max(len(pairs), 1), []
    kinds: dict = {"percentile": pl.Float64} | {moment: pl.Float64 for moment in MOMENTS}
    for (k, score), granularity in pairs:
        began = time.perf_counter()
        mine = known.select("level", score=f"{k}")
        limits = [(p, threshold(mine, p, granularity)) for p in percentiles]
        found = [
            (None, np.inf, unheeded(of_novice, said, f"{k}", np.inf)),
            (None, -np.inf, of_expert),
            *(
                (p, limit, play(Helped(novice, expert, score, limit, granularity), *test))
                for p, limit in limits
            ),
        ]
        rows = [
            {
                "score": alone.names[k],
                "granularity": granularity,
                "percentile": percentile,
                "threshold": limit,
            }
            | _summed(played, of_novice, trial, granularity)
            for percentile, limit, played in found
        ]
        seconds = shared + time.perf_counter() - began
        table = pl.DataFrame(rows, schema_overrides=kinds)
        tables.append(table.with_columns(seconds=pl.lit(seconds)))
    return pl.concat(tables)


def _summed(
    played: pl.DataFrame, alone: pl.DataFrame, trial: Trial, granularity: Granularity
) -> dict:
    """Summarise the episodes with one threshold, beside those of the novice alone."""
    estimate = estimate_mean(played["return"].to_numpy())
    gains = (played["return"] - alone["return"]).to_numpy()
    error = gains.std(ddof=1) / len(gains) ** 0.5 if len(gains) > 1 else np.nan
    outcome = label(played, games.find(trial.game), trial.shift)["outcome"]
    asked = played.filter(pl.col("queries") > 0)
    queries, steps = (int(played[name].sum()) for name in ("queries", "length"))
    by_level, by_step = len(asked) / len(played), queries / steps
    moments = {
        moment: float((asked["moment"] == moment).mean()) if trial.watch and len(asked) else None  # pyrefly: ignore
        for moment in MOMENTS
    }
    return (
        {
            "help": by_level if granularity == "level" else by_step,
            "queries": float(played["queries"].mean()),  # pyrefly: ignore
            "return": estimate.mean,
            "low": estimate.low,
            "high": estimate.high,
            "intended": float((outcome == INTENDED).mean()),  # pyrefly: ignore
            "misgeneralized": float((outcome == MISGENERALIZED).mean()),  # pyrefly: ignore
        }
        | moments
        | {"gain": float(gains.mean()), "error": float(error), "levels": len(gains)}
    )


def least_gain(curves: pl.DataFrame, confidence: float = 0.95) -> tuple[float, float]:
    """Return the smallest gain of all points of `curves`, and a simultaneous lower bound.

    It is Student's t over levels, with Bonferroni's correction, since the worst of many noisy
    points is low by chance.
    """
    of_kind("curves", curves, pl.DataFrame)
    finite("confidence", confidence, 0, 1)
    helped = curves.filter(pl.col("threshold") != np.inf)
    below, bounds = 1 - (1 - confidence) / len(helped), []
    for gain, error, levels in helped.select("gain", "error", "levels").iter_rows():
        square = quantile(levels - 1, below) ** 2
        bounds.append(ends(gain, square * error**2, False, square / levels)[0])
    return float(helped["gain"].to_numpy().min()), float(np.min(bounds))


def area(curves: pl.DataFrame) -> pl.DataFrame:
    """Return the area under each curve of return against help: score, granularity, area.

    Returns are scaled to 0 without help and 1 with full help, and integrated by trapezoids over
    help from 0 to 1; equal amounts of help are averaged. Random help has about 0.5 if each step,
    or level, is worth the same. The area is NaN if the expert is no better than the novice.
    """
    of_kind("curves", curves, pl.DataFrame)
    rows = []
    for (score, granularity), part in curves.group_by(
        ["score", "granularity"], maintain_order=True
    ):
        alone = part.filter(pl.col("threshold") == np.inf)["return"][0]
        best = part.filter(pl.col("threshold") == -np.inf)["return"][0]
        points = part.group_by("help").agg(pl.col("return").mean()).sort("help")
        help_, gain = points["help"].to_numpy(), points["return"].to_numpy() - alone
        worth = np.trapezoid(gain, help_) / (best - alone) if best > alone else np.nan
        rows.append({"score": score, "granularity": granularity, "area": float(worth)})
    return pl.DataFrame(rows)


def net_returns(curves: pl.DataFrame, costs: Sequence[float]) -> pl.DataFrame:
    """Return the best net return of each score for each cost of a query, with fewest queries.

    Columns: score, granularity, cost, net (return minus cost of queries, per level), queries,
    percentile (of the best threshold; null for no or full help).
    """
    of_kind("curves", curves, pl.DataFrame)
    of_kind("costs", costs, Sequence)
    rows = []
    for cost in costs:
        finite("a cost", cost, 0)
        net = curves.with_columns(
            cost=pl.lit(float(cost)), net=pl.col("return") - cost * pl.col("queries")
        )
        best = net.sort("net", -pl.col("queries"), descending=True, maintain_order=True).group_by(
            ["score", "granularity"], maintain_order=True
        )
        rows.append(best.first())
    columns = ["score", "granularity", "cost", "net", "queries", "percentile"]
    return pl.concat(rows).select(columns).sort(["cost", "granularity", "score"])


def when_asked(
    novice: Policy, scores: Sequence[Score], trial: Trial, percentile: float = 95.0
) -> pl.DataFrame:
    """Return when an unhelped novice would first have asked: a row per score and test level.

    Columns: score, those of `play`, and outcome; `moment` is null if it would never have asked.
    """
    of_kind("trial", trial, Trial)
    alone = Alone(novice, scores)
    _, known = play_alone(alone, trial.game, trial.training, trial.training_levels)
    played, said = play_alone(alone, trial.game, trial.test, trial.test_levels, trial.watch)
    played, parts = label(played, games.find(trial.game), trial.shift), []
    for k, name in enumerate(alone.names):
        limit = threshold(known.select("level", score=f"{k}"), percentile, "step")
        asked = unheeded(played, said, f"{k}", limit)
        parts.append(asked.select(pl.lit(name).alias("score"), pl.all()))
    return pl.concat(parts)
