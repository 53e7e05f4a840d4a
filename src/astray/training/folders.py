"""Folders of trained, pretrained, imported and pulled agents, and their names.

config.json: the settings of its training. README.md: the card of a kept, imported or pulled agent.
origin.json, hub.json: the source of an imported or pulled agent.
checkpoints/<steps>/agent.safetensors: its weights. checkpoints/<steps>/trainer.safetensors: all
other state of its training.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import platformdirs
from safetensors import SafetensorError
from safetensors.numpy import load as from_bytes

from astray import agents
from astray.files import check_writable, new_folder, read
from astray.training.config import SOLVER, Config
from astray.validation import finite, path_of, shown

PRETRAINED = Path(agents.__path__[0]) / "pretrained"  # also in wheels
CONFIG, CARD, ORIGIN, HUB = "config.json", "README.md", "origin.json", "hub.json"
AGENT, TRAINER = "agent.safetensors", "trainer.safetensors"
TEACHER, START = "teacher.safetensors", "start.safetensors"  # other agents' weights, beside it
DEVIATION = "reward_deviation"  # beside the settings of an agent that was kept
# Of discounted returns: mean, variance and count, in what a training goes on from.
MOMENTS = "training.moments"
LARGEST = 2**20  # bytes of a file of JSON
STEPS = re.compile(r"0|[1-9][0-9]{0,17}")  # names of checkpoints
RANDOM = "random"  # a policy, which verbs and verdicts find by its name
NAME = re.compile(r"(?!.{101})[a-z0-9]+(-[a-z0-9]+)*")


@dataclass(frozen=True)
class AgentFolder:
    """An agent in a folder, with access to everything that is known of it.

    Attributes:
        path: The folder.
        weights: File of one of its checkpoints.
    """

    path: Path
    weights: Path

    @classmethod
    def open(cls, agent: str | Path) -> AgentFolder:
        """Open the last agent of a run folder, one of its checkpoints, or a named agent.

        Raises:
            FileNotFoundError: If there is none.
        """
        run, name = path_of("an agent", agent), str(agent)
        if not run.exists() and name in names():
            run = find(name)
        if (run / CONFIG).exists():
            return cls(run, latest(run) / AGENT)
        for its in (run, Path(os.path.realpath(run))):  # links, and ".", have other parents
            if STEPS.fullmatch(its.name) and (its.parent.parent / CONFIG).exists():
                return cls(its.parent.parent, its / AGENT)
        found = "neither a run folder nor a checkpoint in one, named by its steps"
        if run.exists() or len(run.parts) != 1:
            raise FileNotFoundError(f"{run} is {found}")
        there = ", ".join(names()) or "none yet"
        raise FileNotFoundError(f"unknown agent {name!r}, which is {found}; there are: {there}")

    @classmethod
    def of(cls, weights: Path) -> AgentFolder:
        """Return the folder of a file of weights."""
        return cls(weights.parents[2], weights)

    @property
    def steps(self) -> int:
        return int(self.weights.parent.name)

    @property
    def is_older(self) -> bool:
        """Whether it is not the last checkpoint of its run."""
        return self.weights.parent.name != f"{max(steps_saved(self.path), default='')}"

    @property
    def card(self) -> Path:
        return self.path / CARD

    def config(self) -> Config:
        """Return the settings of its training, as `read_config` does."""
        return read_config(self.path)

    def noted(self) -> dict[str, Any]:
        """Return the contents of `config.json`: "config", and further entries."""
        return json.loads(read(self.path / CONFIG, LARGEST))

    def origin(self) -> dict[str, Any]:
        """Return the contents of an imported agent's `origin.json`.

        Raises:
            ValueError: If `published.imported.import_agent` did not write it.
        """
        told = ("file", "sha256", "format", "settings_told", "file_says")
        return read_json(self.path / ORIGIN, dict, told)

    def deviation(self) -> float | None:
        """Return the reward-normalisation scale at the checkpoint.

        It is None if rewards were not normalised or the scale is unknown, as that of values which
        a student learned from its teacher alone. The agent's values are in this unit. A training's
        last two checkpoints have it, and so do agents kept from one of them.
        """
        config = self.config()
        if not config.normalise_reward or config.learns_values_of_teacher:
            return None
        try:
            trainer = self.weights.with_name(TRAINER)
            deviation = _of_moments(trainer) if trainer.exists() else self.noted()[DEVIATION]
            finite(DEVIATION, deviation, 0)
        except (SafetensorError, OSError, TypeError, ValueError, KeyError):
            return None
        return deviation or None

    def digest(self) -> str:
        """Return the SHA-256 of its file of weights."""
        return hashlib.sha256(read(self.weights)).hexdigest()


def _of_moments(trainer: Path) -> float:
    from astray.training.ppo import RewardNormaliser  # here, as torch takes two seconds to import

    _, variance, _ = from_bytes(read(trainer))[MOMENTS].tolist()
    return float(1 / RewardNormaliser(1, clip=np.inf, variance=variance).scaled(np.ones(1))[0])


def read_config(run: Path) -> Config:
    """Return the settings of the run in a folder.

    Raises:
        FileNotFoundError: If there is no run.
        ValueError: If its settings cannot be read.
    """
    path = run / CONFIG
    try:
        return Config.from_json(read_json(path, dict, ("config",))["config"])
    except FileNotFoundError:
        raise FileNotFoundError(f"{run} is not a run: it has no {CONFIG}") from None
    except (ValueError, KeyError, TypeError, RecursionError, OverflowError) as error:
        said = str(error).replace(f"{path}", "it")
        if said.startswith("unknown game"):  # the shell knows the World of a run by its option
            said += "; a World of your own is --world module:WORLD, or astray.register(WORLD)"
        raise ValueError(f"{path} is not the settings of a run: {said}") from error


def read_json(path: Path, kind: type, names: Sequence[str] = ()) -> Any:
    """Return a JSON file's contents; raise ValueError unless it has this `kind` and `names`."""
    try:
        data = json.loads(read(path, LARGEST))
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not JSON: {error}") from error
    missing = [name for name in names if not isinstance(data, dict) or name not in data]
    if not isinstance(data, kind) or missing:
        raise ValueError(
            f"{path} must be a {kind.__name__} with {', '.join(names) or 'rows'}; got {shown(data)}"
        )
    return data


def steps_saved(folder: Path) -> list[int]:
    """Return the steps of all checkpoints, ascending."""
    found: list[Path] = []
    with contextlib.suppress(FileNotFoundError, NotADirectoryError):  # what may not be seen is told
        found = [*(folder / "checkpoints").iterdir()]
    return sorted(int(path.name) for path in found if STEPS.fullmatch(path.name) and path.is_dir())


def latest(folder: Path) -> Path:
    """Return the last checkpoint of the run in `folder`; raise FileNotFoundError without one."""
    steps = steps_saved(folder)
    if not steps:
        raise FileNotFoundError(f"{folder} has no checkpoint")
    return folder / "checkpoints" / f"{steps[-1]}"


def home() -> Path:
    """Return the folder of imported agents: ASTRAY_AGENTS, or in the user's data folder."""
    chosen = os.environ.get("ASTRAY_AGENTS")
    return Path(chosen) if chosen else platformdirs.user_data_path("astray", False) / "agents"


def pretrained() -> list[str]:
    """Return the names of the agents that come with astray."""
    return _names(PRETRAINED)


def imported() -> list[str]:
    """Return the names of all imported and pulled agents; none if the user has no home folder."""
    with contextlib.suppress(RuntimeError):
        return _names(home())
    return []


def names() -> list[str]:
    """Return the names of all named agents."""
    return [*pretrained(), *imported()]


def find(name: str) -> Path:
    """Return the run folder of a named agent; raise ValueError if there is none."""
    if name in pretrained():
        return PRETRAINED / name
    if name in imported():
        return home() / name
    raise ValueError(f"unknown agent {name!r}; there are: {', '.join(names()) or 'none yet'}")


def name_of(run: Path) -> str:
    """Return the name of the agent in a folder, or the path if it has none."""
    return run.name if run.name in names() and find(run.name) == run else str(run)


def check_new(name: str, *homes: Path) -> None:
    """Raise ValueError if a name is invalid or taken in `homes`, by default in all of them."""
    if not isinstance(name, str) or not NAME.fullmatch(name):
        raise ValueError(
            f"an agent's name must be of a-z, 0-9 and -, at most 100; got {shown(name)}"
        )
    if name in (RANDOM, SOLVER):
        raise ValueError(f"an agent's name must be no policy's or teacher's; got {name!r}")
    for one in homes or (PRETRAINED, home()):
        if f"{one}" != f"{one}".encode(errors="replace").decode():  # tables have its path
            raise ValueError(f"a folder of agents must have a name in UTF-8; got {shown(f'{one}')}")
        if (one / name).exists():
            raise ValueError(f"there is an agent {name!r} already, in {one / name}")


@contextlib.contextmanager
def made(home: Path, name: str) -> Iterator[Path]:
    """Yield a `new_folder` for `home`/`name`."""
    check_new(name, home)
    check_writable(home / name)
    try:
        with new_folder(home / name) as aside:
            yield aside
    except OSError:
        check_new(name, home)  # somebody was faster
        raise


def _names(home: Path) -> list[str]:
    with contextlib.suppress(PermissionError):  # of another user, whose home folder is closed
        return sorted(path.parent.name for path in home.glob(f"[!.]*/{CONFIG}"))
    return []
