"""How the device computes what PPO asks of the network: the settings of speed alone.

Each can be switched off; then the plain formulas of `agents.ppo` are what runs.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from llvmlite.binding import get_host_cpu_features
from torch import Tensor, nn

from astray.agents import fused, ppo, sparse
from astray.agents.small import Small
from astray.training.config import Config


@dataclass(frozen=True)
class Means:
    """What is in use, of the settings of the same names."""

    kernels: bool
    bfloat16: bool


def means(config: Config) -> Means:
    """What the settings come to; ValueError where one asks for what there is not."""
    kernels = config.device == "cpu" and config.network == "small" and sparse.usable()
    native = get_host_cpu_features().get("avx512bf16", False)
    return Means(
        kernels=_settled("kernels", config, kernels, kernels),
        bfloat16=_settled("bfloat16", config, True, kernels and native),
    )


def _settled(name: str, config: Config, there: bool, suits: bool) -> bool:
    """Whether to use what `name` is, which may be `there`, and may suit the device."""
    asked = getattr(config, name)
    if asked and not there:
        raise ValueError(
            f"there is no {name} with device={config.device!r} and network={config.network!r} here"
        )
    return suits if asked is None else asked


class Model:
    """The network as it is used in training."""

    def __init__(self, network: nn.Module, config: Config):
        self.network, self.config, self.means = network, config, means(config)
        self.precision = torch.bfloat16 if self.means.bfloat16 else torch.float32

    def __call__(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Logits [B, actions] and values [B]."""
        if self.means.kernels:
            assert isinstance(self.network, Small)
            outputs = sparse.outputs(self.network, observation, self.precision)
            return outputs[:, :-1], outputs[:, -1]
        return self.network(observation)

    def losses(self, samples: list[Tensor]) -> dict[str, Tensor]:
        """PPO's loss on a minibatch (the fields of `Rollout`, [B, ...]), and its parts."""
        config = self.config
        if not self.means.kernels:
            return loss(self.network, samples, config)
        assert isinstance(self.network, Small)
        weights = (config.clip, config.value_weight, config.entropy_weight)
        outputs = sparse.outputs(self.network, samples[0], self.precision)
        total, parts = fused.Loss.apply(outputs, samples[1:], weights)  # pyright: ignore
        return {"loss": total, **dict(zip(fused.PARTS, parts, strict=True))}


def loss(network: nn.Module, samples: list[Tensor], config: Config) -> dict[str, Tensor]:
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
