"""Checkpoints of CleanRL's PPO as policies.

    policy = from_cleanrl("ppo.cleanrl_model", Box(-inf, inf, (4,)), game=WORLD)

A checkpoint is the `state_dict` of a script's agent, with a body `network`, an `actor` and a
`critic`: `ppo.py` has vectors and no body, `ppo_atari.py` three convolutions of four grey images,
`ppo_procgen.py` IMPALA's. Nothing in a file is run.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from gymnasium.spaces import Box
from torch import Tensor, nn

from astray.agents.importers import pth
from astray.agents.importers.files import LARGEST
from astray.agents.importers.imported import build
from astray.analysis.trained import Network
from astray.files import read
from astray.game import Game
from astray.validation import brief, of_kind, path_of, shown
from astray.world import World

STRIDES = (4, 2, 1)  # of the convolutions for Atari, Mnih et al. (2015)


class Agent(nn.Module):
    """The layers of `ppo.py` or `ppo_atari.py` under their names there, as wide as the weights."""

    def __init__(self, weights: Mapping[str, Tensor]):
        super().__init__()
        self.sees_images = "network.0.weight" in weights
        self.network = nn.Sequential()
        if self.sees_images:
            for k, stride in enumerate(STRIDES):
                after, before, side, _ = weights[f"network.{2 * k}.weight"].shape
                self.network.extend([nn.Conv2d(before, after, side, stride), nn.ReLU()])
            self.network.extend([nn.Flatten(), _dense(weights, "network.7"), nn.ReLU()])
            self.actor, self.critic = _dense(weights, "actor"), _dense(weights, "critic")
        else:
            self.actor, self.critic = (_tanh(weights, name) for name in ("actor", "critic"))

    def forward(self, seen: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits [N, A] and values [N, 1] of observations [N, ...]."""
        hidden = self.network(seen / 255.0) if self.sees_images else seen.float().flatten(1)
        return self.actor(hidden), self.critic(hidden)


def _dense(weights: Mapping[str, Tensor], name: str) -> nn.Linear:
    after, before = weights[f"{name}.weight"].shape
    return nn.Linear(before, after)


def _tanh(weights: Mapping[str, Tensor], name: str) -> nn.Sequential:
    one, two, three = (_dense(weights, f"{name}.{k}") for k in (0, 2, 4))
    return nn.Sequential(one, nn.Tanh(), two, nn.Tanh(), three)


def from_cleanrl(
    path: str | Path,
    space: Box,
    *,
    game: str | Game | World = "",
    name: str = "cleanrl",
    mode: Literal["sampled", "greedy"] = "sampled",
    seed: int = 0,
) -> Network:
    """Make a policy of a .cleanrl_model file: the state_dict of a PPO script of CleanRL.

    Args:
        space: Space of one observation, as the agent saw it in its training.
        mode: "sampled" draws actions from the policy, "greedy" takes the most likely.

    Raises:
        ValueError: If the file is damaged, holds more than weights, or weights of another network,
            or if its network does not see such observations.
    """
    data = read(path_of("path", path), LARGEST)
    try:
        weights = pth.weights(data)
        if "network.0.conv.weight" in weights:
            network: nn.Module = pth.read(data).network
        else:
            network = _filled(weights)
        _check_sees(network, space)
    except ValueError as error:
        raise ValueError(f"{path} is refused: {brief(error)}") from error
    return Network(network, space, game, name=name, mode=mode, seed=seed)


def _check_sees(network: nn.Module, space: Box) -> None:
    """Raise ValueError unless the network sees observations of `space`."""
    of_kind("space", space, Box)
    is_byte = (space.low == 0).all() and (space.high == 255).all()
    if getattr(network, "sees_images", True) and not is_byte:
        raise ValueError(f"it sees images of 0 to 255, and divides by 255; got {shown(space)}")
    try:
        with torch.no_grad():
            network(torch.from_numpy(np.zeros((1, *space.shape), space.dtype)))
    except (RuntimeError, TypeError, IndexError) as error:
        raise ValueError(f"it does not see {shown(space)}: {brief(error)}") from error


def _filled(weights: Mapping[str, Tensor]) -> Agent:
    """Return the network with these weights; raise ValueError if they are of another one."""
    try:
        return build(lambda: Agent(weights), weights)
    except (KeyError, ValueError) as error:
        there = ", ".join(list(weights)[:4])
        raise ValueError(
            f"it is not an agent of CleanRL's ppo.py, ppo_atari.py or ppo_procgen.py: {error}; its "
            f"weights are {there}, ..."
        ) from error
