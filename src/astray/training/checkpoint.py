"""A run's folder: what is written, when a kill loses nothing, and how it is read back.

config.json              all settings, versions, a digest of the sources
metrics.jsonl            a line per iteration
checkpoints/<steps>/     agent.safetensors: the network (`agents.policy.load` reads it);
                         trainer.safetensors: all else that training needs to go on
"""

from __future__ import annotations

import contextlib
import json
import os
import platform
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium
import numba
import numpy as np
import torch
from filelock import FileLock, Timeout
from safetensors import SafetensorError
from safetensors.torch import load as from_bytes
from safetensors.torch import save as to_bytes

from astray.agents import policy
from astray.kernel.jit import source_digest
from astray.training.config import Config
from astray.training.trainer import Trainer

AGENT, TRAINER = "agent.safetensors", "trainer.safetensors"


@contextlib.contextmanager
def claim(folder: Path, config: Config) -> Iterator[None]:
    """Hold the run folder for this process alone, and see that it is this configuration's."""
    folder.mkdir(parents=True, exist_ok=True)
    lock = FileLock(folder / ".lock", timeout=0)
    try:
        lock.acquire()
    except Timeout:
        raise RuntimeError(f"another process is training in {folder}") from None
    try:
        for left in (folder / "checkpoints").glob(".*"):  # of a save that was killed
            shutil.rmtree(left, ignore_errors=True)
        path = folder / "config.json"
        if path.exists():
            check(folder, config)
        else:
            versions = {
                "python": platform.python_version(), "torch": torch.__version__,
                "numpy": np.__version__, "numba": numba.__version__,
                "gymnasium": gymnasium.__version__, "sources": source_digest(("**/*.py",)),
            }  # fmt: skip
            data = {"config": config.to_json(), "versions": versions}
            write_aside(path, json.dumps(data, indent=2).encode())
        yield
    finally:
        lock.release()


def check(folder: Path, config: Config) -> None:
    """See that the run in `folder` has these settings."""
    read_config(folder)
    there = json.loads((folder / "config.json").read_text())["config"]
    given = json.loads(json.dumps(config.to_json()))
    differ = [name for name in given if there.get(name) != given[name]]
    if differ:
        what = ", ".join(f"{n} is {there.get(n)!r} there, {given[n]!r} here" for n in differ)
        raise ValueError(f"{folder} holds a run with other settings: {what}")


def read_config(folder: Path) -> Config:
    """The settings of the run in `folder`."""
    path = folder / "config.json"
    try:
        return Config.from_json(json.loads(path.read_text())["config"])
    except FileNotFoundError:
        raise FileNotFoundError(f"{folder} is not a run: it has no config.json") from None
    except (ValueError, KeyError, TypeError) as error:
        raise ValueError(f"{path} is not the settings of a run: {error}") from error


def write_aside(path: Path, data: bytes) -> None:
    """Write `data` to `path` so that a kill leaves the old file or the new one, whole."""
    aside = path.with_name(f".{path.name}")
    with open(aside, "wb") as file:
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    os.replace(aside, path)


def save(folder: Path, trainer: Trainer) -> None:
    """Write a checkpoint; of those before the last two keep the agents of milestones alone."""
    there = folder / "checkpoints"
    aside, final = there / f".{trainer.steps}", there / f"{trainer.steps}"
    aside.mkdir(parents=True, exist_ok=True)
    write_aside(aside / AGENT, policy.weights(trainer.network, trainer.architecture))
    tensors = {name: tensor.contiguous() for name, tensor in trainer.tensors().items()}
    write_aside(aside / TRAINER, to_bytes(tensors))
    os.replace(aside, final)
    saved = steps_saved(folder)
    firsts = {next((s for s in saved if s >= m), None) for m in trainer.config.milestones}
    for old in saved[:-2]:
        if old in firsts:
            (there / f"{old}" / TRAINER).unlink(missing_ok=True)
        else:
            shutil.rmtree(there / f"{old}")


def steps_saved(folder: Path) -> list[int]:
    """The steps of all checkpoints, ascending."""
    return sorted(int(p.name) for p in (folder / "checkpoints").glob("[0-9]*"))


def latest(folder: Path) -> Path:
    """The last checkpoint of the run in `folder`."""
    steps = steps_saved(folder)
    if not steps:
        raise FileNotFoundError(f"{folder} has no checkpoint")
    return folder / "checkpoints" / f"{steps[-1]}"


def restore(folder: Path, trainer: Trainer) -> None:
    """Bring `trainer` to the last checkpoint, if there is one."""
    if not steps_saved(folder):
        return
    path = latest(folder)
    network, _ = policy.load(path / AGENT)
    trainer.network.load_state_dict(network.state_dict())
    try:
        # From bytes: a mapped file could not be deleted on Windows while it is in use.
        trainer.restore(from_bytes((path / TRAINER).read_bytes()))
    except (SafetensorError, OSError, KeyError, ValueError, RuntimeError) as error:
        raise ValueError(f"{path / TRAINER} cannot be resumed from: {error}") from error


def finished(folder: Path, config: Config) -> bool:
    """The run in `folder` has its last checkpoint; it is an error if its settings are others."""
    steps = steps_saved(folder)
    if steps:
        check(folder, config)
    return bool(steps) and steps[-1] >= config.iterations * config.batch


def metrics(folder: Path) -> list[dict[str, Any]]:
    """The lines of metrics.jsonl."""
    return [json.loads(line) for line in (folder / "metrics.jsonl").read_text().splitlines()]
