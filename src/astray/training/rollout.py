"""What a rollout teaches: rewards and values made into advantages and targets."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from astray.training import parallel, ppo
from astray.training.config import Config
from astray.training.levels import Played
from astray.training.player import Player


def estimate(
    player: Player,
    config: Config,
    value: Tensor,
    next_value: Tensor,
    reward: np.ndarray,
    terminated: np.ndarray,
    truncated: np.ndarray,
) -> tuple[Tensor, Tensor]:
    """Advantages, and targets of the critic, of a rollout, all [T, N].

    Rewards are normalised by what `player` has seen so far, this rollout included, and replaced
    in `reward`; advantages are normalised over all environments. Levels that are only scored
    leave no trace in what rewards are normalised by.
    """
    own = reward.copy()
    if config.normalise_reward and not player.learns:
        reward = player.normaliser.scaled(reward)
    elif config.normalise_reward:  # over the environments of all processes
        everywhere, ended = (parallel.joined(x, 1) for x in (reward, terminated | truncated))
        for t in range(len(reward)):
            reward[t] = player.normaliser(everywhere[t], ended[t])[player.here]
    ends, cuts = (torch.from_numpy(x).to(value.device) for x in (terminated, truncated))
    if config.timeouts == "terminate":
        ends = ends | cuts
    advantage = ppo.advantages(
        torch.from_numpy(reward).float().to(value.device),
        value,
        next_value,
        ends,
        cuts,
        config.gamma,
        config.lam,
    )
    player.scored(lambda: Played(own, advantage.numpy(force=True), terminated, truncated))
    target = advantage + value
    if config.normalise_advantage:
        joined = torch.from_numpy(parallel.joined(advantage.numpy(force=True), 1))
        advantage = ppo.normalised(joined.to(value.device))[:, player.here]
    return advantage, target
