"""The record of what happens in the environments of a `World`, and of whether levels repeat."""

import multiprocessing
import signal
from collections.abc import Callable, Mapping
from functools import cache
from math import isfinite
from typing import Any, cast

import gymnasium
import numpy as np

from astray.record import NEVER
from astray.validation import one_of, shown
from astray.world import FAILURES, Env, Failed, Happened, World, WorldVariant

NOTED = "astray"  # key of info that reports events and measures
MASK = "action_mask"  # key of info that Gymnasium's own environments report allowed actions by
BOOLEANS = (bool, np.bool_)
NO = np.False_  # a single object, what comparisons of numpy's numbers return
Asked = Callable[[Any, Mapping[str, Any]], Any]  # (environment, info) -> whether an event happens


class Witness(gymnasium.Wrapper):
    """Wrapper that records at which step each event first happened.

    It runs in the environment's process. A key of info reports the record when an event happens
    and when the episode ends. Errors in the environment and in the world's functions name the
    level and the step.

    Args:
        longest: Steps after which an episode is truncated for the evaluation.
    """

    def __init__(self, env: Env, world: World, variant: WorldVariant, longest: int | None):
        super().__init__(env)
        self.world, self.variant, self.longest = world, variant, longest
        self.level, self.time = NEVER, 0
        self.reported: set[str] = set()
        self._inner, self._shape = env.unwrapped, env.observation_space.shape
        self._every_step, self._kind = world.every_step, cast("Any", env.observation_space.dtype)
        self._events = self._waiting = _events(world)  # those that have not happened

    def reset(self, *, seed: int | None = None, options: dict | None = None) -> tuple[Any, dict]:
        """Begin the level whose number is `seed`; raise ValueError if the world's code fails."""
        self.level, self.time = NEVER if seed is None else seed, 0
        self.first = dict.fromkeys(self.world.events, NEVER)
        self._waiting = self._events
        try:
            seen, info = self.env.reset(seed=seed, options=options)
        except FAILURES as error:
            raise self._failed("reset", error) from error
        self._check_seen(seen)
        self._check_info(info)
        key = self.world.level_key
        if key is not None and key not in info:
            raise Failed(f"{self._where()}: its info has no {key!r}, the number of the level")
        if key is not None:
            number = np.asarray(info[key])  # EnvPool's is an array of one
            if number.dtype.kind not in "iu" or number.size != 1 or number.item() >= 2**63:
                told = f"info[{key!r}], the number of the level, must be an integer below 2**63"
                raise Failed(f"{self._where()}: {told}; got {shown(info[key])}")
            self.level = number.item()
            info = {**info, key: self.level}
        self._happens(info)
        return seen, {**info, NOTED: self._told()}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict]:
        """Take a step and record its events; raise ValueError as `reset` does."""
        self.time += 1
        try:
            seen, reward, terminated, truncated, info = self.env.step(action)
        except FAILURES as error:
            raise self._failed("step", error) from error
        if type(terminated) not in BOOLEANS or type(truncated) not in BOOLEANS:
            self._check_flag("flag of termination", terminated)
            self._check_flag("flag of truncation", truncated)
        ended = bool(terminated or truncated)
        # Kinds of numbers are single objects; to compare them takes longer.
        if (
            type(seen) is not np.ndarray
            or seen.dtype is not self._kind
            or seen.shape != self._shape
        ):
            self._check_seen(seen)
        if type(info) is not dict:
            self._check_info(info)
        last = ended or self.time in (1, self.longest)  # 1: `until` may name an event of the reset
        if self._happens(info) or last or self._every_step or MASK in info:
            info = {**info, NOTED: self._told()}
        try:
            if isfinite(reward):
                return seen, float(reward), terminated, truncated, info
        except (TypeError, ValueError, OverflowError):
            pass
        raise Failed(f"{self._where()}: its reward must be a finite number; got {shown(reward)}")

    def render(self) -> Any:
        """Return the image of the environment; raise ValueError if it fails."""
        try:
            return self.env.render()
        except FAILURES as error:
            raise self._failed("render", error) from error

    def close(self) -> None:
        """End the environment; raise ValueError if it fails."""
        try:
            self.env.close()
        except FAILURES as error:
            raise self._failed("close", error) from error

    def leads(self, goal: str) -> Any:
        """Return the action of the expert for a goal; raise ValueError if there is none."""
        one_of("goal of an expert", goal, self.world.experts, of=self.world.name)
        try:
            return self.world.experts[goal](self._inner)
        except FAILURES as error:
            raise self._failed(f"expert of {goal!r}", error) from error

    def _happens(self, info: Mapping[str, Any]) -> bool:
        """Record the events of this step; return whether there were any."""
        if info:
            self.reported.update(info)
        told, inner, name = [], self._inner, ""
        try:
            for name, happened in self._waiting:
                is_now = happened(inner, info)
                if is_now is not False and is_now is not NO:
                    told.append((name, is_now))
        except FAILURES as error:
            raise self._failed(f"event {name!r}", error) from error
        new = False
        for name, is_now in told:
            if type(is_now) not in BOOLEANS:
                self._check_flag(f"event {name!r}", is_now)
            if is_now:
                self.first[name], new = self.time, True
                self._waiting = tuple(one for one in self._waiting if one[0] != name)
        return new

    def _told(self) -> np.ndarray:
        """Return the record so far: the step of each event, and the measures."""
        told: list[float] = [*self.first.values()]
        for name, measure in self.world.measures.items():
            try:
                told.append(float(measure(self._inner)))
            except FAILURES as error:
                raise self._failed(f"measure {name!r}", error) from error
        return np.array(told, np.float64)

    def _check_seen(self, seen: Any) -> None:
        if self._shape is None:  # of several parts, as of a Dict
            return
        array = np.asarray(seen)
        if array.shape != self._shape:
            told, space = f"shape {array.shape}", self._shape
        elif not np.can_cast(array.dtype, self._kind, "same_kind"):
            told, space = array.dtype, self._kind
        else:
            return
        told = f"the observation is of {told}, where the space says {space}"
        raise Failed(f"{self._where()}: {told}")

    def _check_flag(self, name: str, flag: Any) -> None:
        # It may be NaN, which is truthy, or text; this takes 3 us.
        if np.ndim(flag) or flag not in (0, 1):
            raise Failed(f"{self._where()}: its {name} must be True or False; got {shown(flag)}")

    def _check_info(self, info: Any) -> None:
        if not isinstance(info, Mapping):
            raise Failed(f"{self._where()}: its info must be a dictionary; got {shown(info)}")

    def _failed(self, doing: str, error: BaseException) -> ValueError:
        return Failed(f"{self._where()}: its {doing} fails: {shown(error, 300)}")

    def _where(self) -> str:
        return f"{self.variant}, level {self.level}, step {self.time}"


@cache  # as steps of many environments that share an object take less time
def _events(world: World) -> tuple[tuple[str, Asked], ...]:
    return tuple((name, _asked(event)) for name, event in world.events.items())


def _asked(event: Happened) -> Asked:
    """Return the function that tells whether an event happens."""
    return (lambda env, info: info.get(event, False)) if isinstance(event, str) else event


def witnessed(
    world: World, variant: WorldVariant, longest: int | None = None, stream: int = 0
) -> Witness:
    """Return a new environment of a variant that records events."""
    if multiprocessing.current_process().daemon:  # a World's worker leaves interrupts to its parent
        signal.signal(signal.SIGINT, signal.SIG_IGN)
        signal.signal(signal.SIGTERM, signal.SIG_DFL)
    if world.level_key is not None:
        variant = variant.with_knobs({"stream": stream})
    return Witness(variant.make(), world, variant, longest)
