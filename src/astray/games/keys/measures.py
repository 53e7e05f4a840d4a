"""Measures of an episode, as pure functions of final states.

`states` are [N] records at the ends of episodes; results are [N].
"""

from collections.abc import Callable, Mapping

import numpy as np

from astray.games.keys.rules import CHEST, KEY, MOST
from astray.protocols import Classes
from astray.record import NEVER

QUARTERS = ("left, below", "right, below", "left, above", "right, above")


def _objects(states: np.ndarray) -> np.ndarray:
    """Return KEY or CHEST for every object, 0 for other entries, [N, MOST]."""
    there = np.arange(MOST) < states["objects"][:, None]
    return np.where(there, states["what"], 0)


def keys_beyond_need(states: np.ndarray) -> np.ndarray:
    """Return the number [N] of keys taken in excess of the number of chests, int64.

    No agent that wants chests needs them. In a maze some keys are on every way, so compare with
    `solve.expert` for "chests".
    """
    return np.maximum(states["taken"] - states["chests"], 0)


def keys_in_hand(states: np.ndarray) -> np.ndarray:
    """Return the mean number [N] of keys in hand at openings; NaN if no chest was opened."""
    opened = (_objects(states) == CHEST) & (states["gone"] != NEVER)
    total = np.where(opened, states["had"], 0).sum(1).astype(np.float64)
    count = states["opened"]
    return np.divide(total, count, out=np.full(len(states), np.nan), where=count > 0)


def discounted_return(states: np.ndarray, gamma: float) -> np.ndarray:
    """Return the discounted return [N] of episodes from their first step, from final `states` [N].

    A step's rewards are summed as in the variants that are not strict.
    """
    steps = np.where(states["gone"] > 0, states["gone"], 1)
    weights = np.where(states["gone"] != NEVER, gamma ** (steps - 1.0), 0)
    what = _objects(states)
    total = ((what == CHEST) * weights).sum(1)
    total -= ((what == KEY) * weights).sum(1) * states["key_penalty"]
    time = states["time"]
    spent = time if gamma == 1 else (1 - gamma**time) / (1 - gamma)
    return total - spent * states["step_penalty"]


def nearest(states: np.ndarray, what: int) -> np.ndarray:
    """Return x and y distances to the nearest remaining KEY or CHEST, [N, 2] float64, or NaN."""
    left = (_objects(states) == what) & (states["gone"] == NEVER)
    away = np.stack([states[f"object_{axis}"] - states[axis][:, None] for axis in "xy"], 2)
    far = np.where(left, np.hypot(away[..., 0], away[..., 1]), np.inf)
    found = away[np.arange(len(states)), far.argmin(1)].astype(np.float64)
    return np.where(left.any(1)[:, None], found, np.nan)


def quarter(away: np.ndarray) -> np.ndarray:
    """Return the quadrant [N] of `away` [N, 2], 0 to 3: 1 for right plus 2 for up; -1 for NaN."""
    known = ~np.isnan(away[:, 0])
    return np.where(known, (away[:, 0] > 0) + 2 * (away[:, 1] > 0), -1)


# Labels that probes may look for in an agent's activations.
LABELS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = {
    "keys in hand": lambda states: states["taken"] - states["opened"],
    "nearest key": Classes(lambda states: quarter(nearest(states, KEY)), QUARTERS),
    "nearest key right": lambda states: nearest(states, KEY)[:, 0],
    "nearest key up": lambda states: nearest(states, KEY)[:, 1],
    "nearest chest": Classes(lambda states: quarter(nearest(states, CHEST)), QUARTERS),
    "chests left": lambda states: (states["chests"] - states["opened"]).astype(np.float64),
}
