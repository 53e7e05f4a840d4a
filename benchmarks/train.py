"""Steps per second of PPO, beside others with the same settings, and where its time goes.

All train with networks that begin with the same weights, in turns, round after round; figures
are medians over the rounds; none writes logs. On symbolic observations ours is beside
Stable-Baselines3's, on one thread and the same environments. On images it is beside plain loops:
CleanRL's with EnvPool's Procgen, and one of the original's shape.
"""

from __future__ import annotations

import copy
import importlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from statistics import median
from typing import Any, ClassVar, Literal

import torch

from astray.envs.vector import GameVectorEnv
from astray.training.config import PRESETS, Config
from astray.training.fast.acceleration import torch_settings
from astray.training.loop import collect, update
from astray.training.trainer import Trainer
from benchmarks import profile, tables
from benchmarks.plain import Loop
from benchmarks.tables import decimal, thousands

# The preset as it is, and with the smaller network and more environments, where the network's
# matrix products leave more to the rest.
SYMBOLIC = tuple(
    PRESETS["small"].changed(game="maze", variant="corner-small", anneal=False, **change)
    for change in ({}, {"width": 64, "num_envs": 1024})
)
IMAGES = replace(PRESETS["paper"], game="coinrun", variant="coin-end", anneal=False)
CONFIGS: dict[str, tuple[Config, ...]] = {
    # A CPU would need minutes for an iteration of the paper's; its minibatches are of 256 there.
    "cpu": (*SYMBOLIC, replace(IMAGES, num_envs=32, num_steps=16, minibatches=2)),
    "cuda": (replace(IMAGES, device="cuda", threads=8),),
    "mps": (replace(IMAGES, device="mps", num_steps=64),),
}
PLAIN = {"fused_cpu": False, "bfloat16": False, "channels_last": False, "compile": False,
         "cudagraphs": False, "groups": 1}  # fmt: skip


@dataclass(frozen=True)
class Row:
    """Result of one contender; None where it was not measured."""

    title: ClassVar[str] = "PPO, in turns"
    what: str
    game: str
    variant: str
    network: str
    num_envs: int
    steps_per_second: float | None = None  # environment steps, median over the rounds
    best: float | None = None  # of the rounds
    ratio: float | None = None  # of ours to it
    note: str = ""

    def cells(self) -> dict[str, str]:
        return {
            "what": f"{self.what} ({self.note})" if self.note else self.what,
            "game": f"{self.game} {self.variant}",
            "network": self.network,
            "environments": f"{self.num_envs}",
            "1,000 steps/s": thousands(self.steps_per_second),
            "best": thousands(self.best),
            "astray's, times it": decimal(self.ratio),
        }


def measure(
    configs: Sequence[Config] | None = None,
    seconds: float = 20.0,
    rounds: int = 5,
    device: Literal["cpu", "cuda", "mps"] = "cpu",
) -> list[Row | profile.Row]:
    """With each config, train each contender for about `seconds` in all, in `rounds` turns.

    Then profile ours with each. Without `configs`, those of the `device`.
    """
    configs = CONFIGS[device] if configs is None else configs
    with torch_settings(threads=1):  # as `train` does
        rows = [row for config in configs for row in _measure(config, seconds / rounds, rounds)]
        parts = [part for config in configs for part in profile.measure(config, rounds)]
    return [*rows, *parts]


def _measure(config: Config, turn: float, rounds: int) -> list[Row]:
    network = tables.network(config)
    row = Row("astray", config.game, config.variant, network, config.num_envs)
    trainer = Trainer(config)
    contenders: dict[str, Callable[[], object]] = {row.what: lambda: iterate(trainer)}
    closes: list[Callable[[], object]] = [trainer.close]
    peers = _symbolic if config.observation == "symbolic" else _images
    notes: dict[str, str] = {}
    for what, made in peers(config, copy.deepcopy(trainer.network)).items():
        if isinstance(made, str):
            notes[what] = made
        else:
            contenders[what], close = made
            closes.append(close)
    for train in contenders.values():  # the first iteration allocates and compiles
        train()
    speeds = {what: [] for what in contenders}
    for _ in range(rounds):
        for what, train in contenders.items():
            speeds[what].append(config.batch * per_second(train, turn, config.device))
    for close in closes:
        close()
    ours = speeds.pop(row.what)
    rows = [replace(row, what=what, note=note) for what, note in notes.items()]
    for what, each in speeds.items():
        rows.append(
            replace(
                row,
                what=what,
                steps_per_second=median(each),
                best=max(each),
                ratio=median(ours) / median(each),
            )
        )
    return [replace(row, steps_per_second=median(ours), best=max(ours)), *rows]


Made = tuple[Callable[[], object], Callable[[], object]]  # an iteration, and how it is closed


def _symbolic(config: Config, network: Any) -> dict[str, Made | str]:
    """Stable-Baselines3, or why it is not there."""
    try:
        sb3 = importlib.import_module("benchmarks.sb3")
    except ImportError:
        return {"Stable-Baselines3": "not installed: pip install stable-baselines3"}
    model = sb3.ppo(config, network)
    learn = lambda: model.learn(config.batch, reset_num_timesteps=False)  # noqa: E731
    return {"Stable-Baselines3": (learn, model.env.close)}


def _images(config: Config, network: Any) -> dict[str, Made | str]:
    """Ours without any setting of speed, and the plain loops; or why they are not there."""
    plain = Trainer(config.changed(**PLAIN))
    env = GameVectorEnv(
        config.game,
        config.training_variant(),
        config.num_envs,
        levels=config.training_levels,
        autoreset_mode="SameStep",
        threads=config.threads,
    )
    original = Loop(config, copy.deepcopy(network), env, host=True)
    made: dict[str, Made | str] = {
        "astray, all settings of speed off": (lambda: iterate(plain), plain.close),
        "original's shape, our environments": (original.iterate, env.close),
    }
    what = "CleanRL's shape, EnvPool's CoinrunHard-v0"
    try:
        envpool: Any = importlib.import_module("envpool")
        peer = envpool.make_gymnasium(
            "CoinrunHard-v0", num_envs=config.num_envs, num_threads=config.threads
        )
    except ImportError:
        return made | {what: "not installed: pip install envpool"}
    except ValueError:
        return made | {what: "not in this EnvPool; it needs Debian's libqt5gui5"}
    return made | {what: (Loop(config, network, peer, host=False).iterate, peer.close)}


def iterate(trainer: Trainer) -> None:
    """One iteration of the training loop, at a constant learning rate and without its log."""
    config = trainer.config
    rollout = collect(trainer)
    update(trainer, rollout, config.learning_rate)
    trainer.steps += config.batch


def per_second(train: Callable[[], object], turn: float, device: str) -> float:
    done, began = 0, time.perf_counter()
    while (passed := time.perf_counter() - began) < turn or not done:
        train()
        if device == "cuda":
            torch.cuda.synchronize()
        done += 1
    return done / passed
