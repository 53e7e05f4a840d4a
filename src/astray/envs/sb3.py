"""Adapter of astray's environments to the vector interface of Stable-Baselines3."""

from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode

from astray import imports

with imports.extra("sb3", "astray.envs.sb3 needs stable_baselines3"):
    from stable_baselines3.common.vec_env import VecEnv

from astray.envs.vector import GameVectorEnv


class GameVecEnv(VecEnv):
    """A vector environment for Stable-Baselines3, with arrays [N, ...] of N environments.

    At the end of an episode `infos` has the last observation and whether the time limit alone
    ended the episode. PPO then adds the critic's value of that observation.

    Examples:
        >>> env = GameVecEnv(GameVectorEnv("maze", "corner", 8, autoreset_mode="SameStep"))
        >>> model = stable_baselines3.PPO("CnnPolicy", env)

    Args:
        env: Environment that resets in the same step, also one from `gymnasium.make_vec`.

    Raises:
        ValueError: If it has another autoreset mode.
    """

    def __init__(self, env: GameVectorEnv):
        mode = env.metadata["autoreset_mode"]
        if mode != AutoresetMode.SAME_STEP:
            raise ValueError(f"autoreset_mode is {mode}; Stable-Baselines3 needs SAME_STEP")
        self.env = env
        self._actions = np.zeros(env.num_envs, np.int64)
        super().__init__(env.num_envs, env.single_observation_space, env.single_action_space)

    def reset(self) -> np.ndarray:
        if any(self._options):
            raise ValueError(f"options are {self._options}; there are none here")
        # `VecEnv.seed` counts up from the first environment's seed, and so do ours.
        observations, _ = self.env.reset(seed=self._seeds[0])
        self._reset_seeds()
        return observations

    def step_async(self, actions: np.ndarray) -> None:
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        observations, reward, terminated, truncated, info = self.env.step(self._actions)
        done = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(done):
            infos[i]["terminal_observation"] = info["final_obs"][i]
            infos[i]["TimeLimit.truncated"] = bool(truncated[i] and not terminated[i])
        return observations, reward.astype(np.float32), done, infos

    def get_images(self) -> list[np.ndarray]:
        return [*(self.env.render() or ())]

    def close(self) -> None:
        self.env.close()

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        return [getattr(self.env, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        raise NotImplementedError("the environments of a batch have no attributes of their own")

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        raise NotImplementedError("the environments of a batch have no methods of their own")

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper], indices: Any = None
    ) -> list[bool]:
        return [False for _ in self._get_indices(indices)]
