"""Features of states for studies of critics: the runner's progress, and visible things.

All take states [N] and return [N].
"""

from collections.abc import Callable, Mapping

import numpy as np

from astray.games.coinrun.draw import VIEW
from astray.games.coinrun.rules import COIN, HALF, LAVA, LAVA_TOP, SAW, WORLD

START = 1.5  # where the runner begins, in cells
STAGES = ("beginning", "middle", "end", "beyond")  # thirds of the way, and past the end wall's face
AHEAD = 4  # cells: what a runner at full speed, half a cell a step, meets within 8 steps
QUARTER = 0.25  # the picture of a coin begins this far inside of its cell


def progress(states: np.ndarray) -> np.ndarray:
    """Return the fraction [N] of the way from start to end, above 1 beyond it."""
    return (states["x"] - START) / (states["end_x"] + 0.5 - START)


def stage(states: np.ndarray) -> np.ndarray:
    """Return the stage of the way, an index [N] in STAGES."""
    thirds = np.clip((progress(states) * 3).astype(int), 0, 2)
    return np.where(states["x"] > states["end_x"] + 1, 3, thirds)


def coin_in_view(states: np.ndarray) -> np.ndarray:
    """Return whether any part of a coin's picture is in the window, [N] bool.

    Slivers at the window's edge do not count; `analysis.critic.sees` includes them.
    """
    return np.any(_coins_in_view(states), axis=(1, 2))


def _coins_in_view(states: np.ndarray) -> np.ndarray:
    """Return the cells of visible coins, [N, WORLD, WORLD] bool."""
    reach = VIEW / 2 + 0.5 - QUARTER
    centres = np.arange(WORLD) + 0.5
    near_x = abs(centres - states["x"][:, None]) < reach
    near_y = abs(centres - states["y"][:, None]) < reach
    return (states["cell"] == COIN) & near_y[:, :, None] & near_x[:, None, :]


def to_wall(states: np.ndarray) -> np.ndarray:
    """Return the cells [N] from the runner's front to the end wall's face; negative beyond it."""
    return states["end_x"] + 1 - (states["x"] + HALF)


def coin_passed(states: np.ndarray) -> np.ndarray:
    """Return whether the runner is to the right of the coin's cell, [N]; False without a coin."""
    columns = (states["cell"] == COIN).any(1)
    return columns.any(1) & (states["x"] - HALF > columns.argmax(1) + 1)


def wall_in_view(states: np.ndarray) -> np.ndarray:
    """Return whether the face of the end wall is in the window, [N] bool."""
    return states["end_x"] + 1 - states["x"] < VIEW / 2


def coin_offset(states: np.ndarray, axis: str) -> np.ndarray:
    """Return the cells [N] to the nearest visible coin along "x" or "y"; NaN without one."""
    found = np.full(len(states), np.nan)
    seen = _coins_in_view(states)
    for k in np.flatnonzero(seen.any((1, 2))):
        rows, columns = np.nonzero(seen[k])
        away = np.stack([columns + 0.5 - states["x"][k], rows + 0.5 - states["y"][k]])
        found[k] = away["xy".index(axis), np.hypot(*away).argmin()]
    return found


def hazard_ahead(states: np.ndarray) -> np.ndarray:
    """Return whether a hazard is at most AHEAD cells before the runner, [N], at any height."""
    columns = np.arange(WORLD) + 0.5 - states["x"][:, None]
    near = (columns > 0) & (columns <= AHEAD)
    fixed = np.isin(states["cell"], (LAVA, LAVA_TOP)) | (states["thing"] == SAW)
    away = states["walker_x"] - states["x"][:, None]
    there = np.arange(away.shape[1]) < states["walkers"][:, None]
    walks = (away > 0) & (away <= AHEAD) & there
    return (fixed & near[:, None, :]).any((1, 2)) | walks.any(1)


# Labels that probes may look for in an agent's activations.
LABELS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "coin in view": coin_in_view,
    "coin right": lambda states: coin_offset(states, "x"),
    "coin up": lambda states: coin_offset(states, "y"),
    "end wall in view": wall_in_view,
    "hazard ahead": hazard_ahead,
    "end wall, cells": lambda states: to_wall(states).astype(np.float64),
}
