"""Episodes as a table: a policy on explicit levels, each played exactly once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl

from astray import games
from astray.analysis.episodes import Levels, Measure, steps
from astray.analysis.policies import Policy
from astray.game import Game, Variant


def evaluate(
    policy: Policy,
    game: str | Game,
    variant: str | Variant,
    levels: Levels,
    *,
    batch: int = 256,
    measures: Mapping[str, Measure] | None = None,
    until: Sequence[str] = (),
) -> pl.DataFrame:
    """A row per level, in the order of `levels`: how the policy's episode in it went.

    levels    numbers, or levels that were drawn, by name; those are numbered from 0 on
    measures  further columns, computed of the states that the episodes ended in
    until     events of the game: an episode is left with the first of them

    Columns: policy, level, name (null for a numbered level), shifted, return, length (steps),
    terminated, and every event of the game (the step it first happened, null for never).
    The rows do not depend on `batch`.
    """
    game = games.find(game)
    names = list(levels) if isinstance(levels, Mapping) else [None] * len(levels)
    rows: list[dict[str, Any]] = [{}] * len(levels)
    returns = np.zeros(len(levels))
    last = np.zeros(len(levels) if measures else 0, game.state)  # states
    for step in steps(policy, game, variant, levels, batch=batch, until=until):
        returns[step.level] += step.rewards
        for i in np.flatnonzero(step.ended):
            s, k = step.after[i], step.level[i]
            happened = {event: int(s[event]) if s[event] >= 0 else None for event in game.events}
            rows[k] = {
                "policy": policy.name, "level": int(s.level), "name": names[k],
                "shifted": bool(s.shifted), "return": float(returns[k]),
                "length": int(s.time), "terminated": bool(step.terminated[i]), **happened,
            }  # fmt: skip
            if measures:
                last[k] = s
    kinds = {"name": pl.String} | {event: pl.Int64 for event in game.events}
    table = pl.DataFrame(rows, schema_overrides=kinds)
    measured = {name: measure(last) for name, measure in (measures or {}).items()}
    return table.with_columns(pl.Series(name, values) for name, values in measured.items())
