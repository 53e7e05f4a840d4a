"""Proximal policy optimisation (Schulman et al. 2017) as pure functions of tensors.

`loss` is its one definition: what `training.fast` computes sooner is checked against it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from astray.agents.recurrent import Recurrent
from astray.training.config import Config


@dataclass(frozen=True)
class Samples:
    """What PPO learns from: a rollout, with first axes [T, N], or a minibatch of it, with [B]."""

    observation: Tensor  # [..., H, W, C] or [..., C, H, W] uint8
    action: Tensor  # [...] int64
    log_probability: Tensor  # [...] float32, of the action when it was taken
    value: Tensor  # [...] float32, the critic's before the step
    advantage: Tensor  # [...] float32
    target: Tensor  # [...] float32, what the critic should have said

    def flat(self) -> Samples:
        """The same with steps and environments as one axis, [T * N]."""
        return type(self)(*(x.flatten(0, 1) for x in vars(self).values()))

    def at(self, indices: Tensor) -> Samples:
        """Those at `indices` [B] of the first axis."""
        # index_select: 183 us for 2,048 rows of 676 bytes, where x[indices] takes 1,346
        return type(self)(*(x.index_select(0, indices) for x in vars(self).values()))

    def split(self, size: int) -> list[Samples]:
        """The same in parts of `size` samples; the last may have fewer."""
        parts = (x.split(size) for x in vars(self).values())
        return [type(self)(*part) for part in zip(*parts, strict=True)]

    def __len__(self) -> int:
        return len(self.action)


@dataclass(frozen=True)
class Sequences(Samples):
    """Samples of a network with memory: a minibatch is whole sequences of environments."""

    begins: Tensor  # [T, N] bool, or [T * B] of a minibatch: an episode's first step
    state: Tensor  # [N, memory], before the first step

    def flat(self) -> Sequences:
        return self

    def at(self, indices: Tensor) -> Sequences:
        """Those of the environments at `indices` [B], [T * B], step by step."""
        steps = {k: x.index_select(1, indices).flatten(0, 1) for k, x in self._by_step().items()}
        return Sequences(**steps, state=self.state.index_select(0, indices))

    def said(self, network: Recurrent) -> tuple[Tensor, Tensor]:
        """Logits [T * B, actions] and values [T * B] of a minibatch, from its states on."""
        shown, begins = (x.unflatten(0, (-1, len(self))) for x in (self.observation, self.begins))
        logits, values, _ = network.unroll(shown, self.state, begins)
        return logits.flatten(0, 1), values.flatten()

    def _by_step(self) -> dict[str, Tensor]:
        return {name: x for name, x in vars(self).items() if name != "state"}

    def __len__(self) -> int:
        return len(self.state)


def loss(network: Callable, minibatch: Samples, config: Config) -> dict[str, Tensor]:
    """PPO's loss on a minibatch, "loss", and what is logged beside it; scalars.

    network  observations [B, ...] -> logits [B, actions], values [B]

    A function of the same arguments can take its place: see `training.loop.train`.
    """
    logits, value = network(minibatch.observation)
    of_all = log_probabilities(logits)
    log_probability = of_all.gather(-1, minibatch.action[:, None]).squeeze(-1)
    log_ratio = log_probability - minibatch.log_probability
    actor = policy_loss(log_ratio, minibatch.advantage, config.clip)
    critic = value_loss(value, minibatch.value, minibatch.target, config.clip)
    mean_entropy = entropy(of_all)
    with torch.no_grad():
        ratio = log_ratio.exp()
        approx_kl = ((ratio - 1) - log_ratio).mean()  # Schulman's unbiased, never negative one
        clip_fraction = ((ratio - 1).abs() > config.clip).float().mean()
    return {
        "loss": actor + config.value_weight * critic - config.entropy_weight * mean_entropy,
        "policy_loss": actor,
        "value_loss": critic,
        "entropy": mean_entropy,
        "approx_kl": approx_kl,
        "clip_fraction": clip_fraction,
    }


def log_probabilities(logits: Tensor) -> Tensor:
    """The logarithms of the probabilities of all actions, [B, A], from `logits` [B, A]."""
    # Along columns: 110 us for 4,096 x 15 on a CPU, and 1,065 along the short rows.
    return torch.log_softmax(logits.T.contiguous(), 0).T


def sample(logits: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Actions drawn from `logits` [B, A], and their log-probabilities, both [B].

    noise  [B, A] uniform in [0, 1); the Gumbel trick makes the draw a pure function of it
    """
    of_all = log_probabilities(logits)
    tiny = torch.finfo(noise.dtype).tiny
    gumbel = -torch.log(-torch.log(noise.clamp(min=tiny, max=1 - 1e-7)))
    action = (of_all + gumbel).argmax(-1)
    return action, of_all.gather(-1, action[:, None]).squeeze(-1)


def advantages(
    reward: Tensor,
    value: Tensor,
    next_value: Tensor,
    terminated: Tensor,
    truncated: Tensor,
    gamma: float,
    lam: float,
) -> Tensor:
    """Generalised advantage estimates (Schulman et al. 2016) of a rollout, all [T, N].

    value       the critic's before step t
    next_value  the critic's after step t, of the episode's own last observation where it stopped
    terminated  nothing comes after
    truncated   more would have come
    """
    result = torch.zeros_like(reward)
    gae = torch.zeros_like(reward[0])
    goes_on, same_episode = (~terminated).float(), (~(terminated | truncated)).float()
    delta = reward + gamma * next_value * goes_on - value
    for t in reversed(range(len(reward))):
        gae = delta[t] + gamma * lam * same_episode[t] * gae
        result[t] = gae
    return result


def normalised(x: Tensor) -> Tensor:
    """`x` with mean 0 and (unbiased) standard deviation 1 over all its entries."""
    return (x - x.mean()) / (x.std() + 1e-8)


def explained_variance(value: Tensor, target: Tensor) -> float:
    """The share of the targets' variance that the critic explains, 1 at best; 0 without any."""
    spread = target.var()
    return float(1 - (target - value).var() / spread) if spread > 0 else 0.0


def policy_loss(log_ratio: Tensor, advantage: Tensor, clip: float) -> Tensor:
    """The clipped surrogate, [B] -> scalar; log_ratio is new minus old log-probability."""
    ratio = log_ratio.exp()
    return -torch.min(ratio * advantage, ratio.clamp(1 - clip, 1 + clip) * advantage).mean()


def value_loss(value: Tensor, old: Tensor, target: Tensor, clip: float) -> Tensor:
    """Half the mean of the larger of the squared errors of `value` and of it clipped to `old`."""
    clipped = old + (value - old).clamp(-clip, clip)
    return 0.5 * torch.max((value - target) ** 2, (clipped - target) ** 2).mean()


def entropy(of_all: Tensor) -> Tensor:
    """Mean entropy in nats of the policies with `log_probabilities` [B, A]."""
    return -(of_all.exp() * of_all).sum(-1).mean()


@dataclass
class RewardNormaliser:
    """Divides rewards by the running standard deviation of the discounted return.

    As the original: its own discount (0.99, not the agent's 0.999), no mean subtracted, the
    result clipped to +-10; the statistics take in a step before it is normalised.
    """

    num_envs: int
    gamma: float = 0.99
    clip: float = 10.0
    mean: float = 0.0
    variance: float = 1.0
    count: float = 1e-4
    returns: np.ndarray = field(init=False)  # [N] float64, the running discounted returns

    def __post_init__(self) -> None:
        self.returns = np.zeros(self.num_envs)

    def __call__(self, reward: np.ndarray, ended: np.ndarray) -> np.ndarray:
        """Take in one step's `reward` and `ended`, both [N]; the normalised rewards [N]."""
        self.returns = self.gamma * self.returns + reward
        # Chan et al.'s parallel update of mean and variance.
        n, delta = self.num_envs, self.returns.mean() - self.mean
        total = self.count + n
        squares = self.variance * self.count + self.returns.var() * n
        self.mean += delta * n / total
        self.variance = (squares + delta**2 * self.count * n / total) / total
        self.count = total
        self.returns[ended] = 0.0
        return self.scaled(reward)

    def scaled(self, reward: np.ndarray) -> np.ndarray:
        """Rewards of any shape, normalised by what was taken in so far."""
        return np.clip(reward / np.sqrt(self.variance + 1e-8), -self.clip, self.clip)
