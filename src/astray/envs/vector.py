"""The games as Gymnasium vector environments."""

from __future__ import annotations

import contextlib
import copy
import functools
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space

from astray import games
from astray.envs.compiled import FLAGS, NO_RESULTS, NUMBERS, compiled_loop
from astray.envs.infos import Columns, Info, merged, objects
from astray.envs.loops import AS_SET, DISABLED, NEXT_LEVEL, NEXT_STEP, NOTHING, SAME_STEP, STEP
from astray.envs.pictures import picture
from astray.envs.pool import Pool, most_threads
from astray.game import OWN, Game, Variant
from astray.level import Level
from astray.memory import check_memory
from astray.record import LEVELS, level_numbers, trusted
from astray.validation import MOST, bounded, integers, of_kind, one_of, shown

IMAGE = 64  # pixels a side of what the agent sees
COPIES = 6  # of an observation: four in the batch's space, the last one, the one at an end
PICTURE = 512  # pixels a side of what people see
MODES = {
    AutoresetMode.NEXT_STEP: NEXT_STEP,
    AutoresetMode.SAME_STEP: SAME_STEP,
    AutoresetMode.DISABLED: DISABLED,
}
MOST_SEED = 2**63 - 1
OPTIONS = ("level", "state", "reset_mask")  # of a reset
Observation = Literal["image", "symbolic"]


def space_of(game: Game, variant: Variant, observation: Observation) -> spaces.Box:
    """Return the space of the observations in a variant."""
    one_of("observation", observation, Observation)
    if observation == "image":
        return spaces.Box(0, 255, (IMAGE, IMAGE, 3), np.uint8)
    largest = game.symbols.planes(variant)
    return spaces.Box(np.zeros_like(largest), largest, dtype=np.uint8)


def quickest(game: Game) -> Observation:
    """Return the kind of observations that takes the least time to make."""
    return "symbolic" if game.symbols else "image"


class GameVectorEnv(VectorEnv[np.ndarray, np.ndarray, np.ndarray]):
    """`num_envs` environments of one game, stepped together.

    Observations are fresh arrays. `info` has the level's number at the beginning of each episode,
    and every event at its end: the step at which it first happened, or -1. `states` holds the
    record of each environment, live and read-only. `get_state` copies these records, and
    `set_state` checks edited ones.

    Examples:
        >>> env = astray.GameVectorEnv("maze", "corner", num_envs=4, levels=range(1000))
        >>> images, info = env.reset(seed=0)
        >>> images, reward, terminated, truncated, info = env.step(env.action_space.sample())
        >>> images.shape, reward.dtype
        ((4, 64, 64, 3), dtype('float64'))

    Args:
        game: Name of a game, or a `Game`.
        variant: Name of a variant, or a `Variant`.
        observation: "image" for [64, 64, 3] uint8, "symbolic" for planes [C, H, W] uint8.
        art: Art of the images: "own", or another of the game's `looks`. "original" equals the
            original's pictures to the pixel.
        levels: Range of numbers to draw from with replacement, or list to walk cyclically:
            environment i takes every num_envs-th from the i-th on.
        autoreset_mode: Gymnasium's AutoresetMode: when a new episode begins after an end.
        threads: Threads that share the batch; results do not depend on it.

    Raises:
        ValueError: If there is no such game, variant or art, or an argument is out of its bounds.
        MemoryError: If so many environments do not fit.
    """

    def __init__(
        self,
        game: str | Game,
        variant: str | Variant,
        num_envs: int = 1,
        *,
        observation: Observation = "image",
        art: str = OWN,
        levels: range | Sequence[int] | np.ndarray = LEVELS,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        threads: int = 1,
        render_mode: str | None = None,
    ):
        self.game = games.find(game)
        self.variant = self.game.variant(variant)
        bounded("num_envs", num_envs, 1, MOST)
        bounded("threads", threads, 1, most_threads())
        if render_mode is not None:
            one_of("render_mode", render_mode, Literal["rgb_array"])
        self.num_envs, self.render_mode, self.observation = num_envs, render_mode, observation
        self.symbolic = observation == "symbolic"
        self.art, looks = art, self.game.drawn(art)
        if not isinstance(autoreset_mode, AutoresetMode):
            one_of("autoreset_mode", autoreset_mode, [mode.value for mode in AutoresetMode])
        mode = AutoresetMode(autoreset_mode)
        self._mode = MODES[mode]
        self.autoreset_mode = mode  # as Gymnasium's own have it; others look for it here
        self.metadata = {"render_modes": ["rgb_array"], "autoreset_mode": mode, "render_fps": 15}

        self.single_observation_space = space_of(self.game, self.variant, observation)
        if self.symbolic:
            scene = self.game.symbols.planes_scene_shape(self.variant)
        else:
            scene = looks.scene_shape(self.variant, IMAGE)
        numbers = math.prod(self.single_observation_space.shape)
        each = COPIES * numbers + math.prod(scene) + 2 * self.game.state.itemsize
        check_memory(int(num_envs) * each, f"{num_envs:,} environments")
        self.single_action_space = spaces.Discrete(len(self.game.actions))
        self.action_space = batch_space(self.single_action_space, num_envs)
        self._shape = (num_envs, *self.single_observation_space.shape)

        self._threads = threads
        # No recarray: with these numba's calls are slow.
        self._states = np.zeros(num_envs, self.game.state)
        kept = num_envs if self._mode == SAME_STEP else 0  # ends that a new beginning overwrites
        self._final_states = np.empty(kept, self.game.state)
        self._final = np.empty((kept, *self._shape[1:]), np.uint8)
        self._steps = np.full(num_envs, STEP)
        self._seeded = False
        self._first, self._count, self._list = _checked(levels)
        self._scenes = np.zeros((num_envs, *scene), np.uint8)
        self._begins = np.empty(0, self.game.state)  # of `repeat`
        self._bind()

    def _bind(self) -> None:
        """Create the parts that are not saved: pictures, compiled code, threads and array views."""
        looks = self.game.drawn(self._shown)
        art = looks.pictures(self.variant, 1 if self.symbolic else IMAGE)
        self._loop = compiled_loop(self.game, self._shown)
        self._looks = art, self.symbolic, self._scenes
        self._source = self.variant.records(), self._list, self._first, self._count, self._begins
        over = self._final_states if self._mode == SAME_STEP else self._states
        self._begun = Columns(self._states, ("level", "shifted"))
        self._events = Columns(over, ("level", "shifted", "time", *self.game.events))
        self._pool = Pool(self._threads)

    def __getstate__(self) -> dict[str, Any]:
        made = ("_begun", "_events", "_pool", "_loop", "_looks", "_source")
        state = {name: x for name, x in vars(self).items() if name not in made}
        with contextlib.suppress(ValueError):  # a game that was never registered
            if games.find(self.game.name) is self.game:
                state["game"] = self.game.name
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state, game=games.find(state["game"]))
        self._bind()

    def __copy__(self) -> GameVectorEnv:
        """Return an independent environment; shared states would be stepped by both."""
        return copy.deepcopy(self)

    @functools.cached_property  # to make it takes longer than all else, and few look at it
    def observation_space(self) -> spaces.Space[np.ndarray]:  # pyrefly: ignore
        return batch_space(self.single_observation_space, self.num_envs)

    @property
    def _shown(self) -> str:
        """Return the art that is needed; symbols need none."""
        return OWN if self.symbolic else self.art

    @property
    def states(self) -> np.recarray:
        """The record of each environment, [N], live and read-only; see `set_state`."""
        return trusted(self._states)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[np.ndarray, Info]:
        """Begin new episodes; return observations [N, ...] and infos.

        Environment i of a batch with seed k draws levels like seed k + i.

        Args:
            options: "level" is the number or `Level` to begin, or one number for each environment.
                "state" is a state to begin in, or one for each; the levels after it stay the same.
                "reset_mask" [N] bool selects the environments to reset; the others continue.

        Raises:
            ValueError: If an option is unknown or invalid.
        """
        if seed is not None:
            bounded("seed", seed, 0, MOST_SEED)
            seed = int(seed)
        if options is not None:
            of_kind("options", options, Mapping)
        super().reset(seed=seed)
        options = options or {}
        for name in options:
            one_of("option", name, OPTIONS)
        which = np.array(options.get("reset_mask", np.ones(self.num_envs, bool)))
        if which.shape != (self.num_envs,) or which.dtype != bool:
            raise ValueError(f"reset_mask must be {self.num_envs} booleans; got {which}")
        if not self._seeded and not which.all():
            raise ValueError(
                "the first reset is of all environments; got a reset_mask that leaves some out"
            )
        chosen = np.full(self.num_envs, NEXT_LEVEL)
        level, state = options.get("level"), options.get("state")
        if level is not None and state is not None:
            raise ValueError("what to begin is given by a level or by a state, not both")
        if isinstance(level, Level):
            level, state = None, level.state(solvable=False)
        if state is not None:
            self._take(state, which, keep=("seed", "turn"))
            chosen[:] = AS_SET
        elif level is not None:
            if np.shape(numbers := integers(level, "levels")) not in ((), (1,), (self.num_envs,)):
                raise ValueError(f"give {self.num_envs} levels, or one; got {shown(level)}")
            numbers = np.full(self.num_envs, numbers)  # as given: 2^63 as well
            chosen[which] = level_numbers(numbers[which]) if which.any() else NOTHING
        if seed is None and not self._seeded:
            seed = int(self.np_random.integers(2**62))
        if seed is not None:
            seeds = np.arange(self.num_envs, dtype=np.uint64) + np.uint64(seed)
            self._states["seed"][which] = seeds[which]
            self._states["turn"][which] = 0
            self._seeded = True
        return self._do(np.where(which, chosen, NOTHING)), self._begun(which)

    def step(
        self, actions: np.ndarray, out: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, Info]:
        """Advance every environment by one step.

        Args:
            actions: [N] integers.
            out: Contiguous array [N, ...] uint8 for the observations; None for a fresh one.

        Returns:
            Observations [N, ...] uint8, reward [N] float64 in game points, terminated [N] bool,
            truncated [N] bool, and info.

        Raises:
            ValueError: If `actions` are invalid.
            RuntimeError: Before the first reset, or after an end without autoreset.
        """
        if not self._seeded:
            raise RuntimeError("the environment must be reset before it is stepped")
        same_step = self._mode == SAME_STEP
        before = FLAGS if same_step else self._states["ended"].copy()
        if self._mode == DISABLED and before.any():
            raise RuntimeError("an episode has ended; reset(options={'reset_mask': ...}) first")
        if out is None:
            out = np.empty(self._shape, np.uint8)
        elif (
            not isinstance(out, np.ndarray)
            or out.shape != self._shape
            or out.dtype != np.uint8
            or not out.flags.carray
        ):
            kind, shape = getattr(out, "dtype", type(out)), np.shape(out)
            raise ValueError(
                f"out must be an array {self._shape} of uint8, contiguous and writable; got {kind} "
                f"of {shape}"
            )
        n, largest = self.num_envs, len(self.game.actions) - 1
        actions = np.ascontiguousarray(integers(actions, "actions"), np.int64)
        if not actions.flags.behaved:  # for read-only arrays all would be compiled once more
            actions = actions.copy()
        reward, terminated, truncated = np.empty(n), np.empty(n, bool), np.empty(n, bool)
        results = reward, terminated, truncated
        if actions.shape != (n,) or not self._run(self._steps, out, actions, results):
            raise ValueError(
                f"actions must be {n} integers from 0 to {largest}; got {shown(actions)}"
            )

        info: Info = {}
        ended = terminated | truncated
        begun = ended if same_step else before
        if np.count_nonzero(begun):  # faster than `any`
            info = self._begun(begun)
        if np.count_nonzero(ended):
            final = self._events(ended)
            if same_step:
                info["final_obs"], info["final_info"] = objects(self._final, ended), final
                info["_final_obs"] = info["_final_info"] = ended
            else:
                info = merged(info, final)
        return out, reward, terminated, truncated, info

    @property
    def final_states(self) -> np.ndarray:
        """Final states [N] of the episodes that the last step ended, in mode SameStep."""
        return self._final_states

    def get_state(self) -> np.ndarray:
        """Return a copy of all states, [N] records, which fully determine the future."""
        return self.states.copy()

    def set_state(self, states: np.ndarray) -> np.ndarray:
        """Continue from states [N] of `get_state`, or all from one state; return the observations.

        In mode SameStep the states may not be at an episode's end.

        Raises:
            ValueError: If they are not valid states of the variant.
        """
        self._take(states, np.ones(self.num_envs, bool))
        self._seeded = True
        return self._do(np.full(self.num_envs, AS_SET))

    def shown_as(self, observation: Observation, art: str) -> Callable[[], np.ndarray]:
        """Return a function that returns the current states as other observations [N, ...]."""
        other = GameVectorEnv(
            self.game, self.variant, self.num_envs,
            observation=observation, art=art, threads=self._threads,
        )  # fmt: skip
        other._states = self._states
        return functools.partial(other._do, np.full(self.num_envs, AS_SET))

    def repeat(self, states: np.ndarray | None) -> None:
        """Begin every following episode of an environment in its own one of the `states` [N].

        None returns to the usual levels. Running episodes continue.

        Raises:
            ValueError: If they are not valid states [N] of the variant.
        """
        if states is None:
            self._begins = np.empty(0, self.game.state)
        else:
            if np.shape(states) != (self.num_envs,):
                raise ValueError(
                    f"states to repeat must be {self.num_envs}, one for each environment; got "
                    f"{np.shape(states)}"
                )
            self.game.check(states, self.variant, self._shown)
            if states["ended"].any():
                raise ValueError(
                    f"the episode of state {states['ended'].argmax()} has ended; give one that runs"
                )
            self._begins = np.array(states, self.game.state)
        self._source = (*self._source[:-1], self._begins)

    def _take(self, states: Any, which: np.ndarray, keep: Sequence[str] = ()) -> None:
        """Replace the states in `which`, except for the fields in `keep`."""
        given = np.asarray(states if isinstance(states, np.ndarray | np.void) else None)
        if given.dtype != self.game.state or given.shape not in ((), (1,), (self.num_envs,)):
            raise ValueError(
                f"states must be {self.num_envs} of {self.game.name}, or one; got "
                f"{given.dtype.names and len(given.dtype.names)} fields of shape {given.shape}"
            )
        given = np.broadcast_to(given, self.num_envs)[which]
        self.game.check(given, self.variant, self._shown)
        if self._mode == SAME_STEP and given["ended"].any():
            raise ValueError(
                f"the episode of state {given['ended'].argmax()} has ended; give one that runs"
            )
        kept = {name: self._states[name][which] for name in keep}
        self._states[which] = given
        for name, values in kept.items():
            self._states[name][which] = values

    def render(self) -> tuple[np.ndarray, ...] | None:
        """Return pictures to look at, [512, 512, 3] uint8 each, if render_mode is "rgb_array"."""
        return tuple(self.picture(PICTURE)) if self.render_mode == "rgb_array" else None

    def picture(self, pixels: int) -> np.ndarray:
        """Return pictures of all states at any scale, [N, pixels, pixels, 3] uint8."""
        return picture(self.game, self.variant, self.states, pixels, self.art)

    def close_extras(self, **kwargs: Any) -> None:
        self._pool.close()

    def _do(self, what: np.ndarray) -> np.ndarray:
        """Run a command other than STEP in every environment; return the observations."""
        observations = np.empty(self._shape, np.uint8)
        self._run(what, observations, NUMBERS, NO_RESULTS)
        return observations

    def _run(
        self, what: np.ndarray, observations: np.ndarray, actions: np.ndarray, results: tuple
    ) -> bool:
        """Call `loops.run` in all threads."""
        orders, seen = (self._mode, what, actions), (observations, self._final_states, self._final)
        arguments = self._states, self._looks, self._source, orders, seen, results
        return self._pool.run(self._loop, arguments)


def _checked(levels: Any) -> tuple[int, int, np.ndarray]:
    """Return the first number and length of a range, or a list as an array, after checks."""
    if not isinstance(levels, range):
        return 0, 1, level_numbers(levels)
    if levels.step != 1:
        raise ValueError(f"a range of levels to draw from has step 1; walk list({levels}) instead")
    level_numbers([levels[0], levels[-1]] if levels else levels)
    return levels.start, len(levels), NUMBERS
