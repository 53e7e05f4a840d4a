"""Class 2: states changed by hand, field by field, and given to all that takes states."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from attack.core import Attempt, Place
from attack.material import SMALLEST

STEPS = 40  # that are played from a state that was not refused


def attempts() -> Iterator[Attempt]:
    from astray import games

    for name in games.OWN:
        game = games.find(name)
        for field in game.state.names or ():
            for value in _extremes(game.state[field].base):
                title = f"states of {name}: {field} is {value}"
                yield Attempt(2, title, functools.partial(_play, name, field, value), "any")
    for name in games.OWN:
        for title, use in _uses().items():
            for ruin in RUINS:
                for kind, held in HELD.items():
                    act = functools.partial(_use, name, use, ruin, held)
                    yield Attempt(2, f"{title} of {kind} of {name}: {ruin}", act, "any")


def _extremes(kind: np.dtype) -> list[Any]:
    """Values that a field can hold, and no game means."""
    if kind.kind == "b":
        return [True]
    if kind.kind == "f":
        return [np.nan, np.inf, -1e300 if kind.itemsize == 8 else -1e30]
    limits = np.iinfo(kind)
    return list(dict.fromkeys([limits.max, limits.min if kind.kind == "i" else 77]))


def _states(place: Place, game: str) -> np.ndarray:
    from astray.envs.states import load_states

    return load_states(place.made / f"{game}.npz", game).copy()


def _env(game: str, **options: Any) -> Any:
    from astray.envs.vector import GameVectorEnv

    env = GameVectorEnv(game, SMALLEST[game], 2, **{"observation": "symbolic"} | options)
    env.reset(seed=0)
    return env


def _play(game: str, field: str, value: Any, place: Place) -> None:
    """Play on from states in which all of a field, or its last item, has that value."""
    env, states = _env(game), _states(place, game)
    if states[field].ndim > 1:
        states[field].reshape(2, -1)[:, -1] = value
    else:
        states[field] = value
    env.set_state(states)
    for k in range(STEPS):
        env.step(np.full(2, k % len(env.game.actions)))
    env.picture(64)


# Ways to ruin states so that several fields disagree.
RUINS: dict[str, Callable[[np.ndarray], None]] = {
    "all bits set": lambda s: s.view(np.uint8).fill(255),
    "all bits zero": lambda s: s.view(np.uint8).fill(0),
    "bytes at random": lambda s: _noise(s, 1.0),
    "one byte in a hundred": lambda s: _noise(s, 0.01),
    "places far away": lambda s: _places(s, 1e9),
    "places before the beginning": lambda s: _places(s, -5),
    "counts beyond their arrays": lambda s: _counts(s, 120),
    "codes that are none": lambda s: _codes(s, 200),
}


def _noise(states: np.ndarray, fraction: float) -> None:
    raw, random = states.view(np.uint8), np.random.default_rng(7)
    hit = random.random(raw.shape) < fraction
    raw[hit] = random.integers(0, 256, int(hit.sum()))


def _names(states: np.ndarray, shape: int) -> list[str]:
    """Fields of numbers of that many dimensions, beside those that all games have."""
    from astray.record import COMMON

    return [n for n in states.dtype.names or () if n not in COMMON and states[n].ndim == shape]


def _places(states: np.ndarray, value: float) -> None:
    for name in ("x", "y", "goal_x", "goal_y", "other_x", "other_y"):
        if name in (states.dtype.names or ()):
            states[name] = value


def _counts(states: np.ndarray, value: int) -> None:
    for name in _names(states, 1):
        if states[name].dtype.kind in "iu":
            states[name] = value


def _codes(states: np.ndarray, value: int) -> None:
    for name in _names(states, 2) + _names(states, 3):
        if states[name].dtype.kind in "iu":
            states[name] = min(value, np.iinfo(states[name].dtype).max)


# Who could have written to the states that are given.
HELD: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "states": lambda s: s,
    "read-only states": lambda s: np.frombuffer(s.tobytes(), s.dtype),
}


def _use(
    game: str,
    use: Callable[[Any, np.ndarray], Any],
    ruin: str,
    held: Callable[[np.ndarray], np.ndarray],
    place: Place,
) -> None:
    env, states = _env(game), _states(place, game)
    RUINS[ruin](states)
    use(env, held(states))


def _uses() -> dict[str, Callable[[Any, np.ndarray], Any]]:
    """All that takes states of a game: (an environment, the states)."""
    from astray.envs import vector
    from astray.level import Level

    def set_and_step(env: Any, states: np.ndarray) -> None:
        env.set_state(states)
        for k in range(STEPS):
            env.step(np.full(2, k % len(env.game.actions)))

    def repeat(env: Any, states: np.ndarray) -> None:
        env.repeat(states)
        for _ in range(STEPS):
            env.step(np.zeros(2, int))
        env.reset()

    def solve(env: Any, states: np.ndarray) -> None:
        for goal in env.game.goals:
            env.game.solver.expert(states[0], goal)(states[0])

    def values(env: Any, states: np.ndarray) -> None:
        for goal in env.game.goals:
            env.game.solver.optimal_return(states[0], goal)

    def measures(env: Any, states: np.ndarray) -> None:
        for measure in env.game.labels.values():
            measure(states)

    def edits(env: Any, states: np.ndarray) -> None:
        if env.game.mutation:
            env.game.mutation.mutate(states, env.variant, np.zeros(2, np.uint32), 12, "binomial")

    def cells(env: Any, states: np.ndarray) -> None:
        if env.game.places:
            env.game.places.centre(states)
        if env.game.cells:
            env.game.cells.free(states[0])

    return {
        "set_state": set_and_step,
        "a reset": lambda env, s: (env.reset(options={"state": s}), env.step(np.zeros(2, int))),
        "repeat": repeat,
        "a picture": lambda env, s: vector.picture(env.game, env.variant, s, 100),
        "a level": lambda env, s: str(Level.of(env.game, env.variant, s[0])),
        "reachable": lambda env, s: env.game.solver.reachable(s[0]),
        "experts": solve, "returns": values, "labels": measures, "mutate": edits, "cells": cells,
        "features": lambda env, s: env.game.features and env.game.features(s),
    }  # fmt: skip
