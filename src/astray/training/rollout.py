"""Playing: the current policy in the environments, and what is kept to learn from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from astray.agents import policy, ppo
from astray.training import parallel
from astray.training.device import Model
from astray.training.pipeline import Actor

AT_ONCE = 8192  # images; the largest layer has fewer than 2**31 outputs then


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
def collect(actor: Actor) -> Rollout:
    """Play `config.rollout` steps of every environment with sampled actions.

    The next call overwrites what this one returned.
    """
    player, config, device = actor.player, actor.model.config, actor.device
    steps, n = config.rollout, len(player.images)
    reward, terminated, truncated = np.empty((steps, n)), *np.empty((2, steps, n), bool)
    last: list[tuple[int, np.ndarray, np.ndarray]] = []  # step, where, last observations there

    actor.begin()
    for t in range(steps):
        for group, where in enumerate(player.groups):
            reward[t, where], terminated[t, where], truncated[t, where], info = player.step(
                t, group, actor.actions(group)
            )
            actor.send(t + 1, group)
            if (cut := truncated[t, where]).any():
                there = np.flatnonzero(cut) + where.start
                last.append((t, there, np.stack(info["final_obs"][cut])))
    player.settle()
    if config.normalise_reward:  # over the environments of all processes
        of_all, ended = (parallel.joined(x, 1) for x in (reward, terminated | truncated))
        for t in range(steps):
            reward[t] = player.normaliser(of_all[t], ended[t])[player.here]

    value = actor.value[: steps + 1]
    ends, cuts = (torch.from_numpy(x).to(device) for x in (terminated, truncated))
    after = torch.where(cuts, _values_cut_off(actor.model, last, value[1:]), value[1:])
    if config.timeouts == "terminate":
        ends = ends | cuts
    advantage = ppo.advantages(
        torch.from_numpy(reward).float().to(device),
        value[:-1], after, ends, cuts, config.gamma, config.lam,
    )  # fmt: skip
    actor.target.copy_(advantage + value[:-1])
    if config.normalise_advantage:
        of_all = torch.from_numpy(parallel.joined(advantage.numpy(force=True), 1)).to(device)
        advantage = ppo.normalised(of_all)[:, player.here]
    actor.advantage.copy_(advantage)
    return Rollout(
        actor.observation[:-1], actor.action[:-1], actor.log_probability[:-1], value[:-1],
        actor.advantage, actor.target,
    )  # fmt: skip


def _values_cut_off(
    model: Model, last: list[tuple[int, np.ndarray, np.ndarray]], like: Tensor
) -> Tensor:
    """The critic on the `last` observations of truncated episodes; [T, N], 0 elsewhere."""
    values = torch.zeros_like(like)
    if model.means.together and last:  # a call for each step took a fifth of playing
        step = np.concatenate([np.full(len(where), t) for t, where, _ in last])
        place = np.concatenate([where for _, where, _ in last])
        seen = torch.from_numpy(np.concatenate([observation for *_, observation in last]))
        seen = seen.to(values.device)
        if model.config.device == "cuda":  # cuDNN searches anew for every other number at once
            found = policy.outputs(model, seen, like.shape[1] // model.means.groups)[1]
        else:
            found = torch.cat([model(part)[1] for part in seen.split(AT_ONCE)])
        values[torch.from_numpy(step), torch.from_numpy(place)] = found
        return values
    for t, where, observation in last:
        given = torch.from_numpy(observation).to(values.device)
        values[t, torch.from_numpy(where).to(values.device)] = model(given)[1]
    return values


@torch.no_grad()
def validate(actor: Actor) -> None:
    """Play as `collect` does, and keep nothing but how the episodes went."""
    actor.begin()
    for t in range(actor.model.config.rollout):
        for group in range(len(actor.player.groups)):
            actor.player.step(t, group, actor.actions(group))
            actor.send(t + 1, group)
    actor.player.settle()
