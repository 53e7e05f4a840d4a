"""Seconds until an environment has made its first step, with nothing compiled and later on.

Each start is a Python of its own, that imports `astray`, creates environments, resets and steps
them once. The first has an empty folder for compiled code, the others what it compiled.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from statistics import median
from typing import ClassVar

from astray import games
from benchmarks.tables import decimal

PROGRAM = """
import sys, time
import numpy as np
from astray.envs.vector import GameVectorEnv
env = GameVectorEnv(sys.argv[1], sys.argv[2], 256)
env.reset(seed=0)
env.step(np.zeros(256, np.int64))
print(time.process_time())
"""


@dataclass(frozen=True)
class Row:
    """The starts of one game, in seconds of the clock and of all processors together."""

    title: ClassVar[str] = "Seconds to the first step of 256 environments"
    game: str
    variant: str
    first: float
    first_cpu: float
    later: float  # median over the rounds
    later_cpu: float

    def cells(self) -> dict[str, str]:
        return {
            "game": f"{self.game} {self.variant}",
            "first start, s": decimal(self.first, 1),
            "CPU s": decimal(self.first_cpu, 1),
            "later starts, s": decimal(self.later),
            "CPU s later": decimal(self.later_cpu),
        }


def measure(names: Sequence[str] = games.OWN, rounds: int = 5) -> list[Row]:
    """Start each game once with nothing compiled, then `rounds` times."""
    return [measure_game(name, games.find(name).benchmark.variant, rounds) for name in names]


def measure_game(game: str, variant: str, rounds: int = 5) -> Row:
    """The starts of a game, which keep what they compile in a folder of their own."""
    with tempfile.TemporaryDirectory(prefix="astray-") as folder:
        first, *later = [_start(game, variant, folder) for _ in range(1 + rounds)]
    passed, cpu = zip(*later, strict=True)
    return Row(game, variant, *first, median(passed), median(cpu))


def _start(game: str, variant: str, folder: str) -> tuple[float, float]:
    """Seconds of the clock and of the processors that a start takes."""
    environment = {k: v for k, v in os.environ.items() if k != "NUMBA_CACHE_DIR"}
    began = time.perf_counter()
    cpu = subprocess.run(
        [sys.executable, "-c", PROGRAM, game, variant],
        env=environment | {"XDG_CACHE_HOME": folder},
        stdout=subprocess.PIPE,
        check=True,
    ).stdout
    return time.perf_counter() - began, float(cpu)
