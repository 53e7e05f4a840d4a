"""The batch loops compiled for one game."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from astray import games
from astray.envs import loops
from astray.kernel import rng
from astray.kernel.grid import distances
from astray.kernel.jit import kernel, one_at_a_time, shared, specialise


@dataclass(frozen=True)
class Loops:
    """`loops.reset_all`, `step_all` and `repaint_all` of one game."""

    reset: Callable
    step: Callable
    repaint: Callable


@functools.cache
def compiled(name: str) -> Loops:
    """The loops of the game called `name`, compiled or taken from the cache."""
    game = games.load(name)
    functions = {
        "generate": game.generate,
        "step": game.step,
        "paint": game.paint,
        "draw": game.draw,
        "paint_planes": game.paint_planes,
        "draw_planes": game.draw_planes,
    }
    functions["paint_one"] = specialise(loops.paint_any, name, shared, **functions)
    functions["begin_one"] = specialise(loops.begin, name, shared, **functions)
    functions["observe_one"] = specialise(loops.observe, name, kernel, **functions)
    result = Loops(
        specialise(loops.reset_all, name, **functions),
        specialise(loops.step_all, name, **functions),
        specialise(loops.repaint_all, name, **functions),
    )
    with one_at_a_time():
        _compile(name, result)
        distances(np.ones((1, 1), bool), 0, 0)
        rng.fill_noise(
            0, np.empty(0, np.int64), np.empty(0, np.int64), np.empty((0, 1), np.float32)
        )
    return result


def _compile(name: str, made: Loops) -> None:
    """Run every loop over no environment, so that it is compiled for the types to come."""
    game = games.load(name)
    variant = next(iter(game.variants.values()))
    states, params = np.zeros(0, game.state).view(np.recarray), variant.records()
    art = game.art(variant, 1)
    pictures, numbers, flags = (
        np.empty((0, 1, 1, 1), np.uint8),
        np.empty(0, np.int64),
        np.empty(0, bool),
    )
    levels = (params, art, False, pictures, numbers, 0, 1)
    made.reset(states, *levels, flags, numbers, pictures, 0, 0)
    made.step(
        states, *levels, 0, numbers, pictures, states, pictures,
        np.empty(0), flags, flags, 0, 0,
    )  # fmt: skip
    made.repaint(states, art, False, pictures, pictures, 0, 0)
