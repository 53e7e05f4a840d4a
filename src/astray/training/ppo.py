"""Proximal policy optimisation (Schulman et al. 2017) as pure functions of tensors.

`loss` is the only definition; the accelerated version in `training.fast` is checked against it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from astray.agents.recurrent import Recurrent
from astray.training.config import Config

CLIP = 10.0  # of normalised rewards, as in the original
BELOW_ONE = 1 - 1e-7  # largest noise of which `sample` takes logarithms


@dataclass(frozen=True)
class Samples:
    """Training data of PPO: a rollout with leading axes [T, N], or a minibatch with [B]."""

    observation: Tensor  # [..., H, W, C] or [..., C, H, W] uint8
    action: Tensor  # [...] int64
    log_probability: Tensor  # [...] float32, of the action at the time
    value: Tensor  # [...] float32, critic's value before the step
    advantage: Tensor  # [...] float32
    target: Tensor  # [...] float32, target of the critic

    def flat(self) -> Samples:
        """Return the samples with steps and environments merged into one axis, [T * N]."""
        return type(self)(*(x.flatten(0, 1) for x in vars(self).values()))

    def at(self, indices: Tensor) -> Samples:
        """Return the samples at `indices` [B] of the first axis."""
        # index_select: 183 us for 2,048 rows of 676 bytes, where x[indices] takes 1,346
        return type(self)(*(x.index_select(0, indices) for x in vars(self).values()))

    def split(self, size: int) -> list[Samples]:
        """Split the samples into parts of `size`; the last part may be smaller."""
        parts = (x.split(size) for x in vars(self).values())
        return [type(self)(*part) for part in zip(*parts, strict=True)]

    def __len__(self) -> int:
        return len(self.action)


@dataclass(frozen=True)
class Sequences(Samples):
    """Samples for a network with memory: a minibatch consists of whole sequences."""

    begins: Tensor  # [T, N] bool, or [T * B] of a minibatch: an episode's first step
    state: Tensor  # [N, memory], before the first step

    def flat(self) -> Sequences:
        return self

    def at(self, indices: Tensor) -> Sequences:
        """Return the sequences of the environments at `indices` [B] as [T * B], step by step."""
        by_step = {name: x for name, x in vars(self).items() if name != "state"}
        steps = {name: x.index_select(1, indices).flatten(0, 1) for name, x in by_step.items()}
        return type(self)(**steps, state=self.state.index_select(0, indices))

    def said(self, network: Recurrent) -> tuple[Tensor, Tensor]:
        """Return logits [T * B, actions] and values [T * B] of a minibatch."""
        shown, begins = (x.unflatten(0, (-1, len(self))) for x in (self.observation, self.begins))
        logits, values, _ = network.unroll(shown, self.state, begins)
        return logits.flatten(0, 1), values.flatten()

    def __len__(self) -> int:
        return len(self.state)


def loss(network: Callable, minibatch: Samples, config: Config) -> dict[str, Tensor]:
    """Return PPO's loss on a minibatch as "loss", and more to log; ValueError for wrong outputs.

    A function of the same arguments can replace it: see `training.loop.train`.

    Args:
        network: Callable, observations [B, ...] -> logits [B, actions], values [B].
    """
    logits, value = outputs(network, minibatch)
    of_all = log_probabilities(logits)
    log_probability = of_all.gather(-1, minibatch.action[:, None]).squeeze(-1)
    log_ratio = log_probability - minibatch.log_probability
    actor = policy_loss(log_ratio, minibatch.advantage, config.clip)
    critic = value_loss(value, minibatch.value, minibatch.target, config.clip)
    mean_entropy = entropy(of_all)
    with torch.no_grad():
        ratio = log_ratio.exp()
        # Schulman's estimate: unbiased, never negative
        approx_kl = ((ratio - 1) - log_ratio).mean()
        clip_fraction = ((ratio - 1).abs() > config.clip).float().mean()
    return {
        "loss": actor + config.value_weight * critic - config.entropy_weight * mean_entropy,
        "policy_loss": actor,
        "value_loss": critic,
        "entropy": mean_entropy,
        "approx_kl": approx_kl,
        "clip_fraction": clip_fraction,
    }


def outputs(network: Callable, minibatch: Samples) -> tuple[Tensor, Tensor]:
    """Return logits [B, A] and values [B] on a minibatch; raise ValueError for other shapes."""
    logits, value = network(minibatch.observation)
    if not logits.shape[:-1] == value.shape == minibatch.action.shape:  # others would be broadcast
        raise ValueError("a network must give a row for each observation, also in learning")
    return logits, value


def log_probabilities(logits: Tensor) -> Tensor:
    """Return the log-probabilities [B, A] of all actions, given `logits` [B, A]."""
    # Along columns: 110 us for 4,096 x 15 on a CPU, and 1,065 along the short rows.
    return torch.log_softmax(logits.T.contiguous(), 0).T


def sample(logits: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
    """Sample actions from `logits` [B, A]; return them and their log-probabilities, both [B].

    Args:
        noise: [B, A] uniform in [0, 1). By the Gumbel trick the sample is a pure function of it.
    """
    of_all = log_probabilities(logits)
    tiny = torch.finfo(noise.dtype).tiny
    gumbel = -torch.log(-torch.log(noise.clamp(min=tiny, max=BELOW_ONE)))
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
    """Return generalised advantage estimates (Schulman et al. 2016) of a rollout, all [T, N].

    Args:
        value: Critic's values before step t.
        next_value: Critic's values after step t, for the episode's own last observation at an end.
        terminated: Whether the episode ended, so that no value follows.
        truncated: Whether the episode was cut, so that `next_value` counts.
    """
    result, gae = torch.zeros_like(reward), torch.zeros_like(reward[0])
    goes_on, same_episode = (~terminated).float(), (~(terminated | truncated)).float()
    delta = reward + gamma * next_value * goes_on - value
    for t in reversed(range(len(reward))):
        result[t] = gae = delta[t] + gamma * lam * same_episode[t] * gae
    return result


def normalised(x: Tensor) -> Tensor:
    """Return `x` [...] scaled to mean 0 and (unbiased) standard deviation 1 over all entries."""
    return (x - x.mean()) / (x.std() + 1e-8)


def explained_variance(value: Tensor, target: Tensor) -> float:
    """Return the fraction of the variance of `target` [B] that `value` [B] explains, or 0."""
    spread = target.var()
    varies = spread > (1e-6 * target.abs().max()) ** 2  # by more than rounding
    return float(1 - (target - value).var() / spread) if varies else 0.0


def policy_loss(log_ratio: Tensor, advantage: Tensor, clip: float) -> Tensor:
    """Return the clipped surrogate loss; all [B]. `log_ratio` is new minus old log-probability."""
    ratio = log_ratio.exp()
    return -torch.min(ratio * advantage, ratio.clamp(1 - clip, 1 + clip) * advantage).mean()


def value_loss(value: Tensor, old: Tensor, target: Tensor, clip: float) -> Tensor:
    """Return half the mean larger squared error of `value`, unclipped or clipped; all [B]."""
    clipped = old + (value - old).clamp(-clip, clip)
    return 0.5 * torch.max((value - target) ** 2, (clipped - target) ** 2).mean()


def entropy(of_all: Tensor) -> Tensor:
    """Return the mean entropy in nats of policies with log-probabilities `of_all` [B, A]."""
    return -(of_all.exp() * of_all).sum(-1).mean()


@dataclass
class RewardNormaliser:
    """Divides rewards by the running standard deviation of the discounted return.

    As in the original, it has its own discount (0.99, not the agent's 0.999), subtracts no mean
    and clips the result to +-CLIP. The statistics include a step before that step is normalised.
    """

    num_envs: int
    gamma: float = 0.99
    clip: float = CLIP
    mean: float = 0.0
    variance: float = 1.0
    count: float = 1e-4
    returns: np.ndarray = field(init=False)  # [N] float64, the running discounted returns

    def __post_init__(self) -> None:
        self.returns = np.zeros(self.num_envs)

    @np.errstate(over="ignore", invalid="ignore")
    def __call__(self, reward: np.ndarray, ended: np.ndarray) -> np.ndarray:
        """Update the statistics with `reward`, `ended` [N]; return normalised rewards [N].

        Raises:
            ValueError: If the variance is no finite number, by which all rewards would be 0.
        """
        self.returns = self.gamma * self.returns + reward
        # Chan et al.'s parallel update of mean and variance.
        n, delta = self.num_envs, self.returns.mean() - self.mean
        total = self.count + n
        squares = self.variance * self.count + self.returns.var() * n
        self.mean += delta * n / total
        self.variance = (squares + delta**2 * self.count * n / total) / total
        if not np.isfinite(self.variance):
            most = f"{np.abs(reward).max():g}"
            raise ValueError(f"rewards up to {most} are too large for a variance; divide them")
        self.count = total
        self.returns[ended] = 0.0
        return self.scaled(reward)

    def scaled(self, reward: np.ndarray) -> np.ndarray:
        """Normalise rewards [...] of any shape with the current statistics."""
        return np.clip(reward / np.sqrt(self.variance + 1e-8), -self.clip, self.clip)
