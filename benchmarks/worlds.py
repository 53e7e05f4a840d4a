"""The cost of evaluating a `World`, beside a plain loop over the same vector environment."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, ClassVar

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from astray.acting import steps as played
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
    "MiniGrid-Empty-5x5-v0": {"corner": lambda env, info: env.agent_pos == (3, 3)},
}


@dataclass(frozen=True)
class Row:
    """Microseconds of a core for a step of one environment of many, with its resets."""

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
    environments: Sequence[str] = tuple(EVENTS), rounds: int = 15, steps: int = 40, batch: int = 256
) -> list[Row]:
    """Step a World and a plain loop in turns, so that other work on the machine slows both."""
    rows = []
    for name in environments:
        loops = _plain(name, batch), _world(name, batch)
        times = [[_timed(loop) for loop in loops] for _ in range(rounds * steps)]
        means = np.array(times).reshape(rounds, steps, 2).mean(1)
        rows.append(Row(name, *map(float, np.median(means, 0))))
    return rows


def _timed(loop: Iterator[int]) -> float:
    began = time.thread_time()
    count = next(loop)
    return 1e6 * (time.thread_time() - began) / count


def _left(seen: np.ndarray) -> np.ndarray:
    """Push against the fall of a pole; anything elsewhere."""
    return (seen.reshape(len(seen), -1)[:, 2:].sum(1) > 0).astype(int)


def _made(name: str) -> gymnasium.Env:
    if not name.startswith("MiniGrid"):
        return gymnasium.make(name)
    from minigrid.wrappers import ImgObsWrapper  # here, as it is optional

    return ImgObsWrapper(gymnasium.make(name))


def _world(name: str, batch: int) -> Iterator[int]:
    """Yield the number of steps taken, over and over."""
    world = World(
        name="benchmark",
        variants={"one": partial(_made, name)},
        events=EVENTS[name],
        goals={event: event for event in EVENTS[name]},
        ends={"time": Truncated()},
        shifts={},
    )
    for step in played(Function(_left), world, "one", range(1_000_000), batch=batch):
        yield len(step.level)


def _plain(name: str, batch: int) -> Iterator[int]:
    """Yield the number of steps taken, over and over."""
    envs = SyncVectorEnv([partial(_made, name)] * batch, autoreset_mode=AutoresetMode.DISABLED)
    level = batch
    seen, _ = envs.reset(seed=list(range(batch)))
    while True:
        seen, _, terminated, truncated, _ = envs.step(_left(seen))
        if (ended := terminated | truncated).any():
            seeds = [level + k if ends else None for k, ends in enumerate(ended)]
            seen, _ = envs.reset(seed=seeds, options={"reset_mask": ended})
            level += int(ended.sum())
        yield batch
