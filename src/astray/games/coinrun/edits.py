"""Edits of states, for studies of an agent's perception.

All take states [N] and return edited copies [N].
"""

from typing import Any

import numpy as np

from astray.games.coinrun.draw import VIEW
from astray.games.coinrun.levels import BACKGROUNDS, RUNNERS
from astray.games.coinrun.rules import (
    COIN,
    CRATE,
    EMPTY,
    HALF,
    INVISIBLE,
    NOTHING,
    PERMEABLE,
    SAW,
    TALL,
    TOP,
    WALL,
    WORLD,
)
from astray.record import NEVER

CENTRES = np.arange(WORLD) + 0.5
IN_VIEW = VIEW / 2 - 0.5  # cells from the runner to the centre of a cell that all of is seen


def without_coin(states: np.ndarray) -> np.ndarray:
    """Remove all coins from states [N]."""
    edited = states.copy()
    edited["cell"][edited["cell"] == COIN] = EMPTY
    edited["coin_x"], edited["coin_y"] = NEVER, NEVER
    return edited


def with_coin_in_view(states: np.ndarray, *, seed: int = 0) -> np.ndarray:
    """Add a coin at a visible place to stand, if there is one, to each state [N].

    The place is uniformly random, and depends on seed, level and step alone.
    """
    edited = states.copy()
    for s in edited:
        near_x, near_y = abs(CENTRES - s["x"]) <= IN_VIEW, abs(CENTRES - s["y"]) <= IN_VIEW
        ground = np.isin(s["cell"], (WALL, TOP)) | (s["thing"] == CRATE)
        stands = _free(s) & np.vstack([np.zeros((1, WORLD), bool), ground[:-1]])
        places = np.argwhere(stands & near_y[:, None] & near_x)
        if len(places):
            random = np.random.default_rng([seed, int(s["level"]) + 1, int(s["time"])])
            y, x = places[random.integers(len(places))]
            s["cell"][y, x] = COIN
            if x > s["coin_x"]:
                s["coin_x"], s["coin_y"] = x, y
    return edited


def _free(s: Any) -> np.ndarray:
    """Return the cells without an object, the runner or a walker, [WORLD, WORLD] bool."""
    free = np.isin(s["cell"], (EMPTY, INVISIBLE)) & (s["thing"] == NOTHING)
    touched_x, touched_y = abs(CENTRES - s["x"]) < 2 * HALF, abs(CENTRES - s["y"]) < HALF + TALL
    free &= ~(touched_y[:, None] & touched_x)
    walkers = slice(int(s["walkers"]))
    free[s["walker_y"][walkers].astype(int), s["walker_x"][walkers].astype(int)] = False
    return free


def without_walkers(states: np.ndarray) -> np.ndarray:
    """Remove walkers and their trails from states [N]."""
    edited = states.copy()
    edited["walkers"] = 0
    return edited


def without_saws(states: np.ndarray) -> np.ndarray:
    """Remove saws from states [N]."""
    edited = states.copy()
    edited["thing"][edited["thing"] == SAW] = NOTHING
    return edited


def without_crates(states: np.ndarray) -> np.ndarray:
    """Remove crates from states [N]; a runner on one then stands on air."""
    edited = states.copy()
    edited["thing"][edited["thing"] == CRATE] = NOTHING
    return edited


def without_end_wall(states: np.ndarray) -> np.ndarray:
    """Remove the end wall from states [N], above the ground before it; the ground continues."""
    edited, columns = states.copy(), np.arange(WORLD)
    end, permeable = states["end_x"][:, None], states["permeable"][:, None]
    in_wall = (columns > end) & ((permeable == 0) | (columns <= end + permeable))
    above = columns >= states["end_y"][:, None]  # rows, as many as columns
    solid = np.isin(states["cell"], (WALL, TOP, PERMEABLE))
    edited["cell"][solid & above[:, :, None] & in_wall[:, None, :]] = EMPTY
    return edited


def with_other_runner(states: np.ndarray) -> np.ndarray:
    """Change the runner's colour in states [N]."""
    edited = states.copy()
    edited["runner_look"] = (states["runner_look"] + 1) % RUNNERS
    return edited


def with_other_background(states: np.ndarray) -> np.ndarray:
    """Change the backdrop of states [N] to the one furthest away in the list."""
    edited = states.copy()
    edited["background"] = (states["background"] + BACKGROUNDS // 2) % BACKGROUNDS
    return edited


# What a picture consists of, for `insight.attribution.masks`: what is soft at its edge comes
# before the background that shines through. What is left is ground and lava.
PARTS = {
    "coin": without_coin,
    "walkers": without_walkers,
    "saws": without_saws,
    "end wall": without_end_wall,
    "crates": without_crates,
    "runner": with_other_runner,
    "background": with_other_background,
}
