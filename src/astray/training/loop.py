"""Proximal policy optimisation, top to bottom: act, step, advantages, epochs, loss, clip, step.

This file is plain torch. `training.fast` is an accelerated equivalent, which a `trainer` uses if
it supports the network and the loss.
"""

import atexit
import contextlib
import functools
import math
import time
import weakref
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from astray import acting, imports
from astray.acting import Reward
from astray.agents import policy
from astray.agents.names import is_own
from astray.agents.policy import Architecture
from astray.envs.pool import check_startable, most_threads
from astray.training import checkpoint, parallel, ppo
from astray.training.checks import check_converging, check_first, check_losses
from astray.training.config import SOLVER, Config
from astray.training.fast import acceleration
from astray.training.fast.acceleration import Loss
from astray.training.folders import START, TEACHER, AgentFolder, steps_saved
from astray.training.levels import MakeSampler
from astray.training.log import Log
from astray.training.ppo import Samples
from astray.training.trainer import Trainer
from astray.validation import bounded, of_kind, path_of, shown

SPARE = 16  # threads that libraries may start
# Most consecutive rollouts that are only scored: if 0.01 of them are learned from, longer runs
# practically never happen.
SCORED = 2000
Of = TypeVar("Of", bound=Callable[..., Any])


def train(
    config: Config,
    folder: str | Path,
    *,
    network: Callable[[Architecture], nn.Module] | None = None,
    loss: Loss | None = None,
    sampler: MakeSampler | None = None,
    reward: Reward | None = None,
    progress: bool = True,
    wait: bool = False,
) -> Path:
    """Train an agent in a run folder, or resume it; return its last checkpoint.

    On a CPU, a resumed run has the same weights and metrics as an uninterrupted one.

    Examples:
        >>> config = astray.Config("maze", "corner-small", steps=64, num_envs=4, num_steps=16,
        ...                        minibatches=1)
        >>> checkpoint = astray.train(config, "runs/mouse", progress=False)
        >>> checkpoint.name
        '64'

    Args:
        folder: This agent's own run folder; `astray train --out F` has one in F for each seed.
        network: Class, or entry point of `astray.networks`: `Architecture` -> module, which maps
            observations [B, ...] to logits [B, actions] and values [B].
        loss: Function of the arguments of `ppo.loss`; its results are logged.
        sampler: Class that chooses the training levels: see `levels.Sampler`.
        reward: Function of an `acting.Step` that returns the rewards [n] to learn from, which may
            use the game's, `step.rewards`. `step.level` has the levels' numbers. Returns in metrics
            are of these rewards, also in the validation.
        wait: Wait while another process trains in the folder, instead of raising an error.

    Raises:
        ValueError: If the folder holds another run, or the device does not exist.
        OSError: If the folder cannot be written.
        checkpoint.Claimed: If another process trains in it.
        Diverged: If weights are no longer finite; earlier checkpoints are kept.
    """
    own: dict[str, Any] = {"network": network, "loss": loss, "sampler": sampler, "reward": reward}
    folder = path_of("folder", folder)
    for _ in iterate(config, folder, **own, progress=progress, wait=wait):
        pass
    return checkpoint.latest(folder)


@dataclass(frozen=True, eq=False)
class Iteration:
    """One iteration of a training: a rollout and the update on it.

    Attributes:
        number: Iterations so far, counted across stops.
        steps: Environment steps so far.
        metrics: The line in metrics.jsonl: means of recent episodes and of the update.
        speed: Steps per second, and the fraction of time spent acting.
        trainer: Network, optimizer and environments, all live.
    """

    number: int
    steps: int
    metrics: Mapping[str, float]
    speed: Mapping[str, float]
    trainer: Trainer


def closed_at_exit(function: Of) -> Of:
    """Close generators of a function before Python takes itself apart: then they cannot save."""

    @functools.wraps(function)
    def begun(*given: Any, **named: Any) -> Any:
        running = weakref.ref(found := function(*given, **named))
        atexit.register(lambda: (one := running()) and one.close())
        return found

    return begun  # pyrefly: ignore


@closed_at_exit
def iterate(
    config: Config,
    folder: str | Path | None = None,
    *,
    network: Callable[[Architecture], nn.Module] | None = None,
    loss: Loss | None = None,
    sampler: MakeSampler | None = None,
    reward: Reward | None = None,
    progress: bool = False,
    wait: bool = False,
) -> Iterator[Iteration]:
    """Train as `train` does, and yield after every iteration.

    Leaving the loop stops the training with a checkpoint, from which a later call resumes. Using
    the trainer in between does not change what is learned.

    Examples:
        >>> config = astray.Config("maze", "corner-small", steps=128, num_envs=4, num_steps=16,
        ...                        minibatches=1)
        >>> [iteration.steps for iteration in astray.iterate(config)]
        [64, 128]

    Args:
        folder: Run folder; None to write nothing and start anew.

    Raises:
        Exception: The errors of `train`, at the first iteration.
    """
    config = checked(config, network=network, loss=loss, sampler=sampler, reward=reward)
    folder = None if folder is None else path_of("folder", folder)
    settings = functools.partial(acceleration.torch_settings, config.threads)
    with (
        parallel.processes(config.device),
        checkpoint.claim(folder, config, wait) if folder else contextlib.nullcontext(),
        contextlib.closing(begin(config, folder)) as trainer,
        Log(folder, trainer.steps, config, progress)
        if folder and parallel.first()
        else contextlib.nullcontext() as log,
    ):
        saved = trainer.iteration
        try:
            while trainer.iteration < config.iterations:
                # The caller's own settings are restored while it looks at an iteration.
                with settings(), chance(config, trainer.iteration):
                    metrics, speed = improve(trainer)
                    check_converging(trainer)
                    if log:
                        log.write(trainer.steps, metrics, speed)
                    done = trainer.iteration == config.iterations
                    if folder and (done or trainer.iteration % config.checkpoint_every == 0):
                        checkpoint.save(folder, trainer)
                        saved = trainer.iteration
                yield Iteration(trainer.iteration, trainer.steps, metrics, speed, trainer)
        except GeneratorExit:  # the caller left the loop
            if folder and saved < trainer.iteration:
                checkpoint.save(folder, trainer)
            raise
        parallel.wait()


@contextlib.contextmanager
def chance(config: Config, iteration: int) -> Iterator[None]:
    """Seed torch's random state, which dropout uses, from the seed and the iteration."""
    with torch.random.fork_rng(range(torch.cuda.device_count() if config.device == "cuda" else 0)):
        torch.manual_seed(
            int(np.random.SeedSequence((config.seed, iteration)).generate_state(1)[0])
        )
        yield


def checked(config: Config, **own: Any) -> Config:
    """Return the settings with the names of a custom network, loss, sampler and reward.

    Raises:
        ValueError: If they cannot be used for training here.
    """
    of_kind("config", config, Config)
    named: Any = {n: imports.name_of(x) for n, x in own.items() if x is not None}
    if own.get("loss") is ppo.loss and config.teacher is None:
        named["loss"] = None  # the same setting
    config = config.changed(**named)
    config.sampler.check_kind()
    config.custom()
    if not policy.usable(config.device):
        raise ValueError(f"there is no device {config.device!r} that torch can use")
    bounded("threads", config.threads, 1, most_threads())
    if config.threads > 1:  # both players' environments, torch, and spare ones
        check_startable(SPARE + 4 * config.threads)
    return config


def begin(config: Config, folder: Path | None = None) -> Trainer:
    """Create or resume the trainer; raise FileNotFoundError if its teacher or start is missing."""
    taught = folder / TEACHER if folder and config.teacher is not None else None
    if taught and config.teacher != SOLVER and not taught.exists():  # before a game is compiled
        told = f"the teacher {config.teacher} must be at {taught}; see `astray distil`"
        raise FileNotFoundError(told)
    if folder and not is_own(config.network):
        imports.known(config.network, policy.GROUP, nn.Module)  # as the agent is loaded later
    path = None
    if config.start is not None and not (folder and steps_saved(folder)):
        kept = folder / START if folder else None
        path = kept if kept and kept.exists() else AgentFolder.open(config.start).weights
        policy.read_weights(path, config.game, **config.sizes)  # before a game is compiled
    with acceleration.torch_settings(config.threads):
        trainer = Trainer(config, taught)
        with contextlib.ExitStack() as stack:
            stack.callback(trainer.close)
            if folder:
                checkpoint.restore(folder, trainer)
            if path:
                policy.load_into(trainer.network, path, config.game, **vars(trainer.architecture))
            stack.pop_all()
    return trainer


def improve(trainer: Trainer) -> tuple[dict[str, float], dict[str, float]]:
    """Play a rollout and learn from it; return reproducible metrics, and speeds."""
    config, began = trainer.config, time.perf_counter()
    rate = config.rate(trainer.steps)
    if trainer.validation and trainer.iteration % config.validation_every == 0:
        validate(trainer)
    rollout = play(trainer)
    played = time.perf_counter()
    metrics = check_first(trainer, rollout.flat()) if trainer.iteration == 0 else {}
    metrics |= {f"update/{name}": x for name, x in update(trainer, rollout, rate).items()}
    trainer.steps += config.batch
    for name, player in trainer.players().items():
        told = player.summary(math.inf if player is trainer.player else trainer.validated)
        metrics |= {f"{name}/{what}": x for what, x in told.items()}
        metrics |= {f"levels/{what}": x for what, x in player.sampled().items()}
    seconds = time.perf_counter() - began
    speed = {"steps_per_second": config.batch / seconds, "playing": (played - began) / seconds}
    return metrics | {"update/learning_rate": rate}, speed


def play(trainer: Trainer) -> Samples:
    """Play a rollout to learn from, after those in which a sampler only scores levels.

    Raises:
        ValueError: If the sampler hardly ever plans to learn.
    """
    for _ in range(SCORED):
        trainer.player.plan(trainer.steps)
        rollout = collect(trainer)
        if trainer.player.learns:
            return rollout
    raise ValueError(f"a sampler must plan to learn from one of {SCORED:,} rollouts; it does not")


@torch.no_grad()
def collect(trainer: Trainer) -> Samples:
    """Play `config.num_steps` steps of every environment with sampled actions, [T, N].

    The next call overwrites the result.
    """
    config, player, rollout = trainer.config, trainer.player, trainer.actor.rollout
    teacher = trainer.teacher if trainer.is_taught else None
    if teacher:
        teacher.begin(trainer.steps)
    cut: list[tuple[Any, ...]] = []  # indices of episodes cut off, what they show, and the memory
    rollout.begin(config.num_steps)
    for step in acting.play(teacher or trainer.actor, player, config.num_steps):
        rollout.note(step)
        if step.cut:
            cut.append((*step.cut, rollout.after[step.cut[0][1]]))
    player.settle()
    next_value = rollout.value[1:].clone()
    if cut:
        indices, shown_last, memory = zip(*cut, strict=True)
        steps, where = torch.from_numpy(np.concatenate(indices, 1))
        next_value[steps, where] = trainer.fast.values(shown_last, memory)
    rollout.estimate(config, next_value)
    return teacher.samples() if teacher else rollout.samples()


@torch.no_grad()
def validate(trainer: Trainer) -> None:
    """Play a rollout on the validation variant, without learning from it."""
    player, actor, steps = trainer.validation, trainer.validator, trainer.config.num_steps
    assert player and actor
    actor.rollout.begin(steps)
    for _ in acting.play(actor, player, steps):
        pass
    player.settle()


def update(trainer: Trainer, rollout: Samples, rate: float) -> dict[str, float]:
    """Learn from a rollout in several epochs; return the means of the logged values.

    Raises:
        ValueError: If a custom loss returns other names than before.
    """
    config, samples = trainer.config, rollout.flat()
    for group in trainer.optimizer.param_groups:
        group["lr"] = group["lr"].fill_(rate) if isinstance(group["lr"], Tensor) else rate
    step = functools.partial(trainer.repeat, functools.partial(learn, trainer, samples))
    trainer.network.train()  # dropout is active in learning, not in acting
    epochs = (minibatches(trainer, len(samples)) for _ in range(config.epochs))
    means = averaged(step(indices) for epoch in epochs for indices in epoch)
    trainer.network.eval()
    return means | {"explained_variance": explained(samples)}


def minibatches(trainer: Trainer, count: int) -> Sequence[Tensor]:
    """Return the indices [B] of an epoch's minibatches: all `count` samples in random order."""
    random, device = trainer.player.generator, trainer.config.device
    order = torch.randperm(count * parallel.size(), generator=random, device=device)
    if parallel.size() > 1:  # processes draw alike
        order = order[order < count]
    return order.split(count // trainer.config.minibatches)


def averaged(steps: Iterable[dict[str, Tensor]]) -> dict[str, float]:
    """Return the means of the steps' logged values over all processes, and the first KL.

    Raises:
        ValueError: If a loss does not return the same names in every step.
    """
    names, measured = [], []
    for step in steps:  # their tensors may be overwritten by the next step's
        if names and list(step) != names:
            raise ValueError(f"a loss must return the same names in every step, {shown(names)}")
        names = list(step)
        measured.append(torch.stack(list(step.values())))
    # The first is not 0 if acting and learning round differently.
    at = names.index("approx_kl") if "approx_kl" in names else None
    first = {} if at is None else {"first_kl": measured[0][at].clone()}
    total = sum(measured[1:], measured[0])
    parallel.average([total, *first.values()])
    means = {name: x / len(measured) for name, x in zip(names, total.tolist(), strict=True)}
    return means | {name: float(x) for name, x in first.items()}


def explained(samples: Samples) -> float:
    """Return the fraction of the targets' variance that the critic explains, in all processes."""
    whole = (parallel.joined(x.numpy(force=True)) for x in (samples.value, samples.target))
    return ppo.explained_variance(*map(torch.from_numpy, whole))


def learn(trainer: Trainer, samples: Samples, indices: Tensor) -> dict[str, Tensor]:
    """Take an optimizer step on samples at `indices` [B]; return losses and the gradient norm."""
    own = imports.guarded(f"the loss {trainer.config.loss}", ValueError, ImportError)
    with own if trainer.config.loss else contextlib.nullcontext():
        losses = trainer.fast.loss(samples.at(indices))
    if trainer.config.loss or not trainer.steps:
        check_losses(losses)
    for weight in trainer.weights:  # 10 us, where zero_grad takes 160
        weight.grad = None
    losses["loss"].backward()
    parallel.average([x.grad for x in trainer.weights if x.grad is not None])
    norm = nn.utils.clip_grad_norm_(trainer.weights, trainer.config.gradient_norm)
    trainer.optimizer.step()
    return {name: x.detach() for name, x in losses.items()} | {"gradient_norm": norm}
