"""Checks of a training: that its network acts as it learns, its loss, and its weights."""

from collections.abc import Mapping
from copy import deepcopy
from typing import Any

import torch
from torch import Tensor, nn

from astray.agents.names import is_own
from astray.agents.recurrent import Recurrent
from astray.training import ppo
from astray.training.config import Config
from astray.training.fast import acceleration
from astray.training.fast.unedited import is_unedited
from astray.training.ppo import Samples, Sequences
from astray.training.trainer import Trainer
from astray.validation import shown

# Largest difference between a network's outputs in acting and in learning: relative to their
# deviation (rounding gives 1e-3, also in TF32, hidden state about 1), and to their size.
APART, ROUNDED = 0.05, 1e-4
SOME = 256  # observations that a network is checked with
UNROLLED = 8  # steps of sequences that are compared
RANDOM = 3  # times the difference that randomness makes between two calls in learning
REPEATED = 1e-6  # likewise in two calls in a row, of its size: float32 is rounded by 6e-8


class Diverged(RuntimeError):
    """The trained network's weights are no longer finite."""


def check_first(trainer: Trainer, samples: Samples) -> dict[str, float]:
    """Return how far accelerated outputs differ; raise ValueError if a network cannot learn."""
    config, using = trainer.config, trainer.fast.using
    if isinstance(samples, Sequences):
        check_recalled(trainer.network, samples)
    elif not using.of_network:
        check_memoryless(trainer.network, samples, config)
    kind = type(trainer.network)
    if not is_own(config.network) or (kind in acceleration.OURS and not is_unedited(kind)):
        seen = samples.observation
        check_modes(trainer, seen[0] if isinstance(samples, Sequences) else seen[:SOME])
    if not using.bfloat16:
        return {}
    first = samples.at(torch.arange(config.batch // config.minibatches, device=config.device))
    return acceleration.agreement(trainer.fast, trainer.network, first, config)


@torch.no_grad()
def check_modes(trainer: Trainer, seen: Tensor) -> None:
    """Raise ValueError if outputs for observations `seen` [N, ...] differ in learning mode.

    Or if its `state_dict`, which is all that a file keeps, does not decide them.
    """
    network, name = trainer.network, type(trainer.network).__name__
    before, acted, averages, said = deepcopy(network.state_dict()), network(seen), False, []
    for part in network.train().modules():  # dropout or a factor of 0 may hide running means
        averages |= part.training and "running_mean" in dict(part.named_buffers(recurse=False))
        if isinstance(part, nn.Dropout.__bases__):  # dropout of any kind
            part.eval()
    with torch.enable_grad(), torch.random.fork_rng([seen.device] if seen.is_cuda else []):
        for _ in range(2):
            said.append(network(seen))
            network.load_state_dict(before)  # its running means
        torch.manual_seed(trainer.config.seed + 1)
        anew = trainer.build(trainer.architecture).to(seen.device).eval()
    anew.load_state_dict(before, strict=False)
    said += [network.eval()(seen), anew(seen)]
    for then, learned, again, now, loaded in zip(acted, *said, strict=True):
        apart = max(_rounding(then), RANDOM * _size(again - learned))
        if averages or _size(learned - then) > apart:
            raise ValueError(
                "a network must say the same in acting and in learning, but for dropout; "
                f"{name} does not. LayerNorm does, BatchNorm never does"
            )
        if _size(loaded - now) > ROUNDED * _size(now):
            raise ValueError(
                f"a network's state_dict must hold all that decides what it says; that of {name} "
                "does not, so that its agent would be another one once it is loaded. Layers belong "
                "in an nn.ModuleList, and constants in buffers"
            )


@torch.no_grad()
def check_memoryless(network: nn.Module, samples: Samples, config: Config) -> None:
    """Raise ValueError if a network's outputs differ between acting and learning.

    A network with hidden state of its own does, since learning reorders observations, and so does
    one that compares those of a batch: one is also shown in a batch of itself alone. Rounding
    differences are allowed. A slow drift shows in two calls in a row, unless it is below `REPEATED`
    in each: that is not found.
    """
    some = samples.at(torch.arange(0, len(samples), config.minibatches, device=config.device))
    (logits, value), again = network(some.observation), network(some.observation)
    alone = network(some.observation[:1].expand_as(some.observation).contiguous())
    log_probability = ppo.log_probabilities(logits).gather(-1, some.action[:, None]).squeeze(-1)
    acted, learned = (some.log_probability, some.value), (log_probability, value)
    pairs = [(then, now, _rounding(then)) for then, now in zip(acted, learned, strict=True)]
    for then, now, of_one in zip((logits, value), again, alone, strict=True):
        pairs += [(then, now, REPEATED * _size(then)), (then[:1], of_one[:1], _rounding(then))]
    for then, now, most in pairs:
        if (apart := _size(now - then)) > most:
            raise ValueError(
                f"a network must say the same of an observation whenever it is shown it; what "
                f"{type(network).__name__} said of some in two calls differs by "
                f"{float(apart / _size(then)):.2g} of its size, as with a memory of its own, "
                "or where others of a batch count"
            )


@torch.no_grad()
def check_recalled(network: nn.Module, samples: Sequences) -> None:
    """Raise ValueError if a network's `recall`, by which it acts, and its `unroll` differ.

    Every other sequence is played alone, from a state of 0 wherever an episode begins, as agents
    are afterwards. Episodes begin at any step.
    """
    assert isinstance(network, Recurrent)
    shown = samples.observation[:UNROLLED]
    _, _, state = network.recall(shown[0], samples.state.clone(), samples.begins[0])
    steps, places = (torch.arange(n, device=state.device) for n in shown.shape[:2])
    begins = (steps[:, None] - places) % 4 == 2  # in odd steps none of those played alone
    some, acted = slice(None, None, 2), []
    learned = network.unroll(shown, state.clone(), begins)[:2]
    state = state[some]
    for seen, first in zip(shown[:, some], begins[:, some], strict=True):
        *said, state = network.recall(seen, state * ~first[:, None], first)
        acted.append(said)
    for then, now in zip(map(torch.stack, zip(*acted, strict=True)), learned, strict=True):
        now = now[:, some] if now.ndim > 1 else now
        apart = _size(now - then) if now.shape == then.shape else torch.tensor(torch.inf)
        if apart > _rounding(then):
            raise ValueError(
                f"a network with memory must say the same step by step, in recall, and of a whole "
                f"sequence, in unroll, whatever others are in its batch, and forget where `begins`;"
                f" what {type(network).__name__} says differs by {float(apart / _size(then)):.2g} "
                "of its size"
            )


def _rounding(said: Tensor) -> Tensor:
    """Return the largest difference in outputs that rounding makes."""
    return APART * said.std(correction=0) + ROUNDED * _size(said)


def _size(numbers: Tensor) -> Tensor:
    """Return the root of the mean square."""
    return numbers.square().mean().sqrt()


def check_losses(losses: Any) -> None:
    """Raise ValueError unless a custom loss returns a differentiable "loss"."""
    parts = losses.values() if isinstance(losses, Mapping) else [None]
    are_numbers = all(isinstance(part, Tensor) and not part.shape for part in parts)
    if not are_numbers or "loss" not in losses or losses["loss"].grad_fn is None:
        raise ValueError(
            "a loss must return tensors of one number by name, with 'loss' among them, which the "
            f"weights decide; got {shown(losses)}"
        )


def check_converging(trainer: Trainer) -> None:
    """Raise Diverged unless all learned values are finite; no later update could repair them."""
    if torch.stack([x.isfinite().all() for x in trainer.learned()]).all():
        return
    config = trainer.config
    raise Diverged(
        f"training diverged in update {trainer.iteration} of {config.iterations}, at "
        f"{trainer.steps:,} steps: weights are no longer finite; lower learning_rate "
        f"({config.learning_rate:g}) or gradient_norm ({config.gradient_norm:g}); the checkpoints "
        "before it are kept"
    )
