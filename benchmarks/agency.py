"""Trajectories measured per second: agents of 400 goals against devices.

On one thread, in an open room of 20 x 20 cells, with trajectories of 50 random actions; figures
are medians over the rounds. The last column shows that the
time for many is that for one, times their number.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import ClassVar

import numpy as np

from astray.agency.generators import uniform_random, wander
from astray.agency.maps import open_room
from astray.agency.measure import PRESETS, Episode
from astray.agency.measure import measure as assess
from benchmarks.tables import decimal


@dataclass(frozen=True)
class Row:
    """One preset, and one number of trajectories."""

    title: ClassVar[str] = "The agency measure: 50 steps, 400 goals"
    preset: str
    trajectories: int
    seconds: float  # median over the rounds
    to_fewest: float  # time per trajectory, as a ratio to that of the fewest

    def cells(self) -> dict[str, str]:
        return {
            "measure": self.preset,
            "trajectories": f"{self.trajectories:,}",
            "seconds": decimal(self.seconds),
            "each x that of the fewest": decimal(self.to_fewest),
        }


def measure(numbers: Sequence[int] = (100, 1000), steps: int = 50, rounds: int = 3) -> list[Row]:
    """Measure `numbers` of trajectories with each preset."""
    world, rng = open_room(), np.random.default_rng(0)
    begins = rng.choice(len(world), max(numbers))
    walks = [wander(world, uniform_random, world.cell(cell), steps, rng) for cell in begins]
    episodes = [Episode(world, walk, (0, 0)) for walk in walks]
    rows = []
    for preset, options in PRESETS.items():
        assess(episodes[0], options)  # tables of the world and of the noise are made once
        each = 0.0
        for number in numbers:
            seconds = []
            for _ in range(rounds):
                began = time.perf_counter()
                for episode in episodes[:number]:
                    assess(episode, options)
                seconds.append(time.perf_counter() - began)
            taken = median(seconds)
            each = each or taken / number
            rows.append(Row(preset, number, taken, taken / number / each))
    return rows
