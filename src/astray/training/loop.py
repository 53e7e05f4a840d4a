"""The training loop, top to bottom."""

from __future__ import annotations

import contextlib
import functools
import time
from pathlib import Path

import torch
from torch import Tensor, nn

from astray.agents import policy
from astray.training import checkpoint, parallel
from astray.training.config import Config
from astray.training.device import MEASURED, flushed_denormals
from astray.training.log import Log
from astray.training.rollout import Rollout, collect, validate
from astray.training.trainer import Trainer


def train(config: Config, folder: Path, *, progress: bool = True, wait: bool = False) -> Path:
    """Train an agent in the run folder `folder`, or go on where it stopped; its last checkpoint.

    wait  where another process trains in the folder, until it has ended; else it is an error

    On a CPU, a run that was stopped and resumed has the weights and metrics of one that was not.
    """
    if not policy.usable(config.device):
        raise ValueError(f"there is no device {config.device!r} that torch can use")
    torch.set_num_threads(config.threads)
    torch.backends.cudnn.benchmark = True  # shapes stay the same, so that searching once pays
    with (
        flushed_denormals(),
        parallel.processes(config.device),
        checkpoint.claim(folder, config, wait),
        contextlib.closing(Trainer(config)) as trainer,
    ):
        checkpoint.restore(folder, trainer)
        writes = Log(folder, trainer.steps, config, progress) if parallel.first() else None
        with writes or contextlib.nullcontext() as log:
            while trainer.iteration < config.iterations:
                metrics, speed = iterate(trainer)
                if log:
                    log.write(trainer.steps, metrics, speed)
                done = trainer.iteration == config.iterations
                if done or trainer.iteration % config.checkpoint_every == 0:
                    checkpoint.save(folder, trainer)
        parallel.wait()
    return checkpoint.latest(folder)


def iterate(trainer: Trainer) -> tuple[dict[str, float], dict[str, float]]:
    """Play a rollout and learn from it: how it went, which is reproducible, and how fast."""
    config, began = trainer.config, time.perf_counter()
    rate = config.learning_rate
    if config.anneal:
        rate *= 1 - trainer.steps / config.steps
    if trainer.validator and trainer.iteration % config.validation_every == 0:
        validate(trainer.validator)
    rollout = collect(trainer.actor)
    played = time.perf_counter()
    metrics = {}
    if trainer.iteration == 0 and trainer.model.means.bfloat16:
        samples = [x[: len(x) // config.minibatches] for x in rollout.flat()]
        metrics |= trainer.model.agreement(samples)
    metrics |= {f"update/{name}": x for name, x in update(trainer, rollout, rate).items()}
    trainer.steps += config.batch
    for name, player in trainer.players().items():
        metrics |= {f"{name}/{what}": x for what, x in player.summary().items()}
    seconds = time.perf_counter() - began
    speed = {"steps_per_second": config.batch / seconds, "playing": (played - began) / seconds}
    return metrics | {"update/learning_rate": rate}, speed


def update(trainer: Trainer, rollout: Rollout, rate: float) -> dict[str, float]:
    """Several passes of PPO over a rollout; the means of what was measured on the way."""
    config, samples = trainer.config, rollout.flat()
    trainer.set_rate(rate)
    step = functools.partial(trainer.repeat, functools.partial(learn, trainer, samples))
    sums, first_kl, count = None, None, len(samples[0])
    for _ in range(config.epochs):
        order = torch.randperm(
            config.batch, generator=trainer.player.generator, device=config.device
        )
        if count < config.batch:  # of several processes, which draw alike
            order = order[order < count]
        for indices in order.split(count // config.minibatches):
            measured = step(indices)
            sums = measured.clone() if sums is None else sums + measured
            first_kl = measured[MEASURED.index("kl")].clone() if first_kl is None else first_kl
    assert sums is not None and first_kl is not None
    parallel.average([sums, first_kl])
    updates = config.epochs * config.minibatches
    means = {name: x / updates for name, x in zip(MEASURED, sums.tolist(), strict=True)}
    return means | {"first_kl": float(first_kl)}  # not 0 where acting and learning round apart


def learn(trainer: Trainer, samples: list[Tensor], indices: Tensor) -> Tensor:
    """One step of the optimizer, on the samples at `indices`; what is `MEASURED` there."""
    # index_select: 183 us for 2,048 rows of 676 bytes, where samples[indices] takes 1,346
    losses = trainer.model.losses([x.index_select(0, indices) for x in samples])
    for x in trainer.weights:  # 10 us, where zero_grad takes 160
        x.grad = None
    losses["loss"].backward()
    parallel.average([x.grad for x in trainer.weights if x.grad is not None])
    norm = nn.utils.clip_grad_norm_(trainer.weights, trainer.config.gradient_norm)
    trainer.optimizer.step()
    return torch.stack([*(losses[name].detach() for name in MEASURED[:-1]), norm])
