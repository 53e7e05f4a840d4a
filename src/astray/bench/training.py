"""Steps per second of PPO, beside Stable-Baselines3's with the same settings.

Both train on one torch thread, on the same batch of environments, with networks that begin
with the same weights; neither writes logs. They are measured in turns, round after round;
figures are medians over the rounds.
"""

from __future__ import annotations

import importlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median

import torch
from rich.table import Table

from astray.bench import tables
from astray.bench.tables import decimal, thousands
from astray.training.config import PRESETS, Config
from astray.training.loop import update
from astray.training.rollout import collect
from astray.training.trainer import Trainer

# The preset as it is, and with the smaller network and more environments, where the network's
# matrix products leave more to the rest.
CONFIGS = tuple(
    replace(PRESETS["small"], game="maze", variant="corner-small", anneal=False, **change)
    for change in ({}, {"width": 64, "environments": 1024})
)


@dataclass(frozen=True)
class Row:
    """What one contender did; None where it was not measured."""

    what: str
    game: str
    variant: str
    width: int  # hidden units of the network
    environments: int
    steps_per_second: float | None = None  # environment steps, median over the rounds
    best: float | None = None  # of the rounds
    to_peer: float | None = None  # ratio to Stable-Baselines3
    note: str = ""

    def cells(self) -> dict[str, str]:
        return {
            "what": f"{self.what} ({self.note})" if self.note else self.what,
            "game": f"{self.game} {self.variant}",
            "width": f"{self.width}",
            "environments": f"{self.environments}",
            "1,000 steps/s": thousands(self.steps_per_second),
            "best": thousands(self.best),
            "x Stable-Baselines3": decimal(self.to_peer),
        }


def measure(
    configs: Sequence[Config] = CONFIGS, seconds: float = 20.0, rounds: int = 5
) -> list[Row]:
    """With each config, train each contender for about `seconds` in all, in `rounds` turns."""
    before = torch.get_num_threads()
    torch.set_num_threads(1)
    torch.set_flush_denormal(True)  # as `train` does
    try:
        return [
            row
            for config in configs
            for row in _measure(replace(config, threads=1), seconds / rounds, rounds)
        ]
    finally:
        torch.set_num_threads(before)


def _measure(config: Config, turn: float, rounds: int) -> list[Row]:
    trainer = Trainer(config)
    contenders = {"astray": lambda: iterate(trainer)}
    rows = [
        Row(what, config.game, config.variant, config.width, config.environments)
        for what in ("astray", "Stable-Baselines3")
    ]
    closes = [trainer.close]
    try:
        sb3 = importlib.import_module("astray.bench.sb3")
    except ImportError:
        rows[1] = replace(rows[1], note="not installed: pip install stable-baselines3")
    else:
        model = sb3.ppo(config, trainer.network)
        closes.append(model.env.close)
        contenders[rows[1].what] = lambda: model.learn(config.batch, reset_num_timesteps=False)
    for train in contenders.values():  # the first iteration allocates
        train()
    speeds = {what: [] for what in contenders}
    for _ in range(rounds):
        for what, train in contenders.items():
            speeds[what].append(config.batch * _per_second(train, turn))
    for close in closes:
        close()
    rows = [_measured(row, speeds.get(row.what)) for row in rows]
    ours, peer = (row.steps_per_second for row in rows)
    return [replace(rows[0], to_peer=ours / peer if ours and peer else None), rows[1]]


def iterate(trainer: Trainer) -> None:
    """One iteration of the training loop, at a constant learning rate and without its log."""
    config = trainer.config
    rollout = collect(trainer.model, trainer.player, config)
    update(trainer, rollout, config.learning_rate)
    trainer.steps += config.batch


def _per_second(train: Callable[[], object], turn: float) -> float:
    done, began = 0, time.perf_counter()
    while (passed := time.perf_counter() - began) < turn or not done:
        train()
        done += 1
    return done / passed


def _measured(row: Row, speeds: list[float] | None) -> Row:
    return replace(row, steps_per_second=median(speeds), best=max(speeds)) if speeds else row


def table(rows: Sequence[Row]) -> Table:
    """The rows for a terminal."""
    return tables.table(rows, "PPO on one thread, in turns")


def markdown(rows: Sequence[Row]) -> str:
    """The rows for a page."""
    return tables.markdown(rows)
