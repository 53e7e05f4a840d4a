"""What networks are called. No torch here: most of the command line only needs names."""

from __future__ import annotations

from typing import Any

from astray import imports

# astray's own; what each builds is in `policy.BUILDERS`.
NETWORKS = (
    "impala", "impala-same", "mlp", "clear", "nature", "overlap", "patch", "patch-pooled",
    "patch-impala", "cells",
)  # fmt: skip
RENAMED = {"small": "mlp"}  # as older files have them, and what they are called now


def renamed_network(name: Any) -> Any:
    """Today's name of a network that an older file names; any other name as it is."""
    return RENAMED.get(name, name) if isinstance(name, str) else name


def check_network(name: str) -> None:
    """ValueError where no network can have that name."""
    if name not in NETWORKS and not imports.is_name(name):
        there = ", ".join(NETWORKS)
        raise ValueError(f"unknown network {name!r}; there are: {there}, and module:Class")
