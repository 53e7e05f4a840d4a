"""A single environment, which is a vector environment of size one."""

from __future__ import annotations

import copy
from typing import Any

import gymnasium
import numpy as np

from astray.envs.infos import Info
from astray.envs.vector import GameVectorEnv
from astray.game import Game, Variant


class GameEnv(gymnasium.Env[np.ndarray, np.int64]):
    """One environment of a game, with the arguments of `GameVectorEnv`.

    Examples:
        >>> env = astray.GameEnv("maze", "corner")
        >>> image, info = env.reset(seed=0)
        >>> image.shape
        (64, 64, 3)
    """

    metadata = {"render_modes": ["rgb_array"], "render_fps": 15}  # noqa: RUF012

    def __init__(self, game: str | Game, variant: str | Variant, **options: Any):
        self.vector = GameVectorEnv(game, variant, 1, autoreset_mode="Disabled", **options)
        self.observation_space = self.vector.single_observation_space
        self.action_space = self.vector.single_action_space
        self.render_mode = self.vector.render_mode

    def __copy__(self) -> GameEnv:
        return copy.deepcopy(self)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, Info]:
        observations, info = self.vector.reset(seed=seed, options=options)
        super().reset(seed=None if seed is None else int(seed))  # which takes no NumPy integer
        return observations[0], _scalars(info)

    def step(self, action: np.int64) -> tuple[np.ndarray, float, bool, bool, Info]:
        observations, reward, terminated, truncated, info = self.vector.step(np.array([action]))
        ends = bool(terminated[0]), bool(truncated[0])
        return observations[0], float(reward[0]), *ends, _scalars(info)

    def render(self) -> np.ndarray | None:
        frames = self.vector.render()
        return frames[0] if frames else None

    def close(self) -> None:
        self.vector.close()


def _scalars(info: Info) -> Info:
    return {name: column[0].item() for name, column in info.items() if not name.startswith("_")}
