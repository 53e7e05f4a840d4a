"""Rows of arrays, tensors and their nestings: a row per episode."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from astray.validation import shown


def rows(memory: Any, kept: np.ndarray) -> Any:
    """Return the rows `kept` [n] of a policy's memory [N, ...]."""
    if isinstance(memory, Mapping):
        return {name: rows(part, kept) for name, part in memory.items()}
    if isinstance(memory, tuple | list):
        parts = [rows(part, kept) for part in memory]
        return type(memory)(*parts) if hasattr(memory, "_fields") else type(memory)(parts)
    return None if memory is None else memory[kept]


def check_rows(memory: Any, n: int) -> None:
    """Raise ValueError unless a policy's memory has one row for each of `n` episodes."""
    if isinstance(memory, Mapping | tuple | list):
        for part in memory.values() if isinstance(memory, Mapping) else memory:
            check_rows(part, n)
    elif memory is not None and tuple(getattr(memory, "shape", ()))[:1] != (n,):
        raise ValueError(
            f"a policy's memory must be arrays or tensors of {n} rows, one per episode; got "
            f"{getattr(memory, 'shape', shown(memory))}"
        )
