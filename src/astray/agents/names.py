"""Names of networks. Without torch, since most of the command line needs only names."""

import re
from typing import Any

from astray import imports

# astray's own; what each builds is in `policy.BUILDERS`.
NETWORKS = (
    "impala", "impala-same", "impala-rectified", "mlp", "clear", "nature", "overlap", "patch",
    "patch-pooled", "patch-impala", "strided-impala", "cells", "drc",
)  # fmt: skip
CELLS = ("gru", "lstm")  # that any of them can have on top, as in "mlp+gru"


def depth_and_ticks(name: str) -> tuple[int, int] | None:
    """Return D and N of a network "drc-D-N", 3 and 3 of "drc", and None for others."""
    found = re.fullmatch(r"drc(?:-([1-9])-([1-9]))?", name)
    return found and (int(found[1] or 3), int(found[2] or 3))


def is_own(name: Any) -> bool:
    """Return whether a network of that name is one of astray's own."""
    if not isinstance(name, str):
        return False
    body, plus, cell = name.partition("+")
    if depth_and_ticks(body):
        return not plus  # it has a memory of its own
    return body in NETWORKS and (cell in CELLS if plus else True)


def check_network(name: str) -> None:
    """Raise ValueError unless a network can have that name."""
    if not is_own(name) and not imports.is_name(name):
        there, cells = ", ".join(NETWORKS), " or ".join(f"+{cell}" for cell in CELLS)
        raise ValueError(
            f"unknown network {name!r}; there are: {there}, each but drc with {cells} for memory, "
            "drc-D-N with its depth and ticks, and module:Class"
        )
