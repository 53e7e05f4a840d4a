"""Where an iteration of training spends its time, part by part, beside the least it could take.

Each part is run alone, again and again, on a real rollout, and takes its median times how often
an iteration has it. Parts overlap in an iteration where the device works while the processor
goes on, and a graph's or the compiler's parts are one; the last row has the iteration itself.
The floor of a product is its operations at the rate of a large product of the same type on the
same device; of what is moved, its bytes at the rate of a copy. On a CPU all is processor time.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from statistics import median
from typing import ClassVar

import numpy as np
import torch
from torch import nn
from torch.utils.flop_counter import FlopCounterMode

from astray.training import ppo
from astray.training.config import Config
from astray.training.loop import collect, learn, update
from astray.training.trainer import Trainer
from benchmarks import tables
from benchmarks.tables import decimal

SIDE = 4096  # of the large product on a GPU; a quarter of it on a CPU
COPIED = 2**27  # bytes


@dataclass(frozen=True)
class Row:
    """A part of an iteration."""

    title: ClassVar[str] = "Where an iteration spends its time"
    training: str
    part: str
    times: int  # in an iteration
    milliseconds: float  # in an iteration, all together
    fraction: float  # of the iteration's
    floor: float | None = None  # milliseconds

    def cells(self) -> dict[str, str]:
        return {
            "training": self.training,
            "part": self.part,
            "times": f"{self.times:,}",
            "ms an iteration": f"{self.milliseconds:,.1f}",
            "fraction": f"{self.fraction:.0%}",
            "floor, ms": decimal(self.floor, 1),
        }


def measure(config: Config, rounds: int = 5) -> list[Row]:
    """Profile the training with `config`; the last row is the whole iteration."""
    trainer = Trainer(config)
    player, fast = trainer.player, trainer.fast
    whole = [_seconds(lambda: _iterate(trainer), config.device) for _ in range(rounds + 1)]
    rollout = collect(trainer)
    samples, size = rollout.flat(), config.batch // config.minibatches
    indices = torch.randperm(config.batch, device=config.device)[:size]
    minibatch = samples.at(indices)
    where = player.groups[0]
    seen, noise = rollout.observation[0, where], player.noise(1)[0, where]
    logits = fast.any_number(seen)[0].detach()
    played = config.num_steps * len(player.groups)
    updates = config.epochs * config.minibatches
    env, waits = player.envs[0], np.zeros(where.stop - where.start, np.int64)
    ends = torch.zeros_like(rollout.value, dtype=torch.bool)
    acting, learning = (_operations(trainer, x) for x in (seen, minibatch.observation))
    rate, copied = _product_rate(fast.using.bfloat16, config.device), _copy_rate(config.device)

    def backward() -> float:
        loss = fast.loss(minibatch)["loss"]
        trainer.optimizer.zero_grad(set_to_none=True)
        return _seconds(loss.backward, config.device)

    def step() -> None:
        nn.utils.clip_grad_norm_(trainer.weights, config.gradient_norm)
        trainer.optimizer.step()

    def infer() -> None:
        with torch.no_grad():
            fast.network(seen)

    gathered = 2 * sum(x.nbytes for x in vars(minibatch).values())
    parts: list[tuple[str, int, Callable[[], object], float | None]] = [
        ("environments: step and draw", played, lambda: env.step(waits), None),
        ("transfer", played, lambda: seen.copy_(player.images[where]), 2 * seen.nbytes / copied),
        ("inference", played, infer, acting / rate),
        ("sampling", played, lambda: ppo.sample(logits, noise), None),
        ("advantages", 1, lambda: ppo.advantages(
            rollout.target, rollout.value, rollout.value, ends, ends, config.gamma, config.lam,
        ), None),
        ("gather", updates, lambda: samples.at(indices), gathered / copied),
        ("forward and loss", updates, lambda: fast.loss(minibatch), learning / rate),
        ("backward", updates, backward, 2 * learning / rate),
        ("clip and optimizer", updates, step, None),
        ("a minibatch, whole", updates, lambda: trainer.repeat(
            lambda chosen: learn(trainer, samples, chosen), indices), 3 * learning / rate),
    ]  # fmt: skip
    total = median(whole[1:])
    name, rows = f"{config.game}, {tables.network(config)}", []
    for part, times, run, floor in parts:
        taken = _median(run, config.device, rounds) * times
        least = None if floor is None else 1e3 * floor * times
        rows.append(Row(name, part, times, 1e3 * taken, taken / total, least))
    trainer.close()
    least = sum(row.floor or 0 for row in rows[:-1])
    return [*rows, Row(name, "iteration", 1, 1e3 * total, 1.0, least)]


def _iterate(trainer: Trainer) -> None:
    update(trainer, collect(trainer), trainer.config.learning_rate)


def _median(run: Callable[[], object], device: str, rounds: int) -> float:
    """Seconds that `run` takes; or what it returns, where it has measured itself."""
    taken = []
    for _ in range(3 * rounds):
        began = _now(device)
        told = run()
        taken.append(told if isinstance(told, float) else _now(device) - began)
    return median(taken)


def _seconds(run: Callable[[], object], device: str) -> float:
    began = _now(device)
    run()
    return _now(device) - began


def _now(device: str) -> float:
    """The time, once the device has done all that it was given; on a CPU, of this process alone.

    Where others use the machine too, the clock on the wall makes long parts longer than short ones.
    """
    if device == "cpu":
        return time.process_time()
    if device == "cuda":
        torch.cuda.synchronize()
    return time.perf_counter()


def _operations(trainer: Trainer, observation: torch.Tensor) -> float:
    """Floating-point operations of the plain network on `observation`."""
    with FlopCounterMode(display=False) as counter, torch.no_grad():
        trainer.network(observation[:16])
    return counter.get_total_flops() / 16 * len(observation)


def _product_rate(bfloat16: bool, device: str) -> float:
    """Operations per second of a large square product."""
    side = SIDE if device == "cuda" else SIDE // 4
    x = torch.randn((side, side), device=device).to(torch.bfloat16 if bfloat16 else torch.float32)
    return 2 * side**3 / _median(lambda: x @ x, device, 5)


def _copy_rate(device: str) -> float:
    """Bytes per second read and written by a copy within the device's memory."""
    x = torch.ones(COPIED, dtype=torch.uint8, device=device)
    y = torch.empty_like(x)
    return 2 * len(x) / _median(lambda: y.copy_(x), device, 5)
