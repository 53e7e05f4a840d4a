"""All that lives while an agent is trained, and that a checkpoint must hold."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np
import torch
from torch import Tensor

from astray.agents.policy import Architecture
from astray.agents.ppo import RewardNormaliser
from astray.envs.vector import GameVectorEnv
from astray.game import Variant
from astray.training.config import Config
from astray.training.device import Model

RECENT = 100  # ended episodes that the logged means are over


class Player:
    """Environments of one variant, what they show now, and how their last episodes went."""

    def __init__(self, config: Config, variant: Variant, levels: range, salt: int):
        self.env = GameVectorEnv(
            config.game, variant, config.environments,
            observation=config.observation, levels=levels, autoreset_mode="SameStep",
            threads=config.threads,
        )  # fmt: skip
        # Seeds far apart: environment i of a batch seeded with k is seeded with k + i.
        self.observation, _ = self.env.reset(seed=(config.seed * 16 + salt) * 2**32)
        self.generator = torch.Generator(config.device).manual_seed(config.seed * 16 + salt)
        self.normaliser = RewardNormaliser(config.environments, config.reward_gamma)
        self.running_return = np.zeros(config.environments)
        self.events = self.env.game.events
        self.recent: deque[list[float]] = deque(maxlen=RECENT)  # return, length, events' happening

    def note(self, reward: np.ndarray, ended: np.ndarray, info: dict[str, Any]) -> None:
        """Keep how the episodes that `ended` [N] went."""
        self.running_return += reward
        if not ended.any():
            return
        final = info["final_info"]
        for i in np.flatnonzero(ended):
            happened = [float(final[event][i] >= 0) for event in self.events]
            self.recent.append([self.running_return[i], float(final["time"][i]), *happened])
        self.running_return[ended] = 0.0

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
            "states": torch.from_numpy(self.env.states.view(np.uint8).copy()),
            "generator": self.generator.get_state(),
            "moments": torch.tensor(moments, dtype=torch.float64),
            "normaliser_returns": torch.from_numpy(normaliser.returns.copy()),
            "running_return": torch.from_numpy(self.running_return.copy()),
            "recent": torch.tensor(list(self.recent), dtype=torch.float64).view(-1, width),
        }

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Go on from what `tensors` returned."""
        states = tensors["states"].numpy().view(self.env.game.state).reshape(-1)
        self.observation = self.env.set_state(states)
        self.generator.set_state(tensors["generator"])
        normaliser = self.normaliser
        normaliser.mean, normaliser.variance, normaliser.count = tensors["moments"].tolist()
        normaliser.returns = tensors["normaliser_returns"].numpy().copy()
        self.running_return = tensors["running_return"].numpy().copy()
        self.recent = deque(tensors["recent"].tolist(), maxlen=RECENT)


class Trainer:
    """The network, its optimizer, and the players of the training and validation variants."""

    def __init__(self, config: Config):
        self.config = config
        self.steps = 0  # environment steps done
        self.player = Player(config, config.training_variant(), config.training_levels, salt=1)
        self.validation: Player | None = None
        if config.validation:
            variant = config.validation_variant()
            self.validation = Player(config, variant, config.unseen_levels, salt=2)
        game, space = self.player.env.game, self.player.env.single_observation_space
        largest = ()
        if config.observation == "symbolic":
            largest = tuple(int(k) for k in game.planes(config.training_variant()).max((1, 2)))
        self.architecture = Architecture(
            config.network, space.shape, largest, len(game.actions),  # pyright: ignore
            config.scale, config.width,
        )  # fmt: skip
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(config.seed)
            self.network = self.architecture.build().to(config.device)
        self.model = Model(self.network, config)
        self.optimizer = torch.optim.Adam(
            self.network.parameters(), config.learning_rate, eps=1e-5, fused=True
        )

    @property
    def iteration(self) -> int:
        return self.steps // self.config.batch

    def players(self) -> dict[str, Player]:
        both = {"training": self.player, "validation": self.validation}
        return {name: player for name, player in both.items() if player is not None}

    def tensors(self) -> dict[str, Tensor]:
        """All that the training needs to go on as if it had not stopped, but the weights."""
        result = {"steps": torch.tensor([self.steps])}
        for name, player in self.players().items():
            result |= {f"{name}.{key}": value for key, value in player.tensors().items()}
        for k, moments in self.optimizer.state_dict()["state"].items():
            result |= {f"adam.{k}.{key}": value.cpu() for key, value in moments.items()}
        return result

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Go on from what `tensors` returned; the weights are loaded apart."""
        self.steps = int(tensors["steps"])
        for name, player in self.players().items():
            player.restore(_below(tensors, f"{name}."))
        adam = self.optimizer.state_dict()
        count = len(adam["param_groups"][0]["params"])
        adam["state"] = {k: _below(tensors, f"adam.{k}.") for k in range(count)}
        self.optimizer.load_state_dict(adam)

    def close(self) -> None:
        for player in self.players().values():
            player.env.close()


def _below(tensors: dict[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {k.removeprefix(prefix): v for k, v in tensors.items() if k.startswith(prefix)}
