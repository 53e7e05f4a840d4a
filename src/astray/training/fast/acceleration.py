"""Choice of the accelerations for a training, and the accelerated network and loss.

Each setting can be switched off. With all off, or with a custom network or loss, training runs
`training.loop` with `ppo.loss` exactly as written.
"""

import contextlib
import os
import shutil
import sys
import sysconfig
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import torch
from llvmlite.binding import get_host_cpu_features
from torch import Tensor, nn
from torch.nn.functional import cosine_similarity

from astray.agents import policy
from astray.agents.actor_critic import ActorCritic
from astray.agents.cells import Cells
from astray.agents.clear import Clear
from astray.agents.impala import Impala
from astray.agents.mlp import MLP
from astray.agents.patch import Convolutions
from astray.agents.policy import Architecture
from astray.agents.recurrent import Recurrent
from astray.training import parallel, ppo, teacher
from astray.training.config import Config
from astray.training.fast import fused, microbatches, sparse
from astray.training.fast.unedited import is_unedited
from astray.training.ppo import Samples, Sequences

Loss = Callable[[Any, Samples, Config], dict[str, Tensor]]
OURS = (Cells, Clear, Convolutions, Impala, MLP)
# Images whose activations each stay below the 32 MB that a process keeps when they are freed.
MICROBATCH = {"impala": 128, "clear": 128, "cells": 128}
LAYOUT = ("impala", "cells")  # networks whose weights may be channels-last
LARGER = 1024  # images, for networks with smaller layers
AT_ONCE = 8192  # images that are valued; the largest layer has fewer than 2**31 outputs then
NEAR = 1e-3  # largest relative difference of the kernels' loss and gradient, in float32


@dataclass(frozen=True)
class Acceleration:
    """The accelerations in use, named as in the settings."""

    fused_cpu: bool = False
    bfloat16: bool = False
    channels_last: bool = False
    compile: bool = False
    cudagraphs: bool = False
    microbatch: int = 0  # 0: all
    groups: int = 1
    together: bool = False  # cut-off episodes are valued at once, which rounds otherwise

    @property
    def of_network(self) -> bool:
        """Whether the network is computed in another way than written."""
        by_parts = self.microbatch > 0
        return self.fused_cpu or self.bfloat16 or self.channels_last or self.compile or by_parts


@contextlib.contextmanager
def torch_settings(threads: int) -> Iterator[None]:
    """Apply torch's process-wide settings for training, and restore them afterwards.

    Denormal numbers are flushed to 0 because they are slow, and cuDNN searches for the fastest
    algorithms because shapes stay the same.
    """
    denormals, count = sys.float_info.min / 2 > 0, torch.get_num_threads()
    search = torch.backends.cudnn.benchmark
    torch.set_num_threads(threads)
    torch.backends.cudnn.benchmark = True
    torch.set_flush_denormal(True)
    try:
        with policy.defaults("cpu"), torch.enable_grad():
            yield
    finally:
        torch.set_flush_denormal(not denormals)
        torch.backends.cudnn.benchmark = search
        torch.set_num_threads(count)


def resolve(config: Config, ours: bool = True, planes: bool = True) -> Acceleration:
    """Resolve the settings for the device.

    A CPU uses the kernels, and bfloat16 for them and for convolutions if the processor multiplies
    in it. A GPU uses everything that is available.

    Args:
        ours: Whether network and loss are astray's own; otherwise nothing is used.
        planes: Whether an mlp sees planes; the kernels do not support vectors.

    Raises:
        ValueError: If a setting asks for something unavailable.
    """
    cpu, cuda = config.device == "cpu", config.device == "cuda"
    alone = config.teacher is None
    sparse_here = ours and alone and cpu and config.network == "mlp" and planes and sparse.usable()
    fused_cpu = _settled("fused_cpu", config, sparse_here)
    native = cpu and bool(get_host_cpu_features().get("avx512bf16"))
    large = fused_cpu or config.network not in ("mlp", "clear")  # bfloat16 is worth it on a CPU
    # GPUs from before 2020 only imitate it.
    old = cuda and torch.cuda.is_available() and not torch.cuda.is_bf16_supported(False)
    layout, compiler = config.network in LAYOUT, compiles(config.device) and not fused_cpu
    return Acceleration(
        fused_cpu,
        bfloat16=_settled("bfloat16", config, ours, suits=(cuda and not old) or (native and large)),
        channels_last=_settled(
            "channels_last", config, ours and layout, suits=cuda or config.network == "cells"
        ),
        compile=_settled("compile", config, ours and compiler, suits=cuda),
        cudagraphs=_settled("cudagraphs", config, ours and cuda),
        microbatch=microbatch(config, ours and cpu and config.network != "mlp"),
        groups=groups(config),
        together=fused_cpu or cuda,
    )


def microbatch(config: Config, there: bool) -> int:
    """Return the samples per forward pass, 0 for all; raise ValueError if none may be chosen."""
    if config.fast.microbatch and not there:
        raise ValueError(
            f"microbatch needs a CPU, a network of convolutions and loss of astray's own; got "
            f"device={config.device!r}, network={config.network!r}"
        )
    return (config.fast.microbatch or MICROBATCH.get(config.network, LARGER)) if there else 0


def groups(config: Config) -> int:
    """Return the number of environment groups: one steps while the device infers for another."""
    here = config.num_envs // parallel.size()
    one = config.device != "cuda" or here % 2 or config.teacher is not None
    return config.fast.groups or (1 if one else 2)


def compiles(device: str) -> bool:
    """Return whether torch.compile has a C++ compiler and, for CUDA, Triton and its needs."""
    if device != "cuda":
        return bool(shutil.which("g++"))
    compiler = os.environ.get("CC") or shutil.which("gcc") or shutil.which("clang")
    headers = Path(sysconfig.get_config_var("INCLUDEPY") or "", "Python.h")
    return bool(find_spec("triton") and compiler and headers.exists())


def _settled(name: str, config: Config, there: bool, suits: bool = True) -> bool:
    """Return whether to use acceleration `name`, given whether it is available and suits."""
    asked = getattr(config.fast, name)
    if asked and not there:
        raise ValueError(
            f"{name} must be off with device={config.device!r}, this network and this loss; "
            f"got network={config.network!r}"
        )
    return there and suits if asked is None else asked


@dataclass(frozen=True)
class Accelerated:
    """The network and loss as training computes them."""

    using: Acceleration
    network: Callable  # observations, a fixed number -> logits, values
    any_number: Callable  # any number of observations -> logits, values
    loss: Callable[[Samples], dict[str, Tensor]]
    plain: Loss  # as written
    config: Config

    def values(self, parts: Sequence[np.ndarray], memory: Sequence[Tensor]) -> Tensor:
        """Return the critic's values of observations in `parts` [n, ...], concatenated.

        Args:
            memory: Network states before the observations, [n, memory], for a network with memory.
        """
        shown = [torch.from_numpy(part).to(self.config.device) for part in parts]
        if memory[0].shape[1]:
            on = [torch.zeros(len(part), dtype=torch.bool, device=part.device) for part in shown]
            each = zip(shown, memory, on, strict=True)
            return torch.cat([self.any_number(*part)[1] for part in each])
        if self.config.device == "cuda":  # cuDNN searches anew for every other number at once
            here = parallel.shard(self.config.num_envs)
            at_once = (here.stop - here.start) // self.using.groups
            return policy.outputs(self.any_number, torch.cat(shown), at_once)[1]
        if self.using.together:  # a call for each step took a fifth of playing
            shown = torch.cat(shown).split(AT_ONCE)
        return torch.cat([self.any_number(part)[1] for part in shown])


def accelerate(
    network: nn.Module, loss: Loss, config: Config, architecture: Architecture
) -> Accelerated:
    """Return the fastest equivalent of a network and a loss; custom ones stay as written.

    A warning then names which of the two is custom.

    Raises:
        ValueError: If the settings ask for an acceleration that a custom network or loss does not
            have, or a loss passes another batch than its own to a network with memory.
    """
    if isinstance(network, Recurrent):
        whole = lambda batch: loss(_told(network, batch), batch, config)  # noqa: E731
        using = resolve(config, ours=False)
        return Accelerated(using, network.recall, network.recall, whole, loss, config)
    known, own_loss = type(network) in OURS, loss in (ppo.loss, teacher.loss)
    using = resolve(config, ours := known and own_loss, bool(architecture.largest))
    if using.of_network:
        known, own_loss = is_unedited(type(network)), is_unedited(loss)
    if using.fused_cpu:
        known = known and agree(network, config, architecture)
    if ours and not (known and own_loss):
        using = resolve(config.changed(fused_cpu=None, microbatch=None), ours=False)
    if not (known and own_loss):
        other = f"network {type(network).__name__}" if not known else f"loss {loss!r}"
        warnings.warn(
            f"training runs the {other} as it is written, which takes longer: astray.training.fast "
            "computes another",
            stacklevel=2,
        )
    elif config.device == "cuda" and config.fast.compile is None and not using.compile:
        warnings.warn(
            "learning is slower without torch.compile, which needs Triton, a C compiler and "
            "Python's headers",
            stacklevel=2,
        )
    if using.fused_cpu:  # the kernels add columns of this weight: each is to lie in one piece
        first = next(network.parameters())
        first.data = first.data.T.contiguous().T
    if using.of_network:
        model = Model(network, loss, config, using)
        return Accelerated(using, model.outputs, model, model.loss, loss, config)
    plain = lambda batch: loss(network, batch, config)  # noqa: E731
    return Accelerated(using, network, network, plain, loss, config)


def _told(network: Recurrent, batch: Samples) -> Callable:
    """Return the logits and values of a network with memory for a minibatch of sequences."""
    assert isinstance(batch, Sequences)

    def outputs(observation: Tensor) -> tuple[Tensor, Tensor]:
        if observation is not batch.observation:
            raise ValueError("a loss must ask a network with memory about the whole minibatch")
        return batch.said(network)

    return outputs


def agree(network: nn.Module, config: Config, architecture: Architecture) -> bool:
    """Return whether the kernels compute a network and `ppo.loss`, as on synthetic samples.

    Layers may have been replaced where they are, of which its code tells nothing.
    """
    random, actions, many = np.random.default_rng(0), architecture.actions, 64
    largest = np.array(architecture.largest)[:, None, None] + 1
    planes = random.integers(0, largest, (many, *architecture.shape)).astype(np.uint8)
    noise = torch.from_numpy(random.normal(size=(4, many)).astype(np.float32))
    action = torch.from_numpy(random.integers(0, actions, many))
    with torch.no_grad():
        logits, value = network(torch.from_numpy(planes))
        old = ppo.log_probabilities(logits).gather(1, action[:, None])[:, 0]
    batch = Samples(
        torch.from_numpy(planes),
        action,
        old + 0.3 * noise[0],
        value + 0.3 * noise[1],
        noise[2],
        value + noise[3],
    )
    plain = ppo.loss(network, batch, config)
    try:
        fast = Model(network, ppo.loss, config, Acceleration(fused_cpu=True)).loss(batch)
        parts = [torch.stack([x.detach() for x in each.values()]) for each in (plain, fast)]
        one, two = (_gradient(network, each["loss"]) for each in (plain, fast))
    except (TypeError, ValueError, RuntimeError):  # weights that the kernels do not support
        return False
    return (
        plain.keys() == fast.keys()
        and torch.allclose(*parts, rtol=NEAR, atol=NEAR)
        and bool((one - two).norm() <= NEAR * one.norm())
    )


def agreement(fast: Accelerated, network: nn.Module, batch: Samples, config: Config) -> dict:
    """Return cosine and length ratio of the accelerated gradient to the plain float32 gradient.

    Convolutions in bfloat16 have been wrong on some GPUs (pytorch issue 150700).
    """
    one = _gradient(network, fast.loss(batch)["loss"])
    two = _gradient(network, fast.plain(network, batch, config)["loss"])
    return {
        "gradient/cosine": cosine_similarity(one, two, 0).item(),
        "gradient/ratio": (one.norm() / two.norm()).item(),
    }


def _gradient(network: nn.Module, loss: Tensor) -> Tensor:
    """Return the gradient of a loss by all weights as one vector."""
    gradients = torch.autograd.grad(loss, list(network.parameters()))
    return torch.cat([x.flatten() for x in gradients])


class Model:
    """One of astray's own networks with a loss, in the fastest form for a device."""

    def __init__(self, network: nn.Module, loss: Loss, config: Config, using: Acceleration):
        assert isinstance(network, ActorCritic)
        self.own, self.plain, self.config, self.using = network, loss, config, using
        self._precision = torch.bfloat16 if using.bfloat16 else torch.float32
        if using.channels_last:
            network.to(memory_format=torch.channels_last)  # pyrefly: ignore
        self.outputs: Callable = self.__call__
        self.loss: Callable = self._loss
        if using.compile:  # not the whole update: torch breaks graphs at the optimizer
            # A process may train more agents of different shapes than torch allows a function.
            limits: Any = torch._dynamo.config
            limits.recompile_limit = limits.accumulated_recompile_limit
            warnings.filterwarnings("ignore", "TensorFloat32")  # the heads stay float32
            self.outputs = torch.compile(self.__call__, fullgraph=True, dynamic=False)
            self.loss = torch.compile(self._loss, fullgraph=True, dynamic=False)

    def __call__(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits [B, actions] and values [B] for any number of observations."""
        if self.using.fused_cpu:
            outputs = self._sparse(observation)
            return outputs[:, :-1], outputs[:, -1]
        size = self.using.microbatch
        if size and len(observation) > size:
            logits, values = zip(*map(self.__call__, observation.split(size)), strict=True)
            return torch.cat(logits), torch.cat(values)
        with torch.autocast(
            observation.device.type, torch.bfloat16, self.using.bfloat16, cache_enabled=False
        ):
            features = self.own.hidden(observation)
        return self.own.heads(features.float())

    def _loss(self, batch: Samples) -> dict[str, Tensor]:
        if not self.using.fused_cpu:

            def whole(part: Samples) -> dict[str, Tensor]:
                return self.plain(self.__call__, part, self.config)

            size = self.using.microbatch
            if size and len(batch) > size:
                return microbatches.loss(whole, list(self.own.parameters()), batch, size)
            return whole(batch)
        weights = (self.config.clip, self.config.value_weight, self.config.entropy_weight)
        total, parts = fused.loss(self._sparse(batch.observation), batch, weights)
        return {"loss": total, **dict(zip(fused.PARTS, parts, strict=True))}

    def _sparse(self, observation: Tensor) -> Tensor:
        assert isinstance(self.own, MLP)
        return sparse.outputs(self.own, observation, self._precision)
