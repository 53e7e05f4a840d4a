"""Agents that come with astray: run folders with weights and a card, and nothing to train on."""

from __future__ import annotations

from pathlib import Path

from astray import agents

KEPT = Path(agents.__path__[0]) / "kept"  # in the package, so that checkouts and wheels have it


def names() -> list[str]:
    """The names of all kept agents."""
    return sorted(path.parent.name for path in KEPT.glob("*/config.json"))


def find(name: str) -> Path:
    """The run folder of a kept agent."""
    if name not in names():
        raise ValueError(f"unknown agent {name!r}; there are: {', '.join(names()) or 'none yet'}")
    return KEPT / name
