"""Environments of one variant as a training plays them."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import torch
from torch import Tensor

from astray.agents.ppo import RewardNormaliser
from astray.envs.vector import GameVectorEnv
from astray.game import Variant
from astray.training.config import Config
from astray.training.device import means

RECENT = 100  # ended episodes that the logged means are over


class Player:
    """Environments of one variant, what they show now, and how their last episodes went."""

    def __init__(self, config: Config, variant: Variant, levels: range, salt: int):
        n, count = config.environments, means(config).groups
        self.groups = [slice(k * n // count, (k + 1) * n // count) for k in range(count)]
        self.envs = [
            GameVectorEnv(
                config.game, variant, group.stop - group.start,
                observation=config.observation, levels=levels, autoreset_mode="SameStep",
                threads=config.threads,
            )
            for group in self.groups
        ]  # fmt: skip
        self.game, self.space = self.envs[0].game, self.envs[0].single_observation_space
        self.actions = len(self.game.actions)
        # What the environments show now; a GPU reads pinned memory while the processor goes on.
        self.images = torch.empty(
            (n, *self.space.shape),  # pyright: ignore
            dtype=torch.uint8, pin_memory=config.device == "cuda",
        )  # fmt: skip
        # Seeds far apart: environment i of a batch seeded with k is seeded with k + i.
        seed = (config.seed * 16 + salt) * 2**32
        for env, group in zip(self.envs, self.groups, strict=True):
            self.images[group] = torch.from_numpy(env.reset(seed=seed + group.start)[0])
        self.generator = torch.Generator(config.device).manual_seed(config.seed * 16 + salt)
        self.normaliser = RewardNormaliser(n, config.reward_gamma)
        self.running_return = np.zeros(n)
        self.events = self.game.events
        self.recent: deque[list[float]] = deque(maxlen=RECENT)  # return, length, events' happening

    def step(
        self, group: int, actions: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step the environments of a group: reward, terminated, truncated [n], and info."""
        env, where = self.envs[group], self.groups[group]
        _, reward, terminated, truncated, info = env.step(actions, self.images[where].numpy())
        self._note(where, reward, terminated | truncated, info)
        return reward, terminated, truncated, info

    def _note(
        self, where: slice, reward: np.ndarray, ended: np.ndarray, info: dict[str, Any]
    ) -> None:
        """Keep how the episodes that `ended` went, of the environments `where`."""
        running = self.running_return[where]
        running += reward
        if not ended.any():
            return
        final = info["final_info"]
        for i in np.flatnonzero(ended):
            happened = [float(final[event][i] >= 0) for event in self.events]
            self.recent.append([running[i], float(final["time"][i]), *happened])
        running[ended] = 0.0

    def summary(self) -> dict[str, float]:
        """Means over the recent episodes: return, length in steps, share with each event."""
        if not self.recent:
            return {}
        means = np.mean(self.recent, axis=0)
        return dict(zip(("return", "length", *self.events), map(float, means), strict=True))

    def tensors(self) -> dict[str, Tensor]:
        """All of it, as tensors."""
        normaliser = self.normaliser
        moments = [normaliser.mean, normaliser.variance, normaliser.count]
        width = 2 + len(self.events)
        return {
            "states": torch.cat([torch.from_numpy(env.states.view(np.uint8)) for env in self.envs]),
            "generator": self.generator.get_state(),
            "moments": torch.tensor(moments, dtype=torch.float64),
            "normaliser_returns": torch.from_numpy(normaliser.returns.copy()),
            "running_return": torch.from_numpy(self.running_return.copy()),
            "recent": torch.tensor(list(self.recent), dtype=torch.float64).view(-1, width),
        }

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Go on from what `tensors` returned."""
        states = tensors["states"].numpy().view(self.game.state).reshape(-1)
        for env, group in zip(self.envs, self.groups, strict=True):
            self.images[group] = torch.from_numpy(env.set_state(states[group]))
        self.generator.set_state(tensors["generator"])
        normaliser = self.normaliser
        normaliser.mean, normaliser.variance, normaliser.count = tensors["moments"].tolist()
        normaliser.returns = tensors["normaliser_returns"].numpy().copy()
        self.running_return = tensors["running_return"].numpy().copy()
        self.recent = deque(tensors["recent"].tolist(), maxlen=RECENT)
