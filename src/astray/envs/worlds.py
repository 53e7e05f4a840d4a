"""Vector environments of a `World`, the counterpart of `GameVectorEnv`."""

import contextlib
import hashlib
import logging
import math
import multiprocessing
import os
import signal
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import cache, lru_cache, partial
from pickle import PickleError
from typing import Any

import numpy as np
from gymnasium import spaces
from gymnasium.utils.env_checker import data_equivalence
from gymnasium.vector import AsyncVectorEnv, AutoresetMode

from astray.envs.inturn import InTurn
from astray.envs.steps import choices
from astray.envs.watch import Watch
from astray.files import UNGUARDED
from astray.game import OWN
from astray.validation import MOST, bounded, shown
from astray.witness import MASK, NOTED, witnessed
from astray.world import Failed, Silent, World, WorldVariant

TRIED = 50  # steps of a level that is played twice
_tell = cache(logging.getLogger("astray").warning)  # each text once
# Gymnasium's warnings of an error in a process, which it also raises, and of an interrupt.
RECEIVED = r"(?s).*(ERROR: (Received the following|Traceback|Raising the last)|Calling `close`)"


class WorldVectorEnv:
    """Several environments of a variant; ended ones wait until `reset` begins another level.

    Attributes:
        states: [N] records of the current episodes: level, time, events and measures.
        allowed: [N, A] bool, the Discrete actions that masks of info allow; 1 where all are.

    Raises:
        ValueError: If an environment fails.
        RuntimeError: If its process dies or hangs.
    """

    observation, art = "image", OWN  # of games; here the factory decides what is shown

    def __init__(
        self, world: World, variant: str | WorldVariant, num_envs: int, longest: int | None = None
    ):
        """Make the environments; `longest` is the number of steps that truncates an episode."""
        bounded("num_envs", num_envs, 1, MOST)
        self.game, self.variant, self.num_envs = world, world.variant(variant), num_envs
        makers = [partial(witnessed, world, self.variant, longest, i) for i in range(num_envs)]
        self._envs: Any = None
        watch = Watch(world.patience, f"an environment of {self.variant}")
        with self._watched():
            self._envs = (
                _forked(makers, self.variant) if world.workers else InTurn(makers, NOTED, watch)
            )
        self._amid = False  # whether processes were asked, and not all answered
        self.single_action_space = self._envs.single_action_space
        self.single_observation_space = self._envs.single_observation_space
        # Images of bytes are in their space; to look takes as long as a quick environment's step.
        full = spaces.Box(0, 255, self.single_observation_space.shape or (), np.uint8)
        self._trusted = self.single_observation_space == full
        self.states = np.zeros(num_envs, world.state).view(np.recarray)
        self.allowed = np.ones((num_envs, 1), bool)

    def reset(
        self, *, seed: int | None = None, options: Mapping[str, Any]
    ) -> tuple[Any, dict[str, Any]]:
        """Begin the levels [N] of the option "level" where "reset_mask" [N] is true."""
        which = options.get("reset_mask", np.ones(self.num_envs, bool))
        levels = [int(k) for k in options["level"]]
        self.states[which] = np.zeros((), self.states.dtype)
        self.states["level"][which] = np.asarray(options["level"])[which]
        self.allowed[which] = True
        given = {"reset_mask": which.copy()}
        seen, info = self._ask("reset", seed=levels, options=given)
        if self.game.level_key in info:
            self.states["level"][which] = np.asarray(info[self.game.level_key])[which]
        self._check_numbers(seen)
        self._note(info)
        return _in_rows(self.single_observation_space, seen), info

    def step(self, actions: Any) -> tuple[Any, np.ndarray, np.ndarray, np.ndarray, dict[str, Any]]:
        """Step N environments; return arrays [N, ...]. Raise ValueError if an action is invalid."""
        self._check_actions(actions)
        taken = self._ask("step", actions)
        states = self.states.view(np.ndarray)  # fields of a recarray take ten times as long
        states["time"] += 1
        states["ended"] = taken[2] | taken[3]
        self._check_numbers(taken[0])
        self._note(taken[4])
        return _in_rows(self.single_observation_space, taken[0]), *taken[1:]

    def render(self) -> np.ndarray:
        """Return the images [N, H, W, 3] uint8 of all environments.

        Raises:
            ValueError: If an environment renders anything else.
        """
        images = np.asarray(self._ask("call", "render"))
        if images.dtype != np.uint8 or images.ndim != 4 or images.shape[3] != 3 or not images.size:
            raise Failed(
                f"environments of {self.variant} must render images [H, W, 3] uint8; got "
                f"{images.dtype} of shape {images.shape[1:]}"
            )
        return images

    def leads(self, goal: str) -> np.ndarray:
        """Return the actions [N] of the world's expert for a goal."""
        return np.array(self._ask("call", "leads", goal))

    def _ask(self, method: str, *given: Any, **more: Any) -> Any:
        """Return what a method of all environments returns."""
        if not self.game.workers:
            return getattr(self._envs, method)(*given, **more)
        with self._watched():
            self._amid = True
            getattr(self._envs, f"{method}_async")(*given, **more)
            answer = getattr(self._envs, f"{method}_wait")(timeout=self.game.patience)
            self._amid = False
            return answer

    def get_state(self) -> np.ndarray:
        """Return a copy of `states` [N]: records of episodes, which cannot restore environments."""
        return self.states.view(np.ndarray).copy()

    def keep(self, kept: np.ndarray) -> bool:
        """Leave out all environments but `kept` [n]; return False if processes cannot be left."""
        if self.game.workers:
            return False
        self._learn_keys()
        self._envs.keep(kept)
        self.states, self.allowed, self.num_envs = self.states[kept], self.allowed[kept], len(kept)  # pyrefly: ignore
        return True

    def close(self) -> None:
        """End all environments, and note in the world which keys of info occurred."""
        if self._envs.closed:  # as a process died or hung
            return
        # Gymnasium waits for ever for a process that hangs, also where its environment closes.
        patience = threading.Timer(self.game.patience, self._kill)
        if self.game.workers:
            patience.start()
        try:
            amid = [RuntimeError] * self._amid  # after an interrupt or an error, which is told
            with contextlib.suppress(*amid), self._watched(), contextlib.closing(self._envs):
                if not amid:  # other answers wait
                    self._learn_keys()
        finally:
            patience.cancel()

    def _learn_keys(self) -> None:
        self.game.reported.update(*self._envs.get_attr("reported"))

    def _note(self, info: Mapping[str, Any]) -> None:
        """Copy new records of the environments from info to `states`."""
        if NOTED not in info:
            return
        columns, which = (*self.game.events, *self.game.measures), info[f"_{NOTED}"]
        for name, values in zip(columns, info[NOTED].T, strict=True):
            self.states[name][which] = values[which]
        masks, space = info.get(MASK, ()), self.single_action_space
        if isinstance(space, spaces.Discrete) and np.shape(masks) == (self.num_envs, space.n):
            self.allowed = np.where(info[f"_{MASK}"][:, None], masks == 1, self.allowed)

    def _check_numbers(self, seen: Any) -> None:
        """Raise ValueError if an observation has NaN, with which networks compute only NaN.

        Warn once if it is in another way outside the space.
        """
        for part in _arrays(seen):
            # A sum is finite if all numbers are, and takes a tenth of the time of looking at each.
            if part.dtype.kind == "f" and not math.isfinite(part.sum(dtype=np.float64)):
                wrong = np.isnan(part.reshape(self.num_envs, -1)).any(1)
                if wrong.any():
                    level, time = (self.states[name][wrong][0] for name in ("level", "time"))
                    raise Failed(
                        f"{self.variant}, level {level}, step {time}: the observation has NaN"
                    )
        if not self._trusted and not self._envs.observation_space.contains(seen):
            self._trusted, space = True, self.single_observation_space
            _tell(f"observations of {self.game.name} are not all in {space}")

    def _check_actions(self, actions: Any) -> None:
        space, n = self.single_action_space, self.num_envs
        if isinstance(space, spaces.Discrete):
            choices("a policy", actions, n, space)
        elif np.shape(actions)[:1] != (n,) or not all(_is_in(space, one) for one in actions):
            raise ValueError(
                f"a policy must return {n} actions in {self.variant}, each of {space}; got "
                f"{shown(actions)}"
            )

    @contextlib.contextmanager
    def _watched(self) -> Iterator[None]:
        """Raise a readable error if a process died or hangs, after ending the others."""
        try:
            with warnings.catch_warnings():  # of what the error says
                warnings.filterwarnings("ignore", RECEIVED, UserWarning)
                yield
        except multiprocessing.TimeoutError as error:
            self._give_up()
            raise Silent(
                f"an environment of {self.variant} did not answer for {self.game.patience:g} s; "
                "its process was ended. World(patience=...) waits longer"
            ) from error
        except (EOFError, ConnectionError) as error:
            self._give_up()
            told = f"the process of an environment of {self.variant} died"
            raise Silent(told if self._envs else told + UNGUARDED) from error
        except (AttributeError, KeyError, TypeError, PickleError) as error:  # also of pickle
            if not self.game.workers:
                raise
            self._give_up()
            told = (
                f"spaces and infos of {self.variant} must be picklable, and observations of their"
            )
            raise Failed(f"{told} space, or World(workers=False): {shown(error)}") from error

    def _kill(self) -> None:
        for process in self._envs.processes:
            process.kill()

    def _give_up(self) -> None:
        if self._envs:  # else they did not begin
            self._kill()
            self._envs.closed = True  # to Gymnasium, which would wait for what is pending


def _forked(makers: Sequence[Callable], variant: WorldVariant) -> AsyncVectorEnv:
    """Return environments with a process each; signals wait until all processes have begun.

    An error that a signal raises amid a fork is ignored by Python.
    """
    if multiprocessing.get_start_method() == "forkserver":  # as on Linux from Python 3.14 on
        # It imports once what each process would import, which takes a second.
        factory: Any = getattr(variant.factory, "func", variant.factory)
        multiprocessing.set_forkserver_preload(["__main__", __name__, str(factory.__module__)])
    parent, waiting = os.getpid(), []

    def wait(number: int, _: object) -> None:
        waiting.append(number)
        if os.getpid() != parent and number == signal.SIGTERM:
            os._exit(128 + number)

    is_main = threading.current_thread() is threading.main_thread()
    signals = (signal.SIGINT, signal.SIGTERM) if is_main else ()
    before = [(number, signal.signal(number, wait)) for number in signals]
    try:
        (first := makers[0]()).close()
        shared = first.observation_space.shape is not None  # texts and graphs have no fixed size
        return AsyncVectorEnv(makers, shared, autoreset_mode=AutoresetMode.DISABLED)
    finally:
        for number, handler in before:
            signal.signal(number, handler)
        for number in waiting:
            signal.raise_signal(number)


def _is_in(space: spaces.Space, action: Any) -> bool:
    """Return whether an action is in a space, as it is: a cast would round it, or read text."""
    cast = np.asarray(action, space.dtype)
    return space.contains(cast) and (cast.dtype.kind == "f" or np.array_equal(cast, action))


def _in_rows(space: spaces.Space, seen: Any) -> Any:
    """Return observations as arrays of N rows; Gymnasium has texts, graphs and others in tuples."""
    if isinstance(space, spaces.Dict):
        return {name: _in_rows(part, seen[name]) for name, part in space.items()}
    if isinstance(space, spaces.Tuple):
        return tuple(map(_in_rows, space, seen))
    return np.fromiter(seen, object, len(seen)) if isinstance(seen, tuple) else seen


def _arrays(seen: Any) -> Iterator[np.ndarray]:
    """Yield the arrays [N, ...] of observations; those of a Dict or Tuple have several."""
    if isinstance(seen, Mapping | tuple):
        for part in seen.values() if isinstance(seen, Mapping) else seen:
            yield from _arrays(part)
    elif isinstance(seen, np.ndarray):
        yield seen


class Unreported(UserWarning):
    """Warning that an event names a key of info that did not occur, which may be misspelt."""


def unreported(world: Any) -> str:
    """Return a sentence on the first event that names a key of info that never occurred, or ""."""
    for event, key in world.events.items() if isinstance(world, World) else ():
        if isinstance(key, str) and key not in world.reported:
            there = ", ".join(sorted(world.reported - {NOTED})) or "none"
            told = f"the event {event!r} of {world.name} is the key {key!r} of info, which no step"
            return f"{told} reported; keys were: {there}"
    return ""


@lru_cache(1)  # several policies are evaluated one after the other
def check_repeats(world: World, variant: WorldVariant, levels: tuple[int, ...], n: int) -> None:
    """Check that `levels` are the same in another environment, each after another level.

    Otherwise results cannot be repeated, and nothing can be compared in the same levels. If `n`
    environments will play in one process, another one plays amid the episodes played again.

    Raises:
        ValueError: If two episodes of a level differ.
    """
    few = [*dict.fromkeys(levels)]
    back, once = [few[-1], *few[::-1]], _played(world, variant, few)
    twice = _played(world, variant, back, n > 1 and not world.workers)
    for level, last, first, again in zip(few, back[-2::-1], once, twice[::-1], strict=False):
        for time, (one, other) in enumerate(zip(first, again, strict=False)):
            if not data_equivalence(one, other, exact=True):
                raise ValueError(
                    f"{variant}, level {level} is another one when it is played again with the "
                    f"same actions, after level {last}: step {time} differs. Let all that is drawn "
                    "come from the seed of the reset, and nothing from the last episode or another "
                    "environment; World(workers=True) gives each a process. With "
                    "World(repeats=False), results differ from run to run"
                )


def shown_first(world: World, variant: WorldVariant, level: int) -> str:
    """Return a digest of what three levels from `level` on show, or "" if no level repeats.

    No source tells what an environment reads from a file, or which version of a library it has.
    """
    told = [_played(world, variant, [level + k])[0] for k in range(3) if world.repeats]
    return hashlib.sha256(b"".join(_bytes(told))).hexdigest()[:16] if told else ""


def _bytes(told: Any) -> Iterator[bytes]:
    """Yield the bytes of nested arrays, numbers and texts."""
    if isinstance(told, Mapping | tuple | list):
        for part in told.items() if isinstance(told, Mapping) else told:
            yield from _bytes(part)
    else:
        array = np.asarray(told)
        yield f"{array.dtype} {array.shape}".encode()
        yield repr(told).encode() if array.dtype.hasobject else array.tobytes()


def _played(
    world: World, variant: WorldVariant, levels: Sequence[int], amid: bool = False
) -> list[list[Any]]:
    """Play random actions in `levels`, watched as an evaluation is; return the episodes.

    If `amid`, another environment plays amid each of them, as it may share something.
    """
    env, episodes = WorldVectorEnv(world, variant, 1), []
    with contextlib.closing(env):
        for level in levels:
            (space := env.single_action_space).seed(int(level))
            told: list[Any] = [env.reset(options={"level": [level]})[0]]
            if amid:
                _played(world, variant, levels[:1])
            while len(told) <= TRIED and not env.states["ended"][0]:
                mask = env.allowed[0].astype(np.int8)
                drawn = space.sample(mask) if len(mask) > 1 else space.sample()
                taken = env.step(np.array([drawn]))[:4]
                told.append((*taken, env.get_state().tobytes()))  # NaNs as equal bytes
            episodes.append(told)
    return episodes
