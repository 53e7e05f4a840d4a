"""Episodes as a table: a policy on explicit levels, each played exactly once."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import polars as pl

from astray.analysis.policies import Policy
from astray.envs.vector import GameVectorEnv
from astray.game import Variant


def evaluate(
    policy: Policy,
    game: str,
    variant: str | Variant,
    levels: Sequence[int] | np.ndarray | range,
    *,
    batch: int = 256,
) -> pl.DataFrame:
    """A row per level, in the order of `levels`: how the policy's episode in it went.

    Columns: policy, level, shifted, return, length (steps), terminated, and every event of the
    game (the step it first happened, null for never). The rows do not depend on `batch`.
    """
    numbers = np.array(levels, np.int64)
    if not numbers.size:
        raise ValueError("no levels to evaluate on")
    n = min(batch, numbers.size)
    env = GameVectorEnv(game, variant, n, observation=policy.observation, autoreset_mode="Disabled")
    events = env.game.events
    rows: list[dict[str, Any] | None] = [None] * numbers.size
    playing = np.arange(n)  # which of the levels each environment plays
    following, returns = n, np.zeros(n)
    observations, _ = env.reset(seed=0, options={"level": numbers[:n]})
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
                "policy": policy.name, "level": int(s.level), "shifted": bool(s.shifted),
                "return": float(returns[i]), "length": int(s.time),
                "terminated": bool(terminated[i]), **happened,
            }  # fmt: skip
            if following < numbers.size:  # else it plays its last level again, to no end
                playing[i] = following
                following += 1
            returns[i] = 0.0
        again = {"level": numbers[playing], "reset_mask": ended}
        observations, _ = env.reset(options=again)
    env.close()
    steps = {event: pl.Int64 for event in events}
    return pl.DataFrame(rows, schema_overrides=steps)
