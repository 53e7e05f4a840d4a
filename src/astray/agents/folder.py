"""The folder of an agent, whether trained here, pretrained, imported or pulled.

config.json                             the settings of its training
README.md                               its card, of an agent that was kept, imported or pulled
origin.json, hub.json                   where it came from, if it was brought from elsewhere
checkpoints/<steps>/agent.safetensors   its weights
checkpoints/<steps>/trainer.safetensors what else its training needs to go on
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from astray.bounds import shown
from astray.files import folder_aside, read

CONFIG, CARD, ORIGIN, HUB = "config.json", "README.md", "origin.json", "hub.json"
AGENT, TRAINER = "agent.safetensors", "trainer.safetensors"
DEVIATION = "reward_deviation"  # beside the settings of an agent that was kept
LARGEST_CONFIG = 2**20  # bytes
STEPS = re.compile(r"0|[1-9][0-9]{0,17}")  # names of checkpoints
NAME = re.compile(r"[a-z0-9]+(-[a-z0-9]+)*")


@dataclass(frozen=True)
class AgentFolder:
    """An agent in a folder: where all that is known of it lies.

    path     of the folder
    weights  the file of one of its checkpoints
    """

    path: Path
    weights: Path

    @classmethod
    def open(cls, run: str | Path) -> AgentFolder:
        """Return the last agent of a run folder, or that of a checkpoint in one.

        Raises FileNotFoundError where there is none.
        """
        run = Path(run)
        if (run / CONFIG).exists():
            return cls(run, latest(run) / AGENT)
        if not (run.parent.parent / CONFIG).exists():
            raise FileNotFoundError(f"{run} is neither a run folder nor a checkpoint in one")
        return cls(run.parent.parent, run / AGENT)

    @classmethod
    def of(cls, weights: Path) -> AgentFolder:
        """Return the folder that a file of weights lies in."""
        return cls(weights.parents[2], weights)

    @property
    def steps(self) -> int:
        return int(self.weights.parent.name)

    @property
    def is_foreign(self) -> bool:
        """Whether it was imported or pulled."""
        return (self.path / ORIGIN).exists() or (self.path / HUB).exists()

    def settings(self) -> dict[str, Any]:
        """Return what `config.json` holds: "config", and what was noted beside it."""
        return json.loads(read(self.path / CONFIG, LARGEST_CONFIG))

    def digest(self) -> str:
        """Return the SHA-256 of its weights' file."""
        return hashlib.sha256(read(self.weights)).hexdigest()


def steps_saved(folder: Path) -> list[int]:
    """The steps of all checkpoints, ascending."""
    found = (path for path in (folder / "checkpoints").glob("[0-9]*") if path.is_dir())
    return sorted(int(path.name) for path in found if STEPS.fullmatch(path.name))


def latest(folder: Path) -> Path:
    """The last checkpoint of the run in `folder`."""
    steps = steps_saved(folder)
    if not steps:
        raise FileNotFoundError(f"{folder} has no checkpoint")
    return folder / "checkpoints" / f"{steps[-1]}"


def see_new(name: str, *homes: Path) -> None:
    """ValueError where this is no name of an agent, or one of `homes` has an agent of that name."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise ValueError(
            f"an agent's name must be of a-z, 0-9 and -, as maze-corner; got {shown(name)}"
        )
    for home in homes:
        if (home / name).exists():
            raise ValueError(f"there is an agent {name!r} already, in {home / name}")


@contextlib.contextmanager
def made(home: Path, name: str) -> Iterator[Path]:
    """A new folder that becomes `home`/`name` when it is whole; nothing is left if it was not."""
    see_new(name, home)
    with folder_aside(home / name) as aside:
        yield aside
        try:
            os.replace(aside, home / name)
        except OSError:
            see_new(name, home)  # somebody was faster
            raise
