"""Validation of the arguments of analyses, before anything is played."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping

import numpy as np
import polars as pl

from astray.bounds import of_kind, shown

Measure = Callable[[np.ndarray], np.ndarray]  # states [N] -> numbers [N]


def check_measures(measures: Mapping[str, Measure] | None, taken: Collection[str]) -> None:
    """Raise ValueError unless `measures` are functions by names that no column has."""
    if measures is None:
        return
    of_kind("measures", measures, Mapping)
    for name, measure in measures.items():
        if not isinstance(name, str) or not callable(measure):
            raise ValueError(
                f"measures must be functions of states by name; got {shown(name)}: {shown(measure)}"
            )
        if name in taken:
            raise ValueError(f"measures have the names of other columns: {name}")


def measured(name: str, measure: Measure, states: np.ndarray) -> pl.Series:
    """Apply a measure to `states` [N]; raise ValueError unless it returns N values."""
    values = measure(states)
    if np.shape(values) != (len(states),):
        raise ValueError(
            f"the measure {name!r} must return {len(states)} values, one of each state; got "
            f"{shown(values)}"
        )
    return pl.Series(name, values)
