"""Positions of the mouse in cells (x, y), x to the right, y upward."""

from __future__ import annotations

from typing import Any

import numpy as np

from astray.games.maze import levels, solve
from astray.games.maze.solve import target as target
from astray.kernel.maze import WALL
from astray.record import centres as centre

__all__ = ["centre", "free", "put", "stand", "target"]


def free(s: Any) -> np.ndarray:
    """Return the cells of state `s` that are not walls, [H, W] bool."""
    return np.asarray(s.cell[: s.world, : s.world] != WALL)


def stand(s: Any) -> np.ndarray:
    """Return the empty cells that the mouse can walk to, and its own, [H, W] bool."""
    found = (levels.grid(s) == levels.EMPTY) & solve.reachable(s)
    found[int(s.y), int(s.x)] = True
    return found


def put(states: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return copies of states [N] with the mice in `cells` [N, 2]."""
    found = states.copy()
    found["x"], found["y"] = cells.T + 0.5
    return found
