"""A novice that an expert helps, and a novice that is only watched."""

import contextlib
import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
import polars as pl

from astray import games
from astray.acting import Answer, Levels, Policy, Turn, asked, check_policy, steps
from astray.analysis.evaluate import Episodes, Measure
from astray.analysis.policies import Random, Walk
from astray.analysis.trained import Agent
from astray.envs.vector import Observation
from astray.game import Game, Variant
from astray.mitigation.uncertainty import Score
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
        blind = isinstance(self.expert, Walk | Random)  # scripts look at no observation
        if not blind and self.expert.observation != self.observation:
            raise ValueError(
                f"novice and expert must be shown the same; got {self.observation!r} and "
                f"{self.expert.observation!r}"
            )

    def actions(self, turn: Turn) -> Answer:
        """Return actions; raise ValueError unless there is a score for each episode."""
        env, n = turn.env, len(turn.begins)
        novice, expert, before = turn.memory or (None, None, np.zeros(n, bool))
        with _asked_once(self.novice, self.expert):
            own = asked(self.novice, turn._replace(memory=novice))
            scores = _scores(self.score, turn)
            helped = scores > self.threshold
            if self.granularity == "level":
                helped |= before & ~turn.begins
            other = own
            if not isinstance(self.expert, Walk):
                other = asked(self.expert, turn._replace(memory=expert))
        led = other.actions.copy()
        if isinstance(self.expert, Walk):
            due = helped | turn.begins  # a level is learned in its first step
            led[due] = self.expert.ways(env.game, env.states[due])
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
        if len({*self.names}) < len(self.names):  # tables have them together
            raise ValueError(f"scores must have names of their own; got {', '.join(self.names)}")

    @property
    def names(self) -> list[str]:
        """The name of each score; a function has its own."""
        return [str(getattr(one, "name", getattr(one, "__name__", one))) for one in self.scores]

    def actions(self, turn: Turn) -> Answer:
        """Return the novice's actions; raise ValueError unless there are scores of each episode."""
        with _asked_once(self.novice):
            own = asked(self.novice, turn)
            said = [_scores(score, turn) for score in self.scores]
        return own._replace(extra={f"{k}": scores for k, scores in enumerate(said)})


def _scores(score: Score, turn: Turn) -> np.ndarray:
    """Return the scores [N] of a turn; raise ValueError if there is not one for each episode."""
    given, n = score(turn.env, copy.deepcopy(turn.observations)), len(turn.begins)
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

    Columns: those of `play_alone`, queries (steps of the expert), first (step of the first query,
    or null), highest (score), and moment (in `MOMENTS`, of the first query; null without `watch`).
    """
    return _with_help(*play_alone(policy, game, variant, levels, watch), pl.col("helped"), "score")


def play_alone(
    policy: Policy,
    game: str | Game,
    variant: str | Variant,
    levels: Levels,
    watch: Watch | None = None,
) -> tuple[pl.DataFrame, pl.DataFrame]:
    """Play the novice alone; return a table of episodes and a table of scores.

    The first has a row per level, with the columns of `evaluate`, the policy apart. The second has
    a row per step: level (index in `levels`), time, moment (index in `MOMENTS`, -1 without
    `watch`), and one column per score, named by its position (of other policies, all that they
    record).
    """
    episodes, parts = Episodes(games.find(game), levels), []
    seen = np.zeros(len(episodes.rows), bool)
    for step in steps(policy, episodes.game, variant, levels):
        episodes.add(step)
        where, moment = step.level, np.full(len(step.level), -1)
        if watch:
            seen[where] |= watch.seen(step.before)
            moment = np.where(watch.passed(step.before), 2, seen[where])
        told = {"level": where, "time": step.before["time"].copy(), "moment": moment}
        parts.append(pl.DataFrame(told | dict(step.extra)))
    return episodes.table(), pl.concat(parts)


def _with_help(played: pl.DataFrame, said: pl.DataFrame, asks: pl.Expr, score: str) -> pl.DataFrame:
    """Add columns about help to episodes, which is asked for in the steps of `asks`."""
    by_level = said.sort("level", "time").group_by("level", maintain_order=True)
    told = by_level.agg(
        queries=asks.sum().cast(pl.Int64),
        first=pl.col("time").filter(asks).first(),
        highest=pl.col(score).max(),
        moment=pl.col("moment").filter(asks).first(),
    )
    named = pl.col("moment").replace_strict(
        range(len(MOMENTS)), MOMENTS, default=None, return_dtype=pl.String
    )
    return played.hstack(told.select("queries", "first", "highest", named))


def unheeded(played: pl.DataFrame, said: pl.DataFrame, score: str, limit: float) -> pl.DataFrame:
    """Return episodes of `play_alone` in the form of `play`, as if requests were ignored.

    Args:
        score: Column of `said` that requests help above `limit`.
    """
    return _with_help(played, said, pl.col(score) > limit, score)
