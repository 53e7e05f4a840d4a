"""Gymnasium environments in one process, stepped one after another."""

from collections.abc import Callable, Sequence
from copy import deepcopy
from typing import Any

import gymnasium
import numpy as np
from gymnasium.spaces import Box
from gymnasium.vector import VectorEnv
from gymnasium.vector.utils import batch_space, concatenate, create_empty_array, iterate

from astray.envs.watch import Watch
from astray.validation import shown
from astray.world import Failed


class InTurn(VectorEnv):
    """Vector environment whose ended episodes wait, and of which environments can be left out.

    Gymnasium's SyncVectorEnv also gathers every info and copies observations twice, which takes
    longer than the step of a fast environment.

    Args:
        key: Key of info without which an info is not returned.
        watch: Watch that ends a call in which an environment never answers.

    Raises:
        ValueError: If the environments have different spaces.
    """

    def __init__(self, makers: Sequence[Callable[[], gymnasium.Env]], key: str, watch: Watch):
        self._envs, self._key, self._watch = [make() for make in makers], key, watch
        first, *others = [(env.observation_space, env.action_space) for env in self._envs]
        for other in others:
            if other != first:
                raise Failed(
                    f"environments of a variant must have equal spaces; got {first} and {other}"
                )
        # A copy, as an environment may draw from its own.
        self.single_observation_space, self.single_action_space = deepcopy(first)
        self._observations: list[Any] = [None] * len(self._envs)
        self._resize()

    def reset(self, *, seed: Any = None, options: Any = None) -> tuple[Any, dict[str, Any]]:
        """Reset the environments of the option "reset_mask" [N] with their seeds [N]."""
        infos: dict[str, Any] = {}
        with self._watch:
            for i in np.flatnonzero(options["reset_mask"]).tolist():
                self._watch.turn += 1
                seen, info = self._envs[i].reset(seed=seed[i], options={})
                self._observations[i] = _copied(seen)
                infos = self._add_info(infos, info, i)
        return self._shown(), infos

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step N environments; return arrays [N, ...], and those infos that have the key."""
        rewards, terminated, truncated, infos = [], [], [], {}
        each = zip(self._envs, iterate(self.action_space, actions), strict=True)
        observations, watch, key = self._observations, self._watch, self._key
        with watch:
            for i, (env, action) in enumerate(each):
                watch.turn += 1
                seen, reward, ended, cut, info = env.step(action)
                observations[i] = _copied(seen)
                rewards.append(reward)
                terminated.append(ended)
                truncated.append(cut)
                if key in info:
                    infos = self._add_info(infos, info, i)
        ends = np.array(terminated, bool), np.array(truncated, bool)
        return self._shown(), np.array(rewards, np.float64), *ends, infos

    def keep(self, kept: np.ndarray) -> None:
        """Close all environments but `kept` [n], which become environments 0 to n - 1."""
        for i in {*range(self.num_envs)} - {*kept.tolist()}:
            self._envs[i].close()
        self._envs = [self._envs[i] for i in kept]
        self._observations = [self._observations[i] for i in kept]
        self._resize()

    def call(self, name: str, *given: Any) -> tuple[Any, ...]:
        """Return what a method of each environment returns."""
        told = []
        with self._watch:
            for env in self._envs:
                self._watch.turn += 1
                told.append(getattr(env, name)(*given))
        return tuple(told)

    def get_attr(self, name: str) -> tuple[Any, ...]:
        """Return an attribute of each environment."""
        return tuple(getattr(env, name) for env in self._envs)

    def close_extras(self, **_: Any) -> None:
        """Close the environments."""
        try:
            with self._watch:
                for env in self._envs:
                    self._watch.turn += 1
                    env.close()
        finally:
            self._watch.end()

    def _resize(self) -> None:
        self.num_envs = len(self._envs)
        self.observation_space = batch_space(self.single_observation_space, self.num_envs)
        self.action_space = batch_space(self.single_action_space, self.num_envs)

    def _shown(self) -> Any:
        space, n = self.single_observation_space, self.num_envs
        if isinstance(space, Box) and space.shape:  # a third of the time of `concatenate`
            together = np.empty((n * space.shape[0], *space.shape[1:]), space.dtype)
            return np.concatenate(self._observations, out=together).reshape(n, *space.shape)
        try:
            empty: Any = create_empty_array(space, n, np.empty)
            return concatenate(space, self._observations, empty)
        except (KeyError, TypeError, ValueError, IndexError) as error:  # of parts that are not so
            told = f"an observation is not of its space {space}"
            raise Failed(f"{told}: {shown(error, 300)}") from error


def _copied(seen: Any) -> Any:
    """Return a copy, as several environments may show what they see in one array."""
    return seen.copy() if type(seen) is np.ndarray else deepcopy(seen)
