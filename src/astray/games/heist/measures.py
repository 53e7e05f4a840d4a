"""Labels of Heist's states [N] for probes: pure functions."""

from collections.abc import Callable, Mapping

import numpy as np

from astray.games.heist.rules import COLOURS, DOOR_CODE, GEM, MOST
from astray.record import NEVER


def left(states: np.ndarray, first: int, after: int) -> np.ndarray:
    """Count the remaining objects with codes from `first` to before `after`, [N] float64."""
    there = np.arange(MOST) < states["objects"][:, None]
    there &= (states["gone"] == NEVER) & (states["what"] >= first) & (states["what"] < after)
    return there.sum(1).astype(np.float64)


LABELS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    f"{name} key in hand": lambda states, k=k: states["hand"] >> k & 1 == 1
    for k, name in enumerate(COLOURS)
} | {
    "doors left": lambda states: left(states, DOOR_CODE, GEM),
    "all keys in hand": lambda states: states["hand"] == states["keys"],
}
