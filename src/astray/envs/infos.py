"""Gymnasium's vector infos: columns of the states, each with a mask."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from astray.envs import loops

Info = dict[str, Any]


class Columns:
    """Reader of some fields of `states` as a Gymnasium vector info.

    In a large batch some episode ends at every second step, and NumPy reads single fields of
    records slowly. Integer fields are therefore copied together, by their offsets.
    """

    def __init__(self, states: np.ndarray, names: Sequence[str]):
        fields: Any = states.dtype.fields
        self.integers = [name for name in names if fields[name][0] == np.int64]
        self.places = np.array([fields[name][1] // 8 for name in self.integers])
        self.words = states.view(np.int64).reshape(len(states), -1)
        self.flags = {name: states[name] for name in names if fields[name][0] == np.bool_}
        assert len(self.integers) + len(self.flags) == len(names), "fields of other types"
        self.masks = [f"_{name}" for name in names]

    def __call__(self, which: np.ndarray) -> Info:
        """Return columns [N], 0 outside of `which` [N] bool, and `which` as "_name" of each."""
        columns = np.zeros((len(self.places), len(which)), np.int64)
        loops.fill(columns, self.words, self.places, which)
        info: Info = dict(zip(self.integers, columns, strict=True))
        info |= {name: which & flag for name, flag in self.flags.items()}
        return info | dict.fromkeys(self.masks, which)


def merged(one: Info, two: Info) -> Info:
    """Merge two vector infos about different environments."""
    if not one:
        return two
    both = dict(two)
    for name in (n for n in one if not n.startswith("_")):
        both[name] = np.where(one[f"_{name}"], one[name], two[name])
        both[f"_{name}"] = one[f"_{name}"] | two[f"_{name}"]
    return both


def objects(rows: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Return an object array [N] of the `rows` [N, ...] in `which` [N] bool, None elsewhere."""
    result = np.empty(len(rows), object)
    for i in np.flatnonzero(which):
        result[i] = rows[i].copy()
    return result
