"""All attempts, from the modules of all classes."""

from __future__ import annotations

from importlib import import_module

from attack.core import Attempt

MODULES = (
    "loss", "loss_api", "loss_anew", "compiled", "records", "endless", "arguments", "settings",
    "readers", "places", "functions", "taken", "trust", "names", "together",
)  # fmt: skip


def attempts() -> list[Attempt]:
    """Every attempt there is."""
    return [one for name in MODULES for one in import_module(f"attack.{name}").attempts()]
