"""Agents by name: those that come with astray, and those that the user imported.

Both are run folders with weights and a card, and nothing to train on.
"""

from __future__ import annotations

import os
from pathlib import Path

import platformdirs

from astray import agents

PRETRAINED = Path(agents.__path__[0]) / "pretrained"  # also in wheels


def folder() -> Path:
    """Where imported agents are: the environment's ASTRAY_AGENTS, else the user's data folder."""
    chosen = os.environ.get("ASTRAY_AGENTS")
    return Path(chosen) if chosen else platformdirs.user_data_path("astray", False) / "agents"


def names() -> list[str]:
    """The names of all pretrained agents."""
    return _names(PRETRAINED)


def imported() -> list[str]:
    """The names of all imported agents."""
    return _names(folder())


def find(name: str) -> Path:
    """Return the run folder of a pretrained or imported agent."""
    for home in (PRETRAINED, folder()):
        if name in _names(home):
            return home / name
    there = ", ".join([*names(), *imported()]) or "none yet"
    raise ValueError(f"unknown agent {name!r}; there are: {there}")


def name_of(run: Path) -> str:
    """Return the name of a pretrained or imported agent if `run` is one, else the path."""
    there = run.name in (*names(), *imported()) and find(run.name) == run
    return run.name if there else str(run)


def run_of(run: Path) -> Path:
    """`run`; or, where nothing is at that path and it is an agent's name, that agent's folder."""
    if not run.exists() and str(run) in (*names(), *imported()):
        return find(str(run))
    return run


def _names(home: Path) -> list[str]:
    return sorted(path.parent.name for path in home.glob("[!.]*/config.json"))
