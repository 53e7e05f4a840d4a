"""The players of a training: environments of one variant, with the actors in them."""

import copy
import math
from collections import deque
from collections.abc import Callable, Mapping
from itertools import repeat
from typing import Any, NamedTuple

import numpy as np
import torch
from torch import Tensor

from astray.acting import LASTING, Answer, Turn
from astray.envs import restarting
from astray.envs.restarting import Restarting
from astray.envs.steps import Reward, paid
from astray.game import Variant
from astray.record import trusted
from astray.training import parallel
from astray.training.config import Config
from astray.training.environments import environments, whole_step
from astray.training.levels import Plan, Played, Sampler
from astray.training.ppo import RewardNormaliser
from astray.validation import finite, of_kind, shown
from astray.world import World, WorldVariant

LEVELS = "levels."  # prefix of a sampler's arrays in a checkpoint
RECENT = 100  # episodes in the logged means


class Stepped(NamedTuple):
    """Step `t` of the environments `where` [n], with its results.

    Attributes:
        cut: Steps and environments [2, n] of truncated episodes, and their last observations,
            which no action follows.
    """

    t: int
    where: slice
    reward: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray
    cut: tuple[np.ndarray, np.ndarray] | None


class Player:
    """Environments of one variant with their observations and recent episodes.

    They may form several groups, which are stepped in turn. A `sampler` may choose their levels;
    otherwise they draw from `levels`.
    """

    def __init__(
        self,
        config: Config,
        variant: Variant,
        levels: range,
        salt: int,
        groups: int,
        sampler: Sampler | None = None,
        reward: Reward | None = None,
    ):
        if (sampler is not None or isinstance(variant, WorldVariant)) and parallel.size() > 1:
            raise ValueError("with a sampler of levels, or a World, one process must train alone")
        self.sampler, self.learns, self._repeats, self._is_begun = sampler, True, False, False
        self._kinds: dict[str, Any] = {}  # of a sampler's arrays
        self._sampler_arrays()
        self._own_reward, self._levels = reward, levels
        self.here = parallel.shard(config.num_envs)  # this process's environments
        n = self.here.stop - self.here.start
        if n % groups:
            raise ValueError(f"{n} environments are not divided into {groups} groups")
        self.groups = [slice(k * n // groups, (k + 1) * n // groups) for k in range(groups)]
        self.envs: list[Any] = [
            environments(config, variant, group.stop - group.start, levels) for group in self.groups
        ]
        self.game, self.space = self.envs[0].game, self.envs[0].single_observation_space
        self.num_envs, self.actions = config.num_envs, int(self.envs[0].single_action_space.n)
        # Current observations; a GPU reads pinned memory while the processor continues.
        self.images = torch.empty(
            (n, *self.space.shape),
            dtype=torch.uint8 if self.space.dtype == np.uint8 else torch.float32,
            pin_memory=config.device == "cuda",
        )
        limit = getattr(variant, "time_limit", 0)  # which a World need not have
        self.limit = limit if limit <= LASTING else 0
        self.device, self.seed = config.device, config.seed * 16 + salt
        # Seeds far apart: environment i of a batch seeded with k is seeded with k + i.
        first = self.seed * 2**32 + self.here.start
        for env, group in zip(self.envs, self.groups, strict=True):
            self.images[group] = torch.from_numpy(env.reset(seed=first + group.start)[0])
        self.generator = torch.Generator(config.device).manual_seed(self.seed)
        self.normaliser = RewardNormaliser(config.num_envs, config.reward_gamma)
        self.running_return, self.begins = np.zeros(n), np.ones(n, bool)
        self.events = tuple(self.game.events)
        self.recent: deque[list[float]] = deque(maxlen=RECENT)  # return, length, events' happening
        self._ended: list[tuple[int, int, list[float]]] = []  # since `settle`: step, environment
        self._paid: list[tuple[int, int, np.ndarray]] = []  # the same of rewards
        self._reward: float | None = None  # mean reward per step in the last rollout

    def noise(self, steps: int) -> Tensor:
        """Return the uniform noise [T, N, actions] in [0, 1) that samples a rollout's actions.

        It covers all processes at once, so it depends neither on groups nor on processes.
        """
        shape = (steps, self.num_envs, self.actions)
        return torch.rand(shape, generator=self.generator, device=self.device)[:, self.here]

    def begin(self, group: int) -> Turn:
        """Return a group's turn; ended episodes have already been restarted."""
        where = self.groups[group]
        return Turn(self.envs[group], self.images[where], self.begins[where])

    def step(self, t: int, group: int, answer: Answer) -> Stepped:
        """Take step `t` in a group; raise ValueError if the sampler's levels are invalid."""
        env, where = self.envs[group], self.groups[group]
        shown_here = self.images[where].numpy()
        before = (env.get_state(), shown_here.copy()) if self._own_reward else None
        _, reward, terminated, truncated, info = taken = env.step(answer.actions, shown_here)
        self.begins[where] = ended = terminated | truncated
        if self._own_reward and before:
            reward = paid(self._own_reward, whole_step(env, before, answer, taken))
        if self.sampler is not None and not self._repeats and ended.any():
            self._begin(self.sampler, group, ended)
        cut = None
        if truncated.any():
            which = np.flatnonzero(truncated) + where.start
            cut = np.stack([np.full_like(which, t), which]), np.stack(info["final_obs"][truncated])
        step = Stepped(t, where, reward, terminated, truncated, cut)
        self._note(step, info)
        return step

    def _note(self, step: Stepped, info: dict[str, Any]) -> None:
        """Record the rewards of a step, and the episodes that ended with it."""
        running, first = self.running_return[step.where], self.here.start + step.where.start
        running += step.reward
        self._paid.append((step.t, first, step.reward.copy()))
        which = np.flatnonzero(step.terminated | step.truncated)
        if len(which):
            final = info["final_info"]
            told = [running, final["time"], *(final[event] >= 0 for event in self.events)]
            rows = np.stack([column[which] for column in told], 1).astype(float).tolist()
            self._ended += zip(repeat(step.t), (first + which).tolist(), rows)
            running[which] = 0.0

    def plan(self, steps: int) -> None:
        """Begin the sampler's next plan; raise ValueError if it or its levels are invalid."""
        if self.sampler is None:
            return
        plan = self.sampler.plan(steps)
        of_kind("what a sampler plans", plan, Plan)
        self.learns = plan.learn
        self._repeats = plan.repeat
        for env in self.envs:
            env.repeat(None)
        if plan.restart or plan.repeat or not self._is_begun:  # in levels that it did not choose
            self._restart()
        self._is_begun = True
        if plan.repeat:
            for env in self.envs:
                env.repeat(env.get_state())

    def scatter(self, random: np.random.Generator) -> None:
        """Begin new levels, with agents anywhere; raise ValueError if a sampler's are invalid."""
        self._restart()
        draws, places = random.random(self.num_envs)[self.here], self.game.places
        for env, where in zip(self.envs, self.groups, strict=True):
            states = env.get_state()
            free = [np.argwhere(places.stand(s)) for s in trusted(states)]
            chosen = zip(free, draws[where], strict=True)
            cells = np.array([some[int(u * len(some))][::-1] for some, u in chosen])  # x, y
            self.images[where] = torch.from_numpy(env.set_state(places.put(states, cells)))

    def _restart(self) -> None:
        """Begin new levels in all environments."""
        for group, where in enumerate(self.groups):
            every = np.ones(where.stop - where.start, bool)
            if self.sampler is None:
                images, _ = self.envs[group].reset(options={"reset_mask": every})
                self.images[where] = torch.from_numpy(images)
            else:
                self._begin(self.sampler, group, every)
        self.begins[:] = True
        self.running_return[:] = 0.0
        self.normaliser.returns[:] = 0.0

    def _begin(self, sampler: Sampler, group: int, which: np.ndarray) -> None:
        """Begin the sampler's levels in the environments `which` [n] of a group."""
        env, where = self.envs[group], self.groups[group]
        chosen = sampler.next(where.start + np.flatnonzero(which))
        if not isinstance(chosen, np.ndarray) or chosen.shape != (which.sum(),):
            raise ValueError(
                f"a sampler must return an array of {which.sum()} levels; got {shown(chosen)}"
            )
        option = "state" if chosen.dtype == self.game.state else "level"
        first, after = self._levels.start, self._levels.stop
        if chosen.dtype.kind in "iu" and ((chosen < first) | (chosen >= after)).any():
            told = f"{first} to {after - 1}, as others are for tests"
            raise ValueError(f"levels of a sampler must be from {told}; got {shown(chosen)}")
        begin = np.zeros(len(which), chosen.dtype)
        begin[which] = chosen
        images, _ = env.reset(options={option: begin, "reset_mask": which})
        self.images[where] = torch.from_numpy(images)
        self.begins[where] |= which

    def scored(self, played: Callable[[], Played]) -> None:
        """Report the rollout to the sampler, if there is one."""
        if self.sampler is not None:
            self.sampler.note(copy.deepcopy(played()))  # it may write to it

    def settle(self) -> None:
        """Add the rollout's ended episodes, of all processes, unless it only scored levels."""
        if not self.learns:
            self._ended, self._paid = [], []
            return
        paid = [row for rows in parallel.gathered(self._paid) for row in rows]
        # Sorted, so that means depend neither on groups nor on processes.
        ordered = [reward for *_, reward in sorted(paid, key=lambda row: row[:2])]
        self._paid, self._reward = [], float(np.concatenate(ordered).mean()) if paid else None
        ended = sorted(row for rows in parallel.gathered(self._ended) for row in rows)
        self.recent.extend(row for *_, row in ended)
        self._ended = []

    def summary(self, played: float = math.inf) -> dict[str, float]:
        """Return means over recent episodes and over the last rollout, which is reported once.

        Episodes have return, length in steps, and the fraction with each event. A rollout has
        reward_per_step, which exists without ended episodes too.

        Args:
            played: Steps of each environment so far. Episodes are not reported before the time
                limit: until then only short ones have ended.
        """
        told = {} if self._reward is None else {"reward_per_step": self._reward}
        self._reward = None
        if not self.recent or played < self.limit:
            return told
        means = np.mean(self.recent, axis=0)
        names = ("return", "length", *self.events)
        return dict(zip(names, map(float, means), strict=True)) | told

    def sampled(self) -> dict[str, float]:
        """Return the sampler's summary, or {}; raise ValueError if it is not as it must be."""
        if self.sampler is None:
            return {}
        self._sampler_arrays()
        told = self.sampler.summary()
        of_kind("a sampler's summary", told, Mapping)
        for name, value in told.items():
            finite(f"{name} of a sampler's summary", value)
        return {str(name): float(value) for name, value in told.items()}

    def reseeded(self, steps: int) -> Tensor:
        """Return a random state, [K] uint8, for after so many steps; K is of the device."""
        seed = int(np.random.SeedSequence((self.seed, steps)).generate_state(1)[0])
        return torch.Generator(self.device).manual_seed(seed).get_state()

    def _sampler_arrays(self) -> dict[str, np.ndarray]:
        """Return the sampler's state; empty without one."""
        if self.sampler is None:
            return {}
        arrays = self.sampler.arrays()
        of_kind("a sampler's arrays", arrays, Mapping)
        for name, array in arrays.items():
            if not isinstance(array, np.ndarray) or array.dtype.kind not in "biuf":
                raise ValueError(
                    f"{name} of a sampler must be an array of numbers; got {shown(array)}"
                )
        kinds = {name: (array.shape, array.dtype) for name, array in arrays.items()}
        if kinds != (self._kinds or kinds):  # no training could go on from a checkpoint
            told = f"got {shown(kinds)} after {shown(self._kinds)}"
            raise ValueError(f"arrays of a sampler must keep names, shapes and dtypes; {told}")
        self._kinds = kinds
        return dict(arrays)

    def tensors(self) -> dict[str, Tensor]:
        """Return its state as tensors; raise ValueError if a sampler's arrays are not numbers."""
        normaliser = self.normaliser
        moments = [normaliser.mean, normaliser.variance, normaliser.count]
        width = 2 + len(self.events)
        arrays = self._sampler_arrays()
        return {
            "generator": self.generator.get_state(),
            "moments": torch.tensor(moments, dtype=torch.float64),
            "normaliser_returns": torch.from_numpy(normaliser.returns.copy()),
            "running_return": torch.from_numpy(parallel.joined(self.running_return)),
            "recent": torch.tensor(list(self.recent), dtype=torch.float64).view(-1, width),
            **self._episodes(),
        } | {f"{LEVELS}{name}": torch.from_numpy(array.copy()) for name, array in arrays.items()}

    def _episodes(self) -> dict[str, Tensor]:
        """Return the state of the environments."""
        if isinstance(self.game, World):
            kept = restarting.joined(self.envs)
            kept["states"] = kept["states"].view(np.uint8)
            return {name: torch.from_numpy(array) for name, array in kept.items()}
        states = np.concatenate([env.states.view(np.uint8) for env in self.envs])
        return {"states": torch.from_numpy(parallel.joined(states))}

    def _resume(self, tensors: dict[str, Tensor]) -> None:
        """Continue the episodes of `_episodes`."""
        states = tensors["states"].numpy().view(self.game.state).reshape(-1)[self.here]
        for env, group in zip(self.envs, self.groups, strict=True):
            if isinstance(env, Restarting):
                turns, actions = (tensors[name].numpy() for name in ("turns", "actions"))
                before = int(states["time"][: group.start].sum())
                mine = slice(before, before + int(states["time"][group].sum()))
                shown_here = env.restore(states[group], turns[group], actions[mine])
            else:
                shown_here = env.set_state(states[group])
            self.images[group] = torch.from_numpy(shown_here)
        self.begins = np.concatenate([env.states["time"] == 0 for env in self.envs])

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Continue from the result of `tensors`."""
        self._is_begun = True
        self._resume(tensors)
        self.generator.set_state(tensors["generator"])
        normaliser = self.normaliser
        normaliser.mean, normaliser.variance, normaliser.count = tensors["moments"].tolist()
        normaliser.returns = tensors["normaliser_returns"].numpy().copy()
        self.running_return = tensors["running_return"].numpy()[self.here].copy()
        self.recent = deque(tensors["recent"].tolist(), maxlen=RECENT)
        if self.sampler is not None:
            names = [name for name in tensors if name.startswith(LEVELS)]
            self.sampler.restore({n.removeprefix(LEVELS): tensors[n].numpy() for n in names})
