"""Environments of a `World` to train in, as `GameVectorEnv` is for games."""

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium import Space, spaces
from gymnasium.vector.utils import batch_space, iterate

from astray.envs.worlds import WorldVectorEnv, check_repeats
from astray.validation import shown
from astray.world import World, WorldVariant

MOST_ACTIONS = 4096  # combinations of a MultiDiscrete space


def action_table(space: Space) -> np.ndarray:
    """Return the actions that numbers from 0 stand for: [A], or [A, k] of a MultiDiscrete space.

    Raises:
        ValueError: If the space is neither Discrete nor MultiDiscrete, or has too many actions.
    """
    if isinstance(space, spaces.Discrete):
        return space.start + np.arange(space.n)
    if not isinstance(space, spaces.MultiDiscrete) or space.nvec.ndim != 1:
        raise ValueError(f"actions must be Discrete or MultiDiscrete; got {space}")
    if (count := math.prod(map(int, space.nvec))) > MOST_ACTIONS:
        raise ValueError(f"actions may have {MOST_ACTIONS} combinations; got {count} of {space}")
    return np.argwhere(np.ones(space.nvec)) + space.start


def seen_space(space: Space, observation: str) -> spaces.Box:
    """Return the space of the observations that a network receives: see `as_seen`.

    Raises:
        ValueError: If such observations are not images, or of a space that cannot be flattened.
    """
    if observation != "image":
        try:
            return spaces.Box(-np.inf, np.inf, (spaces.flatdim(space),), np.float32)
        except NotImplementedError:  # of a space of somebody's, such as MiniGrid's missions
            raise ValueError(
                "observations must be of spaces that Gymnasium can flatten, as those that its "
                f"FilterObservation leaves; got {shown(space)}"
            ) from None
    if not isinstance(space, spaces.Box) or len(space.shape) < 2:
        raise ValueError(
            f"an image must be a Box of at least two axes; got {shown(space)}; observation "
            "'symbolic' takes any as a vector"
        )
    kind: Any = np.uint8 if space.dtype == np.uint8 else np.float32
    return spaces.Box(0 if kind == np.uint8 else -np.inf, 255, space.shape, kind)


def as_seen(space: Space, observation: str, given: Any, trained: Space | None = None) -> np.ndarray:
    """Return observations [N, ...] in the form that a network receives.

    Args:
        observation: "image" leaves their axes: uint8, or float32. "symbolic" makes vectors [N, D]
            float32 of them, with integers scaled by their bounds, if they have any, to 0 to 1.
        trained: Space of the training, whose bounds these are; None for `space`.

    Raises:
        ValueError: If a number is not finite in 32 bits.
    """
    seen = seen_space(space, observation)
    if isinstance(space, spaces.Box):
        array = np.asarray(given)
    else:
        n = len(next(iter(given.values())) if isinstance(given, Mapping) else given)
        each: Any = iterate(batch_space(space, n), given)
        vectors: Any = [spaces.flatten(space, one) for one in each]
        array = np.stack(vectors)
    array = array.reshape(len(array), *seen.shape)
    if observation != "image" and (not isinstance(space, spaces.Box) or space.dtype.kind in "iu"):
        low, high = ends = _ends(trained or space)
        if ends.shape[1:] != seen.shape:  # it sees other parts, which is an error elsewhere
            low, high = _ends(space)
        array = (array - low) / np.maximum(high - low, 1)
    with np.errstate(over="ignore"):  # which is told
        array = array.astype(seen.dtype)
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        raise ValueError(f"a network sees finite numbers of 32 bits; got others of {shown(space)}")
    return array


def _ends(space: Space) -> np.ndarray:
    """Return what becomes 0 and 1 in a vector, [2, D]: bounds of integers, or 0 and 1."""
    if isinstance(space, spaces.Dict | spaces.Tuple):
        parts = space.values() if isinstance(space, spaces.Dict) else space
        return np.concatenate([_ends(part) for part in parts], 1)
    ends = np.array([[0.0], [1.0]]).repeat(spaces.flatdim(space), 1)
    if isinstance(space, spaces.Box) and space.dtype.kind in "iu":
        least, most = (limits := np.iinfo(space.dtype)).min, limits.max
        low, high = np.array([space.low.ravel(), space.high.ravel()], np.float64)
        # By limits of 32 bits, as of infinite bounds, all numbers would become the same.
        bounded = (limits.bits < 32) | ((high < most) & ((low > least) | (least == 0)))
        ends = np.where(bounded, (low, high), ends)
    return ends


class Restarting:
    """Environments that draw and begin a level when an episode ends, as in mode SameStep.

    Attributes:
        final_states: Records [N] of the episodes that ended before the current ones began.
        actions: `action_table` of the environments' own actions.
        single_action_space: Numbers of its rows.
        trained: As in `as_seen`; that of another variant is set before the first reset.
    """

    def __init__(
        self, world: World, variant: WorldVariant, num_envs: int, levels: range, observation: str
    ):
        """Make the environments; check that levels repeat if the world says that all do."""
        if world.repeats:
            few = levels[0], levels[len(levels) // 2], levels[-1]
            check_repeats(world, variant, few, num_envs)
        self._env = WorldVectorEnv(world, variant, num_envs)
        self._levels, self._observation = levels, observation
        self.trained: Space = self._env.single_observation_space
        try:
            self.actions = action_table(self._env.single_action_space)
            self.single_observation_space = seen_space(
                self._env.single_observation_space, observation
            )
        except ValueError as error:
            raise ValueError(f"{variant} cannot be trained on: {error}") from error
        self.game, self.single_action_space = world, spaces.Discrete(len(self.actions))
        self._taken: list[list[int]] = [[] for _ in range(num_envs)]  # actions of each episode

    @property
    def states(self) -> np.ndarray:
        return self._env.states

    def reset(self, *, seed: int) -> tuple[np.ndarray, dict[str, Any]]:
        """Begin the first levels, environment i from seed + i; return observations [N, ...]."""
        self._seeds = [seed + i for i in range(self._env.num_envs)]
        self._turns = np.zeros(self._env.num_envs, np.int64)
        return self._seen(self._begin(np.ones(self._env.num_envs, bool))), {}

    def step(
        self, actions: np.ndarray, out: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Take `actions` [N], write observations to `out` [N, ...], and return arrays [N, ...]."""
        for taken, action in zip(self._taken, actions.tolist(), strict=True):
            taken.append(action)
        seen, reward, terminated, truncated, _ = self._env.step(self.actions[actions])
        ended, info = terminated | truncated, {}
        if ended.any():
            self.final_states = states = self._env.get_state()
            final = {name: states[name] for name in ("time", *self.game.events)}
            info = {"final_obs": self._seen(seen), "final_info": final}
            seen = self._begin(ended)
        out[:] = self._seen(seen)
        return out, reward, terminated, truncated, info

    def get_state(self) -> np.ndarray:
        """Return a copy of the records [N] of the current episodes."""
        return self._env.get_state()

    def kept(self) -> dict[str, np.ndarray]:
        """Return states [N], turns [N] and actions [steps] from which `restore` continues."""
        taken = [np.array(actions, np.int64) for actions in self._taken]
        return {"states": self._env.get_state(), "turns": self._turns.copy()} | {
            "actions": np.concatenate(taken)
        }

    def restore(self, states: np.ndarray, turns: np.ndarray, actions: np.ndarray) -> np.ndarray:
        """Replay episodes: states [N], turns [N], actions [steps] -> their observations [N, ...].

        If levels do not repeat, the episodes begin anew, and a warning says so.

        Raises:
            ValueError: If an episode differs from before.
        """
        self._turns = turns.copy()
        lengths = states["time"].astype(int)
        self._taken = [part.tolist() for part in np.split(actions, np.cumsum(lengths)[:-1])]
        if not self.game.repeats:
            again = ", in the first levels of their streams" if self.game.level_key else ""
            warnings.warn(
                f"levels of {self._env.variant} do not repeat: the episodes begin anew{again}, so "
                "the training is another than one that was not stopped",
                stacklevel=2,
            )
            self._taken, lengths = [[] for _ in lengths], np.zeros_like(lengths)
        begin = {"level": states["level"], "reset_mask": np.ones(len(states), bool)}
        seen, _ = self._env.reset(options=begin)
        # All are stepped together: the shorter ones wait in their first steps until it is time.
        wait = max(lengths) - lengths
        for t in range(max(lengths)):
            played = zip(self._taken, wait, strict=True)
            now = [part[t - since] if t >= since else 0 for part, since in played]
            seen, *_ = self._env.step(self.actions[now])
            if (waiting := t < wait).any():
                seen, _ = self._env.reset(options=begin | {"reset_mask": waiting})
        if self.game.repeats and self._env.get_state().tobytes() != states.tobytes():
            raise ValueError(
                f"episodes of {self._env.variant} are others when they are played again with the "
                "same actions; World(repeats=False) begins them anew"
            )
        return self._seen(seen)

    def close(self) -> None:
        self._env.close()

    def _begin(self, which: np.ndarray) -> Any:
        """Begin the next levels in the environments `which` [N]; return what all show."""
        levels = self._env.states["level"].astype(np.int64)
        for i in np.flatnonzero(which):
            drawn = np.random.SeedSequence((self._seeds[i], int(self._turns[i])))
            number = int(drawn.generate_state(1, np.uint64)[0]) % len(self._levels)
            levels[i], self._taken[i] = self._levels[number], []
        self._turns += which
        return self._env.reset(options={"level": levels, "reset_mask": which})[0]

    def _seen(self, shown_here: Any) -> np.ndarray:
        space = self._env.single_observation_space
        return as_seen(space, self._observation, shown_here, self.trained)


def joined(envs: Sequence[Restarting]) -> dict[str, np.ndarray]:
    """Concatenate `kept` of several environments, as if all N were in one: arrays [N, ...]."""
    kept = [env.kept() for env in envs]
    return {name: np.concatenate([one[name] for one in kept]) for name in kept[0]}
