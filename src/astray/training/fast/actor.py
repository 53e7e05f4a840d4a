"""Playing as a device does it soonest: it infers for some environments while others step."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor

from astray.agents import policy
from astray.training import ppo
from astray.training.config import Config
from astray.training.fast.acceleration import Accelerated
from astray.training.fast.graphs import Captured
from astray.training.player import Player
from astray.training.ppo import Samples
from astray.training.rollout import estimate

AT_ONCE = 8192  # images; the largest layer has fewer than 2**31 outputs then


class Actor:
    """Draws the actions of a player's groups of environments, and keeps what was seen and done.

    `send` waits for nothing: the device infers for one group while the processor steps another.
    Observations go from the memory that the environments draw in straight to where they stay.
    """

    def __init__(self, fast: Accelerated, player: Player, config: Config, slots: int):
        """slots  steps that are kept; then the first is overwritten"""
        self.fast, self.player, self.config, self.slots = fast, player, config, slots
        self.device = torch.device(config.device)
        shape, n = player.images.shape[1:], len(player.images)
        self.observation = torch.empty(
            (slots + 1, n, *shape), dtype=torch.uint8, device=self.device
        )
        self.action = torch.empty((slots + 1, n), dtype=torch.int64, device=self.device)
        self.log_probability = torch.empty((slots + 1, n), device=self.device)
        self.value = torch.empty((slots + 1, n), device=self.device)
        self.advantage, self.target = torch.empty((2, slots, n), device=self.device)
        pinned = self.device.type == "cuda"
        self.chosen = torch.empty(n, dtype=torch.int64, pin_memory=pinned)
        self._sent = [torch.cuda.Event() for _ in player.groups] if pinned else None
        self._act: Callable | None = None

    def begin(self) -> None:
        """Draw the noise of a rollout, and send what the environments show now."""
        self.noise = self.player.noise(self.config.num_steps)
        for group in range(len(self.player.groups)):
            self.send(0, group)

    @torch.no_grad()
    def send(self, t: int, group: int) -> None:
        """Take what the group's environments show at step `t`, and begin to infer for them."""
        where, slot = self.player.groups[group], t % (self.slots + 1)
        seen = self.observation[slot, where]
        later = self._sent is not None  # on other devices than CUDA's nothing says when it is done
        seen.copy_(self.player.images[where], non_blocking=later)
        noise = self.noise[min(t, len(self.noise) - 1), where]
        if self._act is None:
            graphs = self.fast.using.cudagraphs
            self._act = Captured(self._infer, seen, noise) if graphs else self._infer
        action, log_probability, value = self._act(seen, noise)
        self.action[slot, where] = action
        self.log_probability[slot, where] = log_probability
        self.value[slot, where] = value
        self.chosen[where].copy_(action, non_blocking=later)
        if self._sent:
            self._sent[group].record()

    def _infer(self, observation: Tensor, noise: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        logits, value = self.fast.network(observation)
        return *ppo.sample(logits, noise), value

    def actions(self, group: int) -> np.ndarray:
        """The actions that were last sent for; from here on the group may step."""
        if self._sent:
            self._sent[group].synchronize()
        return self.chosen[self.player.groups[group]].numpy()


@torch.no_grad()
def collect(actor: Actor) -> Samples:
    """Play as `loop.collect` does; the next call overwrites what this one returned."""
    player, config, device = actor.player, actor.config, actor.device
    steps, n = config.num_steps, len(player.images)
    reward, terminated, truncated = np.empty((steps, n)), *np.empty((2, steps, n), bool)
    last: list[tuple[int, np.ndarray, np.ndarray]] = []  # step, where, last observations there

    actor.begin()
    for t in range(steps):
        for group, where in enumerate(player.groups):
            reward[t, where], terminated[t, where], truncated[t, where], info = player.step(
                t, actor.actions(group), group
            )
            actor.send(t + 1, group)
            if (cut := truncated[t, where]).any():
                there = np.flatnonzero(cut) + where.start
                last.append((t, there, np.stack(info["final_obs"][cut])))
    player.settle()

    value = actor.value[: steps + 1]
    cut = torch.from_numpy(truncated).to(device)
    next_value = torch.where(cut, _values_cut_off(actor, last, value[1:]), value[1:])
    advantage, target = estimate(
        player, config, value[:-1], next_value, reward, terminated, truncated
    )
    actor.advantage.copy_(advantage)
    actor.target.copy_(target)
    return Samples(
        actor.observation[:-1],
        actor.action[:-1],
        actor.log_probability[:-1],
        value[:-1],
        actor.advantage,
        actor.target,
    )


def _values_cut_off(
    actor: Actor, last: list[tuple[int, np.ndarray, np.ndarray]], like: Tensor
) -> Tensor:
    """The critic's values of the `last` observations of truncated episodes; [T, N], 0 elsewhere."""
    values, infer = torch.zeros_like(like), actor.fast.any_number
    if actor.fast.using.together and last:  # a call for each step took a fifth of playing
        step = np.concatenate([np.full(len(where), t) for t, where, _ in last])
        place = np.concatenate([where for _, where, _ in last])
        seen = torch.from_numpy(np.concatenate([observation for *_, observation in last]))
        seen = seen.to(values.device)
        if actor.device.type == "cuda":  # cuDNN searches anew for every other number at once
            found = policy.outputs(infer, seen, like.shape[1] // actor.fast.using.groups)[1]
        else:
            found = torch.cat([infer(part)[1] for part in seen.split(AT_ONCE)])
        values[torch.from_numpy(step), torch.from_numpy(place)] = found
        return values
    for t, where, observation in last:
        given = torch.from_numpy(observation).to(values.device)
        values[t, torch.from_numpy(where).to(values.device)] = infer(given)[1]
    return values


@torch.no_grad()
def validate(actor: Actor) -> None:
    """Play as `collect` does, and keep nothing but how the episodes went."""
    actor.begin()
    for t in range(actor.config.num_steps):
        for group in range(len(actor.player.groups)):
            actor.player.step(t, actor.actions(group), group)
            actor.send(t + 1, group)
    actor.player.settle()
