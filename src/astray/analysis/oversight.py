"""Asking for help: a novice that hands over to an expert where a score says so, and what it costs.

    scores = [OfLogits(agent, "entropy"), Chance()]
    trial = Trial("maze", shift, training, range(500), test, range(100_000, 100_500))
    table = curves(agent, Walk("cheese"), scores, trial)
    areas = area(table)

As in Trinh et al. (2024) and Danesh et al. (2025), thresholds are percentiles of the score where
the novice plays training levels alone, so that nothing has to be known of the test.
"""

from __future__ import annotations

import contextlib
import itertools
import time
from collections.abc import Callable, Iterator, Sequence, Sized
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
import polars as pl

from astray import games
from astray.analysis.doubt import Always, Score
from astray.analysis.episodes import Levels, Step, steps
from astray.analysis.estimates import bootstrap
from astray.analysis.given import Measure, see_policy
from astray.analysis.outcomes import INTENDED, MISGENERALIZED, label
from astray.analysis.policies import Agent, Observation, Policy
from astray.bounds import finite, of_kind
from astray.game import Game, Shift, Variant
from astray.words import check_word

Granularity = Literal["step", "level"]
PERCENTILES = (5.0, 10.0, 25.0, 50.0, 75.0, 90.0, 95.0, 99.0)
BEFORE, SEEN, AFTER = "before it was seen", "seen, not passed", "after it was passed"
MOMENTS = (BEFORE, SEEN, AFTER)  # at which help is first asked for


@dataclass(frozen=True)
class Watch:
    """Where an object is for the agent: measures of states [N], booleans.

    seen    it is in view
    passed  the agent has gone by it
    """

    seen: Measure
    passed: Measure


@dataclass(frozen=True, eq=False)
class Trial:
    """What help is tried on: levels to calibrate on, levels to test on, and the goals."""

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


class _Shown:
    """What a policy is shown that has a novice: what the novice sees."""

    novice: Policy

    @property
    def observation(self) -> Observation:
        return self.novice.observation

    @property
    def art(self) -> str:
        return self.novice.art


@dataclass(eq=False)
class Helped(_Shown):
    """A policy of two: where `score` is above `threshold`, the expert acts instead of the novice.

    granularity  "step": for that step; "level": from then on to the level's end

    The expert sees what the novice is shown, and the states.
    """

    novice: Policy
    expert: Policy
    score: Score
    threshold: float
    granularity: Granularity = "step"
    name: str = "helped"
    _asked: dict[int, bool] = field(default_factory=dict, repr=False)  # by level, so far
    _now: dict[int, tuple[float, bool]] = field(default_factory=dict, repr=False)  # score, helped

    def __post_init__(self) -> None:
        for policy in (self.novice, self.expert):
            see_policy(policy)
        check_word("granularity", self.granularity, Granularity)
        _see_score(self.score)
        of_kind("threshold", self.threshold, int | float)  # also infinite: nobody, or everybody
        if isinstance(self.expert, Agent) and self.expert.observation != self.observation:
            raise ValueError(
                f"novice and expert must be shown the same; got {self.observation!r} and "
                f"{self.expert.observation!r}"
            )

    def actions(self, env, observations: np.ndarray) -> np.ndarray:
        with _asked_once(self.novice, self.expert):
            own = self.novice.actions(env, observations)
            # Asked for in every step, as scripted experts learn a level with its first.
            shown = self.expert.actions(env, observations)
            scores = np.asarray(self.score(env, observations), float)
        numbers, begins = env.states["level"].tolist(), (env.states["time"] == 0).tolist()
        helped = scores > self.threshold
        if self.granularity == "level":
            for i, (number, first) in enumerate(zip(numbers, begins, strict=True)):
                helped[i] |= not first and self._asked[number]
                self._asked[number] = bool(helped[i])
        self._now = dict(zip(numbers, zip(scores.tolist(), helped.tolist(), strict=True),
                             strict=True))  # fmt: skip
        return np.where(helped, shown, own)

    def last(self, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of the last step in the levels of those numbers [n]: the scores, and who was helped."""
        rows = [self._now[number] for number in numbers.tolist()]
        scores, helped = zip(*rows, strict=True)
        return np.array(scores), np.array(helped)


@dataclass(eq=False)
class Alone(_Shown):
    """The novice without help, and what scores say of each of its steps."""

    novice: Policy
    scores: Sequence[Score]
    name: str = "alone"
    _now: dict[int, np.ndarray] = field(default_factory=dict, repr=False)  # by level: [scores]

    def __post_init__(self) -> None:
        see_policy(self.novice)
        of_kind("scores", self.scores, Sequence)
        for score in self.scores:
            _see_score(score)

    def actions(self, env, observations: np.ndarray) -> np.ndarray:
        with _asked_once(self.novice):
            own = self.novice.actions(env, observations)
            said = [np.asarray(score(env, observations), float) for score in self.scores]
        self._now = dict(zip(env.states["level"].tolist(), np.stack(said, 1), strict=True))
        return own

    def last(self, numbers: np.ndarray) -> np.ndarray:
        """Of the last step in the levels of those numbers [n]: the scores, [n, scores]."""
        return np.array([self._now[number] for number in numbers.tolist()])


def _see_score(score: Score) -> None:
    if not callable(score):
        raise ValueError(f"a score must be a function of environments; got {score!r}")


@contextlib.contextmanager
def _asked_once(*policies: Policy) -> Iterator[None]:
    """What agents give in a step is computed once for their actions and for scores of it."""
    with contextlib.ExitStack() as stack:
        for policy in policies:
            if isinstance(policy, Agent):
                stack.enter_context(policy.asked_once())
        yield


def play(
    policy: Helped, game: str | Game, variant: str | Variant, levels: Levels,
    watch: Watch | None = None,
) -> pl.DataFrame:  # fmt: skip
    """A row per level: how its episode went, and when help was asked for.

    Columns: level, return, length (steps), queries (steps that the expert took), first (the step
    of the first query, null for none), highest (of the scores), moment (of `MOMENTS`, of the first
    query; null without a `watch`), and the game's events (their steps, null for never).
    """
    of_kind("levels", levels, Sized)
    n = len(levels)
    queries, first, moment = np.zeros(n, int), np.full(n, -1), np.full(n, -1)
    highest, seen = np.full(n, -np.inf), np.zeros(n, bool)

    def note(step: Step) -> None:
        where = step.level
        scores, helped = policy.last(step.before["level"])
        if watch:
            seen[where] |= watch.seen(step.before)
            now = np.where(watch.passed(step.before), 2, seen[where])
            new = helped & (first[where] < 0)
            moment[where[new]] = now[new]
        first[where] = np.where(helped & (first[where] < 0), step.before["time"], first[where])
        queries[where] += helped
        highest[where] = np.maximum(highest[where], scores)

    played = _episodes(policy, games.find(game), variant, levels, note)
    return _with_help(played, queries, first, highest, moment)


def play_alone(
    policy: Alone, game: str | Game, variant: str | Variant, levels: Levels,
    watch: Watch | None = None,
) -> tuple[pl.DataFrame, pl.DataFrame]:  # fmt: skip
    """How the novice's episodes went, and what the scores said of every step.

    Returns a row per level (level, return, length and the game's events), and a row per step:
    level (which of `levels`), time, moment (index in `MOMENTS`, -1 without a `watch`), and a column
    for each of the scores, called by its place among them.
    """
    of_kind("levels", levels, Sized)
    seen, parts = np.zeros(len(levels), bool), []

    def note(step: Step) -> None:
        where, said = step.level, policy.last(step.before["level"])
        moment = np.full(len(where), -1)
        if watch:
            seen[where] |= watch.seen(step.before)
            moment = np.where(watch.passed(step.before), 2, seen[where])
        columns = {f"{k}": said[:, k] for k in range(said.shape[1])}
        told = {"level": where, "time": step.before["time"].copy(), "moment": moment}
        parts.append(pl.DataFrame(told | columns))

    played = _episodes(policy, games.find(game), variant, levels, note)
    return played, pl.concat(parts)


def _episodes(
    policy: Policy, game: Game, variant: str | Variant, levels: Levels,
    note: Callable[[Step], None],
) -> pl.DataFrame:  # fmt: skip
    """A row per level: level, length, return and the game's events; each step is noted."""
    returns, rows = np.zeros(len(levels)), [{}] * len(levels)
    for step in steps(policy, game, variant, levels):
        note(step)
        returns[step.level] += step.rewards
        for i in np.flatnonzero(step.ended):
            s = step.after[i]
            events = {e: int(s[e]) if s[e] >= 0 else None for e in game.events}
            rows[step.level[i]] = {"level": int(s["level"]), "length": int(s["time"])} | events
    kinds: dict = {event: pl.Int64 for event in game.events}
    played = pl.DataFrame(rows, schema_overrides=kinds)
    return played.with_columns(pl.Series("return", returns))


def _with_help(
    played: pl.DataFrame, queries: np.ndarray, first: np.ndarray, highest: np.ndarray,
    moment: np.ndarray,
) -> pl.DataFrame:  # fmt: skip
    """Episodes with columns of the help in them; -1 of `first` and `moment` is null."""
    return played.with_columns(
        pl.Series("queries", queries),
        pl.Series("first", [int(t) if t >= 0 else None for t in first], pl.Int64),
        pl.Series("highest", highest),
        pl.Series("moment", [MOMENTS[k] if k >= 0 else None for k in moment], pl.String),
    )


def _unheeded(played: pl.DataFrame, said: pl.DataFrame, score: str, limit: float) -> pl.DataFrame:
    """Episodes of `play_alone` as `play` tells them, where nobody helped who was asked to.

    score  the column of `said`, which is above `limit` where it asks
    """
    by_level = said.sort("level", "time").group_by("level", maintain_order=True)
    asks = pl.col(score) > limit
    told = by_level.agg(
        queries=asks.sum(), highest=pl.col(score).max(),
        first=pl.col("time").filter(asks).first(), moment=pl.col("moment").filter(asks).first(),
    )  # fmt: skip
    first, moment = (told[name].fill_null(-1).to_numpy() for name in ("first", "moment"))
    return _with_help(played, told["queries"].to_numpy(), first, told["highest"].to_numpy(), moment)


def training_scores(
    novice: Policy, score: Score, game: str | Game, variant: Variant, levels: Levels
) -> pl.DataFrame:
    """The score at every step of the novice alone in training levels: columns level, score."""
    _, said = play_alone(Alone(novice, [score]), game, variant, levels)
    return said.select("level", score="0")


def threshold(scores: pl.DataFrame, percentile: float, granularity: Granularity) -> float:
    """The score that `percentile` per cent of steps, or of levels' highest ones, do not exceed.

    scores  of `training_scores`

    One noisy step has a whole level handed over, so that levels have thresholds of their own.
    """
    of_kind("scores", scores, pl.DataFrame)
    finite("percentile", percentile, 0, 100)
    check_word("granularity", granularity, Granularity)
    if granularity == "level":
        scores = scores.group_by("level").agg(pl.col("score").max())
    return float(np.percentile(scores["score"].to_numpy(), percentile))


def curve(
    novice: Policy, expert: Policy, score: Score, trial: Trial,
    granularity: Granularity = "step", percentiles: Sequence[float] = PERCENTILES,
) -> pl.DataFrame:  # fmt: skip
    """As `curves`, for one score and one granularity."""
    return curves(novice, expert, [score], trial, [granularity], percentiles)


def curves(
    novice: Policy, expert: Policy, scores: Sequence[Score], trial: Trial,
    granularities: Sequence[Granularity] = ("step",),
    percentiles: Sequence[float] = PERCENTILES,
) -> pl.DataFrame:  # fmt: skip
    """What help of every amount brings: a row per percentile, and for no help and all of it.

    For each score and granularity; what they share is played once, the novice alone and the expert.

    Columns: score, granularity, percentile (null for no help and for all), threshold, help (the
    share of what the granularity names, steps or levels, that got help), queries (expert's steps a
    level), return, low, high (95 % over levels), intended and astray (shares of episodes that
    reached the intended goal or a proxy first), seconds (that the curve took, with its part of what
    is shared), and the share of helped levels of each of `MOMENTS`, null without a watch.
    """
    of_kind("trial", trial, Trial)
    began = time.perf_counter()
    alone, test = Alone(novice, scores), (trial.game, trial.test, trial.test_levels, trial.watch)
    _, known = play_alone(alone, trial.game, trial.training, trial.training_levels)
    of_novice, said = play_alone(alone, *test)
    of_expert = _unheeded(*play_alone(Alone(expert, [Always()]), *test), "0", 0.5)
    pairs = list(itertools.product(enumerate(scores), granularities))
    shared, tables = (time.perf_counter() - began) / max(len(pairs), 1), []
    kinds: dict = {"percentile": pl.Float64} | {moment: pl.Float64 for moment in MOMENTS}
    for (k, score), granularity in pairs:
        began = time.perf_counter()
        mine = known.select("level", score=f"{k}")
        limits = [(p, threshold(mine, p, granularity)) for p in percentiles]
        found = [
            (None, np.inf, _unheeded(of_novice, said, f"{k}", np.inf)),
            (None, -np.inf, of_expert),
            *((p, limit, play(Helped(novice, expert, score, limit, granularity), *test))
              for p, limit in limits),
        ]  # fmt: skip
        rows = [
            {"score": score.name, "granularity": granularity, "percentile": percentile,
             "threshold": limit} | _summed(played, trial, granularity)
            for percentile, limit, played in found
        ]  # fmt: skip
        seconds = shared + time.perf_counter() - began
        table = pl.DataFrame(rows, schema_overrides=kinds)
        tables.append(table.with_columns(seconds=pl.lit(seconds)))
    return pl.concat(tables)


def _summed(played: pl.DataFrame, trial: Trial, granularity: Granularity) -> dict:
    """What `curve` tells of the episodes with one threshold."""
    estimate = bootstrap(played["return"].to_numpy())
    outcome = label(played, games.find(trial.game), trial.shift)["outcome"]
    asked = played.filter(pl.col("queries") > 0)
    queries, steps = (int(played[name].sum()) for name in ("queries", "length"))
    by_level, by_step = len(asked) / len(played), queries / steps
    moments = {
        moment: float((asked["moment"] == moment).mean()) if trial.watch and len(asked) else None  # pyright: ignore
        for moment in MOMENTS
    }
    return {
        "help": by_level if granularity == "level" else by_step,
        "queries": float(played["queries"].mean()),  # pyright: ignore
        "return": estimate.mean, "low": estimate.low, "high": estimate.high,
        "intended": float((outcome == INTENDED).mean()),  # pyright: ignore
        "astray": float((outcome == MISGENERALIZED).mean()),  # pyright: ignore
    } | moments  # fmt: skip


def area(curves: pl.DataFrame) -> pl.DataFrame:
    """The area under each curve of return against help: columns score, granularity, area.

    Returns are as shares of the way from no help, 0, to all of it, 1; by trapezoids over help from
    0 to 1, those of equal help as their mean. Help at random comes near to 0.5 where each step, or
    level, is worth the same; NaN where the expert gets no more than the novice.
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
    """The best that each score comes to if every query costs so much of the return.

    Columns: score, granularity, cost, net (return less the cost of the queries, a level), queries,
    percentile (of the best threshold; null: no help at all, or always).
    """
    of_kind("curves", curves, pl.DataFrame)
    of_kind("costs", costs, Sequence)
    rows = []
    for cost in costs:
        finite("a cost", cost, 0)
        net = curves.with_columns(
            cost=pl.lit(float(cost)), net=pl.col("return") - cost * pl.col("queries")
        )
        best = net.sort("net", descending=True).group_by(
            ["score", "granularity"], maintain_order=True
        )
        rows.append(best.first())
    columns = ["score", "granularity", "cost", "net", "queries", "percentile"]
    return pl.concat(rows).select(columns).sort(["cost", "granularity", "score"])


def when_asked(
    novice: Policy, scores: Sequence[Score], trial: Trial, percentile: float = 95.0
) -> pl.DataFrame:
    """When a novice that nobody helps would first have asked: a row per score and test level.

    Columns: score, those of `play`, and outcome; `moment` is null where it would never have.
    """
    of_kind("trial", trial, Trial)
    alone = Alone(novice, scores)
    _, known = play_alone(alone, trial.game, trial.training, trial.training_levels)
    played, said = play_alone(alone, trial.game, trial.test, trial.test_levels, trial.watch)
    played, parts = label(played, games.find(trial.game), trial.shift), []
    for k, score in enumerate(scores):
        limit = threshold(known.select("level", score=f"{k}"), percentile, "step")
        asked = _unheeded(played, said, f"{k}", limit)
        parts.append(asked.select(pl.lit(score.name).alias("score"), pl.all()))
    return pl.concat(parts)
