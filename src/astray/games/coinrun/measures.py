"""What a state says about the episode: how far the runner is, what it sees. For studies of critics.

All take states [N] and return [N].
"""

from __future__ import annotations

import numpy as np

from astray.games.coinrun.draw import VIEW
from astray.games.coinrun.rules import COIN, HALF, WORLD

START = 1.5  # where the runner begins, in cells
STAGES = ("beginning", "middle", "end", "beyond")  # thirds of the way, and past the end wall's face
QUARTER = 0.25  # the picture of a coin begins this far inside of its cell


def progress(states: np.ndarray) -> np.ndarray:
    """The share of the way from the start to the end, above 1 beyond it."""
    return (states["x"] - START) / (states["end_x"] + 0.5 - START)


def stage(states: np.ndarray) -> np.ndarray:
    """The index in STAGES."""
    thirds = np.clip((progress(states) * 3).astype(int), 0, 2)
    return np.where(states["x"] > states["end_x"] + 1, 3, thirds)


def coin_in_view(states: np.ndarray) -> np.ndarray:
    """Whether any part of a coin's picture is in the window around the runner.

    But for slivers at the window's edge; `analysis.critic.sees` finds them, too.
    """
    reach = VIEW / 2 + 0.5 - QUARTER
    centres = np.arange(WORLD) + 0.5
    near_x = abs(centres - states["x"][:, None]) < reach
    near_y = abs(centres - states["y"][:, None]) < reach
    return ((states["cell"] == COIN) & near_y[:, :, None] & near_x[:, None, :]).any((1, 2))


def to_wall(states: np.ndarray) -> np.ndarray:
    """Cells from the runner's front to the face of the end wall; below 0 in it and beyond."""
    return states["end_x"] + 1 - (states["x"] + HALF)


def coin_passed(states: np.ndarray) -> np.ndarray:
    """Whether the runner is to the right of the coin's cell; False where there is no coin."""
    columns = (states["cell"] == COIN).any(1)
    return columns.any(1) & (states["x"] - HALF > columns.argmax(1) + 1)
