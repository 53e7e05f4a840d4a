"""How the device computes what PPO asks of the network: the settings of speed alone.

Each can be switched off; with all off the plain formulas of `agents.ppo` are what runs.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
import sysconfig
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import torch
from llvmlite.binding import get_host_cpu_features
from torch import Tensor, nn
from torch.nn.functional import cosine_similarity

from astray.agents import fused, ppo, sparse
from astray.agents.clear import Clear
from astray.agents.impala import Impala
from astray.agents.small import Small
from astray.training import parallel
from astray.training.config import Config

# Of each minibatch: the parts of the loss, and the gradient's length before it is clipped.
MEASURED = ("loss", "policy_loss", "value_loss", "entropy", "kl", "clipped", "gradient_norm")


@dataclass(frozen=True)
class Means:
    """What is in use, of the settings of the same names."""

    kernels: bool
    bfloat16: bool
    channels_last: bool
    compiled: bool
    graphs: bool
    groups: int
    together: bool  # cut-off episodes are valued at once, which rounds otherwise than one by one


@contextlib.contextmanager
def flushed_denormals() -> Iterator[None]:
    """Numbers too near 0 for all their digits count as 0, since they are slow; then as before."""
    kept = sys.float_info.min / 2 > 0
    torch.set_flush_denormal(True)
    try:
        yield
    finally:
        torch.set_flush_denormal(not kept)


def means(config: Config) -> Means:
    """What the settings come to; ValueError where one asks for what there is not.

    On a CPU the kernels, and for them and convolutions bfloat16 where the processor multiplies
    in it. On a GPU all that there is for it.
    """
    cpu, cuda = config.device == "cpu", config.device == "cuda"
    here = config.environments // parallel.size()
    kernels = _settled("kernels", config, cpu and config.network == "small" and sparse.usable())
    native = cpu and bool(get_host_cpu_features().get("avx512bf16"))
    large = kernels or config.network == "impala"  # enough for bfloat16 to be worth it on a CPU
    # GPUs from before 2020 only imitate it.
    old = cuda and torch.cuda.is_available() and not torch.cuda.is_bf16_supported(False)
    return Means(
        kernels,
        bfloat16=_settled("bfloat16", config, True, suits=(cuda and not old) or (native and large)),
        channels_last=_settled("channels_last", config, config.network == "impala", suits=cuda),
        compiled=_settled("compiled", config, compiles(config.device) and not kernels, suits=cuda),
        graphs=_settled("graphs", config, cuda),
        groups=config.groups or (2 if cuda and here % 2 == 0 else 1),
        together=kernels or cuda,
    )


def compiles(device: str) -> bool:
    """torch.compile finds what it needs: a C++ compiler; for CUDA Triton, and what that needs."""
    if device != "cuda":
        return bool(shutil.which("g++"))
    compiler = os.environ.get("CC") or shutil.which("gcc") or shutil.which("clang")
    headers = Path(sysconfig.get_config_var("INCLUDEPY") or "", "Python.h")
    return bool(find_spec("triton") and compiler and headers.exists())


def _settled(name: str, config: Config, there: bool, suits: bool = True) -> bool:
    """Whether to use what `name` is, which may be `there`, and may suit the device."""
    asked = getattr(config, name)
    if asked and not there:
        raise ValueError(
            f"there is no {name} with device={config.device!r} and network={config.network!r} here"
        )
    return there and suits if asked is None else asked


class Model:
    """The network as it is used in training."""

    def __init__(self, network: nn.Module, config: Config):
        assert isinstance(network, Impala | Clear | Small)
        self.network, self.config, self.means = network, config, means(config)
        self._precision = torch.bfloat16 if self.means.bfloat16 else torch.float32
        if self.means.channels_last:
            network.to(memory_format=torch.channels_last)  # pyright: ignore
        self._outputs: Callable = self
        self._losses: Callable = self._sum
        if self.means.compiled:  # not the whole update: torch breaks graphs at the optimizer
            # A process may train more agents of different shapes than torch allows a function.
            limits: Any = torch._dynamo.config
            limits.recompile_limit = limits.accumulated_recompile_limit
            warnings.filterwarnings("ignore", "TensorFloat32")  # the heads stay float32
            self._outputs = torch.compile(self.__call__, fullgraph=True, dynamic=False)
            self._losses = torch.compile(self._sum, fullgraph=True, dynamic=False)
        elif config.device == "cuda" and config.compiled is None:
            warnings.warn(
                "learning is slower without torch.compile, which needs Triton, a C compiler and "
                "Python's headers", stacklevel=2,
            )  # fmt: skip

    def __call__(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Logits [B, actions] and values [B], of any number of observations."""
        if self.means.kernels:
            outputs = self._sparse(observation)
            return outputs[:, :-1], outputs[:, -1]
        with torch.autocast(
            observation.device.type, torch.bfloat16, self.means.bfloat16, cache_enabled=False
        ):
            features = self.network.hidden(observation)
        return self.network.heads(features.float())

    def act(self, observation: Tensor, noise: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Actions drawn with `noise` [B, actions], their log-probabilities, and values, all [B]."""
        logits, value = self._outputs(observation)
        return *ppo.sample(logits, noise), value

    def losses(self, samples: list[Tensor]) -> dict[str, Tensor]:
        """PPO's loss on a minibatch (the fields of `Rollout`, [B, ...]), and its parts."""
        return self._losses(samples)

    def _sum(self, samples: list[Tensor]) -> dict[str, Tensor]:
        config = self.config
        if not self.means.kernels:
            return loss(self.__call__, samples, config)
        weights = (config.clip, config.value_weight, config.entropy_weight)
        total, parts = fused.Loss.apply(self._sparse(samples[0]), samples[1:], weights)  # pyright: ignore
        return {"loss": total, **dict(zip(fused.PARTS, parts, strict=True))}

    def _sparse(self, observation: Tensor) -> Tensor:
        assert isinstance(self.network, Small)
        return sparse.outputs(self.network, observation, self._precision)

    def agreement(self, samples: list[Tensor]) -> dict[str, float]:
        """The gradient beside that of the plain formulas in float32: cosine, ratio of lengths.

        Convolutions in bfloat16 have been wrong on some GPUs (pytorch issue 150700).
        """
        parameters = list(self.network.parameters())
        one, two = (
            torch.cat([x.flatten() for x in torch.autograd.grad(f(samples)["loss"], parameters)])
            for f in (self.losses, lambda given: loss(self.network, given, self.config))
        )
        return {
            "gradient/cosine": cosine_similarity(one, two, 0).item(),
            "gradient/ratio": (one.norm() / two.norm()).item(),
        }


def loss(network: Callable, samples: list[Tensor], config: Config) -> dict[str, Tensor]:
    """PPO's loss on a minibatch (the fields of `Rollout`, [B, ...]), and its parts."""
    observation, action, old_log_probability, old_value, advantage, target = samples
    logits, value = network(observation)
    of_all = ppo.log_probabilities(logits)
    log_probability = of_all.gather(-1, action[:, None]).squeeze(-1)
    log_ratio = log_probability - old_log_probability
    surrogate = ppo.policy_loss(log_ratio, advantage, config.clip)
    critic = ppo.value_loss(value, old_value, target, config.clip)
    entropy = ppo.entropy(of_all)
    with torch.no_grad():
        ratio = log_ratio.exp()
        kl = ((ratio - 1) - log_ratio).mean()  # Schulman's unbiased, never negative estimate
        clipped = ((ratio - 1).abs() > config.clip).float().mean()
    total = surrogate + config.value_weight * critic - config.entropy_weight * entropy
    return {
        "loss": total, "policy_loss": surrogate, "value_loss": critic, "entropy": entropy,
        "kl": kl, "clipped": clipped,
    }  # fmt: skip
