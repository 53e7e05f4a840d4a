"""Evaluation: a table of a policy's episodes, one in each level."""

import warnings
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl

from astray import world
from astray.acting import Levels, Policy, Reward, Step, steps
from astray.envs.steps import paid
from astray.envs.worlds import Unreported, unreported
from astray.game import Game, Variant
from astray.imports import guarded
from astray.outcome import COLUMNS
from astray.record import count_levels
from astray.validation import of_kind, shown
from astray.world import World, WorldVariant

Measure = Callable[[np.ndarray], np.ndarray]  # states [N] -> numbers [N]


def evaluate(
    policy: Policy,
    game: str | Game | World,
    variant: str | Variant | WorldVariant,
    levels: Levels,
    *,
    batch: int = 256,
    measures: Mapping[str, Measure] | None = None,
    until: Sequence[str] = (),
    longest: int | None = None,
    rewards: Mapping[str, Reward] | None = None,
) -> pl.DataFrame:
    """Play a policy once in each of `levels`; return a table with a row per level.

    Columns: policy, level, name (null for a numbered level), shifted, return (game points), length
    (steps), terminated, every event (the step at which it first happened, or null), the game's
    measures, `measures` and `rewards`. Rows are in the order of `levels` and do not depend on
    `batch`.

    Examples:
        >>> agent = astray.load_agent("maze-corner")
        >>> episodes = astray.evaluate(agent, "maze", "anywhere-small", range(100))
        >>> episodes.height, "reached_corner" in episodes.columns
        (100, True)

    Args:
        levels: Level numbers, or drawn levels by name, which are numbered from 0.
        measures: Further columns: name -> function of the final states [N].
        until: Events of the game that end an episode.
        longest: Steps after which an episode is truncated; None for no limit.
        rewards: Rewards of your own, of which the episodes' returns become columns: name ->
            function of an `acting.Step` that returns its rewards [n]. `step.level` has the levels'
            numbers, as in training.

    Raises:
        ValueError: If there are no levels, or an argument is invalid.

    Warns:
        Unreported: If an event of a `World` names a key of info that no step reported.
    """
    game = world.find(game)
    check_measures(measures, (*COLUMNS, *game.events, *game.measures))
    others = (*COLUMNS, *game.events, *game.measures, *(measures or {}))
    check_measures(rewards, others, "rewards")
    episodes = Episodes(game, levels, measures)
    own = {name: np.zeros(len(episodes.rows)) for name in rewards or {}}
    played = game.in_every_step if rewards and isinstance(game, World) else game
    for step in steps(policy, played, variant, levels, batch=batch, until=until, longest=longest):
        episodes.add(step)
        for name, totals in own.items():
            numbered = replace(step, level=step.before["level"])  # as in training
            totals[step.level] += paid(rewards[name], numbered)  # pyrefly: ignore
    if told := unreported(game):
        warnings.warn(told, Unreported, stacklevel=2)
    table = episodes.table().select(pl.lit(policy.name).alias("policy"), pl.all())
    return table.with_columns(pl.Series(name, totals) for name, totals in own.items())


class Episodes:
    """Episodes of a policy, one in each of `levels`, from its steps: a row for each as it ends."""

    def __init__(
        self, game: Game | World, levels: Levels, measures: Mapping[str, Measure] | None = None
    ):
        count = count_levels(levels)
        self.game, self.measures = game, {**game.of_states, **(measures or {})}
        self.names = list(levels) if isinstance(levels, Mapping) else [None] * count
        self.rows: list[dict[str, Any]] = [{}] * count
        self.returns = np.zeros(count)
        self.last = np.zeros(count if self.measures else 0, game.state)  # states

    def add(self, step: Step) -> None:
        self.returns[step.level] += step.rewards
        for i in np.flatnonzero(step.ended):
            s, k = step.after[i], step.level[i]
            self.rows[k] = {
                "level": int(s.level),
                "name": self.names[k],
                "shifted": bool(s.shifted),
                "return": float(self.returns[k]),
                "length": int(s.time),
                "terminated": bool(step.terminated[i]),
                **{event: int(s[event]) if s[event] >= 0 else None for event in self.game.events},
            }
            if self.measures:
                self.last[k] = s

    def table(self) -> pl.DataFrame:
        """Return the columns of `evaluate`, without the policy and rewards of your own."""
        kinds = {"name": pl.String} | {event: pl.Int64 for event in self.game.events}
        table = pl.DataFrame(self.rows, schema_overrides=kinds)
        return table.with_columns(
            measured(name, of, self.last) for name, of in self.measures.items()
        )


def check_measures(measures: Any, taken: Collection[str], kind: str = "measures") -> None:
    """Raise ValueError unless `measures`, or a `kind` alike, are functions by names not `taken`."""
    if measures is None:
        return
    of_kind(kind, measures, Mapping)
    for name, measure in measures.items():
        if not isinstance(name, str) or not callable(measure):
            given = f"{shown(name)}: {shown(measure)}"
            raise ValueError(f"{kind} must be functions by name; got {given}")
        if name in taken:
            raise ValueError(f"{kind} have the names of other columns: {name}; give others")


def measured(name: str, measure: Measure, states: np.ndarray) -> pl.Series:
    """Apply a measure to `states` [N]; raise ValueError unless it returns N values."""
    with guarded(f"the measure {name!r}", ValueError, ImportError):
        values, n = measure(states.copy()), len(states)  # it may write to them
    try:
        fits, column = np.shape(values) == (n,), pl.Series(name, values)
    except Exception:  # polars has many for values of several types
        fits, column = False, pl.Series()
    if not fits or column.dtype == pl.Object:  # which no file of a table holds
        raise ValueError(
            f"the measure {name!r} must return {n} values of one type; got {shown(values)}"
        )
    return column
