"""One linear probe shared by all cells of a level, which returns a map.

    seen = at_cells(agent, variant, found.values["tick3"])  # [N, C, world, world]
    probe = fit(seen, ahead(states, variant.world), states["level"])
    probe.map(seen)  # probability in each cell, [N, world, world]

As the probe sees the channels at one cell alone, it cannot compute what a network has not. In other
states, such as those of another distribution, `score` tells whether the same is to be read there.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from astray.analysis.trained import Model
from astray.estimate import Estimate
from astray.game import Variant
from astray.insight.activations import beginnings_in
from astray.insight.interventions import place
from astray.insight.probes import FITS, need_sklearn, score

MOST = 20_000  # cells that are fitted to; more take long and change little
Cells = Callable[[np.ndarray], np.ndarray]  # states [N] -> the agent's places [N, 2], (x, y)


@dataclass(frozen=True)
class CellProbe:
    """A probe of whether something holds in a cell, fitted by `fit`."""

    model: Any

    def map(self, x: np.ndarray) -> np.ndarray:
        """Return the probability in each cell, [N, H, W] float64, given channels [N, C, H, W]."""
        n, channels, *cells = x.shape
        flat = np.moveaxis(x, 1, -1).reshape(-1, channels)
        return self.model.predict_proba(flat)[:, 1].reshape(n, *cells)

    def score(self, x: np.ndarray, truth: np.ndarray, levels: np.ndarray) -> Estimate:
        """Return the balanced accuracy over all cells, with its interval over levels.

        Args:
            x: Channels [N, C, H, W].
            truth: [N, H, W] bool.
            levels: [N], levels of the states.

        Raises:
            ValueError: If the arrays do not go together, or `truth` holds everywhere or nowhere.
        """
        _check(x, truth, levels)
        y = truth.reshape(-1).astype(np.int64)
        if not 0 < y.sum() < len(y):
            raise ValueError("a score needs cells of both kinds; all are of one")
        told = (self.map(x) > 0.5).reshape(-1).astype(np.int64)
        each = np.repeat(levels, truth[0].size)
        return score(y, told, each)


def fit(x: np.ndarray, truth: np.ndarray, levels: np.ndarray, *, seed: int = 0) -> CellProbe:
    """Fit logistic regression to the channels at all cells, with one set of weights.

    Args:
        x: Channels [N, C, H, W].
        truth: [N, H, W] bool.
        levels: [N], levels of the states; cells of each level count alike.
        seed: Seed of the cells that are drawn, if there are more than MOST.

    Raises:
        ImportError: If scikit-learn is not installed.
        ValueError: If the arrays do not go together, or `truth` holds everywhere or nowhere.
    """
    need_sklearn()
    from sklearn.linear_model import LogisticRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import StandardScaler

    _check(x, truth, levels)
    flat, y = np.moveaxis(x, 1, -1).reshape(-1, x.shape[1]), truth.reshape(-1)
    _, which, counts = np.unique(levels, return_inverse=True, return_counts=True)
    chance = np.repeat(1 / counts[which], truth[0].size)
    many = min(MOST, len(y))
    some = np.random.default_rng(seed).choice(len(y), many, replace=False, p=chance / chance.sum())
    if np.unique(y[some]).size < 2:
        raise ValueError(f"a probe needs cells of both kinds; all {many} drawn are of one")
    model = make_pipeline(
        StandardScaler(), LogisticRegression(class_weight="balanced", max_iter=FITS, C=0.1)
    )
    return CellProbe(model.fit(flat[some], y[some]))


def _check(x: np.ndarray, truth: np.ndarray, levels: np.ndarray) -> None:
    if x.ndim != 4 or truth.shape != (len(x), *x.shape[2:]) or len(levels) != len(x):
        raise ValueError(
            f"channels must be [N, C, H, W], the truth [N, H, W] and levels [N]; got {x.shape}, "
            f"{truth.shape} and {np.shape(levels)}"
        )
    if truth.dtype != np.bool_:
        raise ValueError(f"the truth must be bool; got {truth.dtype}")


def at_cells(agent: Model, variant: Variant, values: np.ndarray) -> np.ndarray:
    """Return a layer's channels at each cell of the world, [N, C, world, world], lowest row first.

    Args:
        values: Activations of a layer with places, [N, C, rows, columns].

    Raises:
        ValueError: If the layer has no places, or the agent sees only a part of the world.
    """
    world = int(variant.world)  # pyrefly: ignore
    both = [place(agent, variant, (k, k), values.shape[1:]) for k in range(world)]
    rows, columns = np.array(both).T
    return values[:, :, rows[:, None], columns]


def ahead(states: np.ndarray, world: int, cells: Cells | None = None) -> np.ndarray:
    """Return [N, world, world] bool: the cells that the agent steps on later in its episode.

    The cell where it is counts only if it comes back to it.

    Args:
        states: [N], of whole episodes. If they lack final states, as those of `critic.visit` do,
            the cell of the last step, such as the cheese's, is unknown and does not count.
        world: Cells a side.
        cells: Function of states that returns where the agent is, in cells; None for the states'
            own x and y.

    Raises:
        ValueError: If the states are not of whole episodes.
    """
    begins = beginnings_in(states)
    where = np.stack([states["x"], states["y"]], 1) if cells is None else cells(states)
    x, y = np.floor(where).astype(np.int64).T
    found = np.zeros((len(states), world, world), bool)
    for t in range(len(states) - 2, -1, -1):
        if not begins[t + 1]:
            found[t] = found[t + 1]
            moved = (x[t], y[t]) != (x[t + 1], y[t + 1])
            found[t, y[t + 1], x[t + 1]] |= moved
    return found
