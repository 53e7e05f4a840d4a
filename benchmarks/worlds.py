"""The cost of evaluating a `World`, beside a plain loop over the same vector environment."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from statistics import median
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from astray.acting import steps
from astray.analysis.adapters import Function
from astray.game import Truncated
from astray.world import World
from benchmarks.tables import decimal

EVENTS: dict[str, dict[str, Callable[[Any, Any], Any]]] = {  # environment -> what is looked for
    "CartPole-v1": {
        "left": lambda env, info: env.state[0] < -1,
        "right": lambda env, info: env.state[0] > 1,
    },
    "MountainCar-v0": {"up": lambda env, info: env.state[0] > 0.4},
    "Acrobot-v1": {"fast": lambda env, info: env.state[2] > 4},
}


@dataclass(frozen=True)
class Row:
    """Microseconds of a core for a step of one environment of many, with making them."""

    title: ClassVar[str] = "A step of a World"
    environment: str
    plain: float
    world: float

    def cells(self) -> dict[str, str]:
        return {
            "environment": self.environment,
            "plain loop, us": decimal(self.plain, 1),
            "World, us": decimal(self.world, 1),
            "ratio": decimal(self.world / self.plain),
        }


def measure(
    environments: Sequence[str] = tuple(EVENTS),
    rounds: int = 3,
    levels: int = 256,
    batch: int = 256,
) -> list[Row]:
    """Play levels of each environment in turns with a plain loop."""
    rows = []
    for name in environments:
        pairs = [(_plain(name, levels, batch), _world(name, levels, batch)) for _ in range(rounds)]
        plain, world = (median(times) for times in zip(*pairs, strict=True))
        rows.append(Row(name, plain, world))
    return rows


def _left(seen: np.ndarray) -> np.ndarray:
    """Push against the fall of a pole; anything elsewhere."""
    return (seen[:, 2:].sum(1) > 0).astype(int)


def _world(name: str, levels: int, batch: int) -> float:
    world = World(
        name="benchmark",
        variants={"one": partial(gymnasium.make, name)},
        events=EVENTS[name],
        goals={event: event for event in EVENTS[name]},
        ends={"time": Truncated()},
        shifts={},
    )
    began, count = time.thread_time(), 0
    for step in steps(Function(_left), world, "one", range(levels), batch=batch):
        count += len(step.level)
    return 1e6 * (time.thread_time() - began) / count


def _plain(name: str, levels: int, batch: int) -> float:
    began = time.thread_time()
    envs = SyncVectorEnv([partial(gymnasium.make, name)] * batch,
                         autoreset_mode=AutoresetMode.DISABLED)  # fmt: skip
    count, level = 0, batch
    seen, _ = envs.reset(seed=list(range(batch)))
    while level < levels + batch:
        seen, _, terminated, truncated, _ = envs.step(_left(seen))
        count, ended = count + batch, terminated | truncated
        if ended.any():
            seeds = [level + k if ends else None for k, ends in enumerate(ended)]
            seen, _ = envs.reset(seed=seeds, options={"reset_mask": ended})
            level += int(ended.sum())
    spent = time.thread_time() - began
    envs.close()
    return 1e6 * spent / count
