"""Positions of the runner in cells (x, y), x to the right, y upward."""

from __future__ import annotations

from typing import Any

import numpy as np

from astray.games.coinrun import levels, solve
from astray.games.coinrun.rules import HALF, TALL
from astray.record import centres as centre

__all__ = ["centre", "put", "stand"]


def stand(s: Any) -> np.ndarray:
    """Return the empty cells that the runner can reach, and its own, [H, W] bool.

    In some of them it would fall.
    """
    found = (levels.grid(s) == levels.EMPTY) & solve.reachable(s)
    found[int(s.y), int(s.x)] = True
    return found


def put(states: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Return copies of states [N] with the runners on the ground of `cells` [N, 2], at rest."""
    found = states.copy()
    found["x"], found["y"] = cells[:, 0] + HALF, cells[:, 1] + TALL
    found["vx"], found["vy"], found["on_crate"] = 0, 0, False
    return found
