"""Playing: the current policy in the environments, and what is kept to learn from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from astray.agents import ppo
from astray.training.config import Config
from astray.training.device import Model
from astray.training.trainer import Player


@dataclass
class Rollout:
    """What an iteration learns from: T steps of N environments, all on the training device."""

    observation: Tensor  # [T, N, ...] uint8
    action: Tensor  # [T, N] int64
    log_probability: Tensor  # [T, N], of the action when it was taken
    value: Tensor  # [T, N], the critic before the step
    advantage: Tensor  # [T, N]
    target: Tensor  # [T, N], what the critic should have said

    def flat(self) -> list[Tensor]:
        """Every field with steps and environments as one axis, [T * N, ...]."""
        return [x.flatten(0, 1) for x in vars(self).values()]


@torch.no_grad()
def collect(model: Model, player: Player, config: Config) -> Rollout:
    """Play `config.rollout` steps of every environment with sampled actions."""
    steps, n, device = config.rollout, config.environments, config.device
    env = player.env
    shape = env.single_observation_space.shape
    assert shape is not None
    observation = torch.empty((steps, n, *shape), dtype=torch.uint8, device=device)
    action = torch.empty((steps, n), dtype=torch.int64, device=device)
    log_probability = torch.empty((steps, n), device=device)
    value = torch.empty((steps + 1, n), device=device)
    reward, terminated, truncated = np.empty((steps, n)), *np.empty((2, steps, n), bool)
    last: list[tuple[int, np.ndarray, np.ndarray]] = []  # step, where, last observations there

    for t in range(steps):
        observation[t] = torch.from_numpy(player.observation)
        logits, value[t] = model(observation[t])
        noise = torch.rand(logits.shape, generator=player.generator, device=device)
        action[t], log_probability[t] = ppo.sample(logits, noise)
        player.observation, raw, terminated[t], truncated[t], info = env.step(
            action[t].numpy(force=True)
        )
        ended = terminated[t] | truncated[t]
        player.note(raw, ended, info)
        reward[t] = player.normaliser(raw, ended) if config.normalise_reward else raw
        if truncated[t].any():
            last.append((t, truncated[t], np.stack(info["final_obs"][truncated[t]])))
    _, value[steps] = model(torch.from_numpy(player.observation).to(device))

    ends, cuts = (torch.from_numpy(x).to(device) for x in (terminated, truncated))
    after = torch.where(cuts, _values_cut_off(model, last, value[1:]), value[1:])
    if config.timeouts == "terminate":
        ends = ends | cuts
    reward_tensor = torch.from_numpy(reward).float().to(device)
    advantage = ppo.advantages(
        reward_tensor, value[:-1], after, ends, cuts, config.gamma, config.lam
    )
    target = advantage + value[:-1]
    if config.normalise_advantage:
        advantage = ppo.normalised(advantage)
    return Rollout(observation, action, log_probability, value[:-1], advantage, target)


def _values_cut_off(
    model: Model, last: list[tuple[int, np.ndarray, np.ndarray]], like: Tensor
) -> Tensor:
    """The critic on the `last` observations of truncated episodes; [T, N], 0 elsewhere."""
    values = torch.zeros_like(like)
    if model.means.kernels and last:  # at once: a call for each step took a fifth of playing
        cut = np.zeros(values.shape, bool)
        for t, where, _ in last:
            cut[t] = where
        together = np.concatenate([observation for *_, observation in last])
        values[torch.from_numpy(cut)] = model(torch.from_numpy(together))[1]
        return values
    for t, where, observation in last:
        given = torch.from_numpy(observation).to(values.device)
        values[t, torch.from_numpy(where).to(values.device)] = model(given)[1]
    return values


@torch.no_grad()
def validate(model: Model, player: Player, config: Config) -> None:
    """Play as `collect` does, and keep nothing but how the episodes went."""
    for _ in range(config.rollout):
        logits, _ = model(torch.from_numpy(player.observation).to(config.device))
        noise = torch.rand(logits.shape, generator=player.generator, device=config.device)
        action, _ = ppo.sample(logits, noise)
        player.observation, reward, *ends, info = player.env.step(action.numpy(force=True))
        player.note(reward, ends[0] | ends[1], info)
