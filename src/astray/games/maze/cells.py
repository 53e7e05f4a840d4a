"""Where the mouse is, and where it may go: cells (x, y), x to the right, y upward."""

from __future__ import annotations

from typing import Any

import numpy as np

from astray.games.maze.solve import target as target
from astray.kernel.maze import WALL


def position(states: np.ndarray) -> np.ndarray:
    """The cells of the mice of states [N], [N, 2] int64."""
    return np.stack([states["x"], states["y"]], -1).astype(np.int64)


def free(s: Any) -> np.ndarray:
    """The cells of the world of state `s` that are no wall, [H, W] bool."""
    return np.asarray(s.cell[: s.world, : s.world] != WALL)
