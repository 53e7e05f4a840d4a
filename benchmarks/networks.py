"""Steps per second of PPO on images, by network, in turns; the paper's is the first.

All train with the settings of the preset `pixels`, in shorter rollouts; acting and environments
count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import ClassVar

from astray.training.config import PRESETS, Config
from astray.training.fast.acceleration import torch_settings
from astray.training.trainer import Trainer
from benchmarks.tables import decimal
from benchmarks.train import iterate, per_second

PAPER = "impala"
NETWORKS = (
    PAPER, "impala+gru", "nature", "strided-impala", "patch-impala", "overlap", "patch",
    "patch+gru", "cells",
)  # fmt: skip
CONFIG = replace(
    PRESETS["pixels"], variant="corner-small", num_steps=8, minibatches=2, anneal=False
)


@dataclass(frozen=True)
class Row:
    """One network on so many threads."""

    title: ClassVar[str] = "PPO on images, in turns"
    network: str
    threads: int
    weights: int
    steps_per_second: float  # environment steps, median over the rounds
    best: float  # of the rounds
    ratio: float  # of the medians, to the paper's network's

    def cells(self) -> dict[str, str]:
        return {
            "network": self.network,
            "threads": f"{self.threads}",
            "weights": f"{self.weights:,}",
            "steps/s": f"{self.steps_per_second:,.0f}",
            "best": f"{self.best:,.0f}",
            "x the paper's": decimal(self.ratio),
        }


def measure(
    networks: Sequence[str] = NETWORKS,
    config: Config = CONFIG,
    threads: Sequence[int] = (1, 2),
    seconds: float = 4.0,
    rounds: int = 5,
) -> list[Row]:
    """Train each network for about `seconds` in each of the `rounds`, on each number of threads."""
    return [row for count in threads for row in _measure(networks, config, count, seconds, rounds)]


def _measure(
    networks: Sequence[str], config: Config, threads: int, seconds: float, rounds: int
) -> list[Row]:
    with torch_settings(threads):
        trainers = {
            name: Trainer(replace(config, network=name, threads=threads)) for name in networks
        }
        for trainer in trainers.values():  # the first iteration allocates
            iterate(trainer)
        speeds: dict[str, list[float]] = {name: [] for name in networks}
        for _ in range(rounds):
            for name, trainer in trainers.items():
                done = per_second(lambda trainer=trainer: iterate(trainer), seconds, config.device)
                speeds[name].append(config.batch * done)
        rows = [
            Row(
                name,
                threads,
                sum(x.numel() for x in trainer.weights),
                median(speeds[name]),
                max(speeds[name]),
                median(speeds[name]) / median(speeds[networks[0]]),
            )
            for name, trainer in trainers.items()
        ]
        for trainer in trainers.values():
            trainer.close()
    return rows
