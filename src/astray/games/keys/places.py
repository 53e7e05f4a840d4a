"""Positions of the thief in cells (x, y), x to the right, y upward."""

from __future__ import annotations

from typing import Any

import numpy as np

from astray.games.keys import levels, solve
from astray.record import centres as centre

__all__ = ["centre", "put", "stand"]


def stand(s: Any) -> np.ndarray:
    """Return the empty cells that the thief can walk to, and its own, [H, W] bool."""
    found = (levels.grid(s) == levels.EMPTY) & solve.reachable(s)
    found[int(s.y), int(s.x)] = True
    return found


def put(states: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return copies of states [N] with the thieves in the middle of `cells` [N, 2], at rest."""
    found = states.copy()
    found["x"], found["y"] = cells.T + 0.5
    found["vx"], found["vy"] = 0, 0
    return found
