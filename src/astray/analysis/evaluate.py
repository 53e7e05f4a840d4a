"""Episodes as a table: a policy on explicit levels, each played exactly once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence, Sized
from typing import Any

import numpy as np
import polars as pl

from astray.analysis.given import Measure, measured, see_measures, see_policy
from astray.analysis.policies import Policy
from astray.bounds import bounded, of_kind
from astray.envs.vector import GameVectorEnv
from astray.game import MOST, Game, Variant, level_numbers
from astray.level import Level

COLUMNS = ("policy", "level", "name", "shifted", "return", "length", "terminated")


def evaluate(
    policy: Policy,
    game: str | Game,
    variant: str | Variant,
    levels: Sequence[int] | np.ndarray | range | Mapping[str, Level],
    *,
    batch: int = 256,
    measures: Mapping[str, Measure] | None = None,
) -> pl.DataFrame:
    """A row per level, in the order of `levels`: how the policy's episode in it went.

    levels    numbers, or levels that were drawn, by name; those are numbered from 0 on
    measures  further columns, computed of the states that the episodes ended in

    Columns: policy, level, name (null for a numbered level), shifted, return, length (steps),
    terminated, and every event of the game (the step it first happened, null for never).
    The rows do not depend on `batch`.
    """
    see_policy(policy)
    of_kind("levels", levels, Sized)
    if not len(levels):
        raise ValueError("no levels to evaluate on")
    bounded("batch", batch, 1, MOST)
    n = min(batch, len(levels))
    env = GameVectorEnv(
        game, variant, n, observation=policy.observation, art=policy.art, autoreset_mode="Disabled"
    )
    events = env.game.events
    see_measures(measures, (*COLUMNS, *events))
    kind, begin = beginnings(levels, env.game.state)
    names = list(levels) if isinstance(levels, Mapping) else [None] * len(levels)
    rows: list[dict[str, Any] | None] = [None] * len(levels)
    playing = np.arange(n)  # which of the levels each environment plays
    following, returns = n, np.zeros(n)
    last = np.zeros(len(levels) if measures else 0, env.game.state)  # states
    observations, _ = env.reset(seed=0, options={kind: begin[:n]})
    while None in rows[playing.min() :]:
        actions = policy.actions(env, observations)
        observations, reward, terminated, truncated, _ = env.step(actions)
        returns += reward
        ended = terminated | truncated
        if not ended.any():
            continue
        for i in np.flatnonzero(ended):
            s = env.states[i]
            happened = {event: int(s[event]) if s[event] >= 0 else None for event in events}
            rows[playing[i]] = {
                "policy": policy.name, "level": int(s.level), "name": names[playing[i]],
                "shifted": bool(s.shifted), "return": float(returns[i]),
                "length": int(s.time), "terminated": bool(terminated[i]), **happened,
            }  # fmt: skip
            if measures:
                last[playing[i]] = env.states[i]
            if following < len(levels):  # else it plays its last level again, to no end
                playing[i] = following
                following += 1
            returns[i] = 0.0
        again = {kind: begin[playing], "reset_mask": ended}
        observations, _ = env.reset(options=again)
    env.close()
    kinds = {"name": pl.String} | {event: pl.Int64 for event in events}
    table = pl.DataFrame(rows, schema_overrides=kinds)
    return table.with_columns(measured(name, of, last) for name, of in (measures or {}).items())


def beginnings(levels: Any, dtype: np.dtype) -> tuple[str, np.ndarray]:
    """The option of a reset that begins each of `levels`, and its values."""
    if not isinstance(levels, Mapping):
        return "level", level_numbers(levels)
    for level in levels.values():
        of_kind("a level by name", level, Level)
        if level.game.state != dtype:
            raise ValueError(f"levels must be of one game; one is of {level.game.name}")
    states = np.array([level.state(solvable=False) for level in levels.values()], dtype)
    states["level"] = np.arange(len(states))
    return "state", states
