"""A novice that an expert helps, and a novice that is only watched."""

import contextlib
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import polars as pl

from astray import games
from astray.acting import Answer, Levels, Policy, Step, Turn, check_policy, steps
from astray.analysis.evaluate import Measure
from astray.analysis.policies import Walk
from astray.analysis.trained import Agent
from astray.envs.vector import Observation
from astray.game import Game, Variant
from astray.mitigation.uncertainty import Score
from astray.record import count_levels
from astray.validation import of_kind, one_of, shown

Granularity = Literal["step", "level"]
BEFORE, SEEN, AFTER = "before it was seen", "seen, not passed", "after it was passed"
MOMENTS = (BEFORE, SEEN, AFTER)  # at which help is first asked for


@dataclass(frozen=True)
class Watch:
    """Visibility of an object: boolean measures of states [N].

    Attributes:
        seen: The object is in view.
        passed: The agent has passed it.
    """

    seen: Measure
    passed: Measure


class _Shown:
    """Base of policies with the observations of their novice."""

    novice: Policy

    @property
    def observation(self) -> Observation:
        return self.novice.observation

    @property
    def art(self) -> str:
        return self.novice.art


@dataclass(eq=False)
class Helped(_Shown):
    """Policy of a novice and an expert, who acts if `score` is above `threshold`.

    It records the score of each step, and whether the expert acted ("helped"). The expert sees the
    novice's observations and the states. A walking expert is asked only while it helps, since it
    may have to plan again whenever it takes over.

    Attributes:
        granularity: "step" for help in that step; "level" for help until the end of the level.
    """

    novice: Policy
    expert: Policy
    score: Score
    threshold: float
    granularity: Granularity = "step"
    name: str = "helped"

    def __post_init__(self) -> None:
        for policy in (self.novice, self.expert):
            check_policy(policy)
        one_of("granularity", self.granularity, Granularity)
        of_kind("a score", self.score, Callable)
        of_kind("threshold", self.threshold, int | float)  # also infinite: nobody, or everybody
        if np.isnan(self.threshold):
            raise ValueError("threshold must be a number; got nan, which no score is above")
        if isinstance(self.expert, Agent) and self.expert.observation != self.observation:
            raise ValueError(
                f"novice and expert must be shown the same; got {self.observation!r} and "
                f"{self.expert.observation!r}"
            )

    def actions(self, turn: Turn) -> Answer:
        """Return actions; raise ValueError unless there is a score for each episode."""
        env, n = turn.env, len(turn.begins)
        novice, expert, before = turn.memory or (None, None, np.zeros(n, bool))
        with _asked_once(self.novice, self.expert):
            own = self.novice.actions(turn._replace(memory=novice))
            scores = _scores(self.score, turn)
            helped = scores > self.threshold
            if self.granularity == "level":
                helped |= before & ~turn.begins
            other = own
            if not isinstance(self.expert, Walk):
                other = self.expert.actions(turn._replace(memory=expert))
        led = other.actions.copy()
        if isinstance(self.expert, Walk):
            asked = helped | turn.begins  # a level is learned in its first step
            led[asked] = self.expert.ways(env.game, env.states[asked])
        return Answer(
            np.where(helped, led, own.actions),
            (own.memory, other.memory, helped),
            {"score": scores, "helped": helped},
        )


@dataclass(eq=False)
class Alone(_Shown):
    """The novice without help; it records each of `scores` at every step, by position."""

    novice: Policy
    scores: Sequence[Score]
    name: str = "alone"

    def __post_init__(self) -> None:
        check_policy(self.novice)
        of_kind("scores", self.scores, Sequence)
        for score in self.scores:
            of_kind("a score", score, Callable)

    def actions(self, turn: Turn) -> Answer:
        """Return the novice's actions; raise ValueError unless there are scores of each episode."""
        with _asked_once(self.novice):
            own = self.novice.actions(turn)
            said = [_scores(score, turn) for score in self.scores]
        return own._replace(extra={f"{k}": scores for k, scores in enumerate(said)})


def _scores(score: Score, turn: Turn) -> np.ndarray:
    """Return the scores [N] of a turn; raise ValueError if there is not one for each episode."""
    given, n = score(turn.env, turn.observations), len(turn.begins)
    scores = np.asarray(given)
    if scores.shape != (n,) or scores.dtype.kind not in "biuf" or np.isnan(scores).any():
        raise ValueError(f"a score must be {n} numbers, one per episode; got {shown(given)}")
    return scores.astype(float)


@contextlib.contextmanager
def _asked_once(*policies: Policy) -> Iterator[None]:
    """Cache the agents' outputs in a step, for their actions and for scores."""
    with contextlib.ExitStack() as stack:
        for policy in policies:
            if isinstance(policy, Agent):
                stack.enter_context(policy.asked_once())
        yield


def play(
    policy: Helped,
    game: str | Game,
    variant: str | Variant,
    levels: Levels,
    watch: Watch | None = None,
) -> pl.DataFrame:
    """Play a helped policy; return a table with a row per level.

    Columns: level, return, length (steps), queries (steps of the expert), first (step of the first
    query, or null), highest (score), moment (in `MOMENTS`, of the first query; null without
    `watch`), and the game's events (their steps, or null).
    """
    n = count_levels(levels)
    queries, first, moment = np.zeros(n, int), np.full(n, -1), np.full(n, -1)
    highest, seen = np.full(n, -np.inf), np.zeros(n, bool)

    def note(step: Step) -> None:
        where, scores, helped = step.level, step.extra["score"], step.extra["helped"]
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
    policy: Alone,
    game: str | Game,
    variant: str | Variant,
    levels: Levels,
    watch: Watch | None = None,
) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Play the novice alone; return a table of episodes and a table of scores.

    The first has a row per level (level, return, length and the game's events). The second has a
    row per step: level (index in `levels`), time, moment (index in `MOMENTS`, -1 without `watch`),
    and one column per score, named by its position.
    """
    seen, parts = np.zeros(count_levels(levels), bool), []

    def note(step: Step) -> None:
        where = step.level
        moment = np.full(len(where), -1)
        if watch:
            seen[where] |= watch.seen(step.before)
            moment = np.where(watch.passed(step.before), 2, seen[where])
        told = {"level": where, "time": step.before["time"].copy(), "moment": moment}
        parts.append(pl.DataFrame(told | dict(step.extra)))

    played = _episodes(policy, games.find(game), variant, levels, note)
    return played, pl.concat(parts)


def _episodes(
    policy: Policy, game: Game, variant: str | Variant, levels: Levels, note: Callable[[Step], None]
) -> pl.DataFrame:
    """Play and return a row per level: level, length, return and the game's events."""
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
    played: pl.DataFrame,
    queries: np.ndarray,
    first: np.ndarray,
    highest: np.ndarray,
    moment: np.ndarray,
) -> pl.DataFrame:
    """Add columns about help to episodes; -1 in `first` and `moment` becomes null."""
    return played.with_columns(
        pl.Series("queries", queries),
        pl.Series("first", [int(t) if t >= 0 else None for t in first], pl.Int64),
        pl.Series("highest", highest),
        pl.Series("moment", [MOMENTS[k] if k >= 0 else None for k in moment], pl.String),
    )


def unheeded(played: pl.DataFrame, said: pl.DataFrame, score: str, limit: float) -> pl.DataFrame:
    """Return episodes of `play_alone` in the form of `play`, as if requests were ignored.

    Args:
        score: Column of `said` that requests help above `limit`.
    """
    by_level = said.sort("level", "time").group_by("level", maintain_order=True)
    asks = pl.col(score) > limit
    told = by_level.agg(
        queries=asks.sum(),
        highest=pl.col(score).max(),
        first=pl.col("time").filter(asks).first(),
        moment=pl.col("moment").filter(asks).first(),
    )
    first, moment = (told[name].fill_null(-1).to_numpy() for name in ("first", "moment"))
    return _with_help(played, told["queries"].to_numpy(), first, told["highest"].to_numpy(), moment)
