"""Checkpoints of a run folder, written so that a kill loses nothing.

config.json: all settings, versions, a digest of the sources. metrics.jsonl: one line per
iteration. checkpoints/<steps>/agent.safetensors: the network (`agents.policy.load` reads it).
checkpoints/<steps>/trainer.safetensors: all other state of the training.
"""

import contextlib
import json
import logging
import os
import platform
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import gymnasium
import numba
import numpy as np
import torch
from filelock import Timeout
from safetensors import SafetensorError
from safetensors.torch import save as to_bytes

from astray import files, provenance
from astray.agents import policy
from astray.training import parallel
from astray.training.config import Config
from astray.training.folders import AGENT, CONFIG, STEPS, TRAINER, latest, read_config, steps_saved
from astray.training.log import BOARD, METRICS, read_metrics
from astray.training.teacher import TEACHER, give
from astray.training.trainer import Trainer
from astray.validation import brief

LOG = logging.getLogger("astray")
EDITED = "%s was begun with other code, of astray or your own; a new folder has this code alone"


class Claimed(RuntimeError):
    """Another process is training in the run folder."""


@contextlib.contextmanager
def teaching(weights: Path, run: Path) -> Iterator[None]:
    """Give the teacher's weights, and remove those that are new if no process begins to train."""
    made, is_new = files.make_folder(run), not (run / TEACHER).exists()
    give(weights, run)
    try:
        yield
    except BaseException as error:
        if is_new and not isinstance(error, Claimed) and not (run / CONFIG).exists():
            (run / TEACHER).unlink(missing_ok=True)
            files.remove_made(made)
        raise


@contextlib.contextmanager
def claim(folder: Path, config: Config, wait: bool = False) -> Iterator[None]:
    """Lock the run folder for this process and check that it has this configuration.

    If several processes train one agent, the first holds the lock for all.

    Raises:
        Claimed: If another process trains in it and `wait` is False.
        ValueError: If it holds a run with other settings.
        OSError: If it cannot be written.
    """
    if not parallel.first():
        parallel.wait()
        yield
        return
    path, there = folder / CONFIG, folder / "checkpoints"
    found = None
    with contextlib.ExitStack() as held:
        try:
            held.enter_context(files.hold(folder, "is training in", wait))
        except Timeout:
            raise Claimed(f"another process is training in {folder}") from None
        except OSError as error:
            raise OSError(f"no run can be kept in {folder}: {error}") from error
        try:
            _check_folders(there, config)
            for name in (path.name, METRICS):  # a link would be replaced, or what it leads to
                files.check_own(folder / name)
            versions = {
                "python": platform.python_version(), "torch": torch.__version__,
                "numpy": np.__version__, "numba": numba.__version__,
                "gymnasium": gymnasium.__version__,
                "sources": provenance.digest(Trainer, config.code()),
            }  # fmt: skip
            if path.exists():
                check(folder, config)
                before = json.loads(files.read(path)).get("versions")
                if isinstance(before, dict) and before.get("sources") != versions["sources"]:
                    LOG.warning(EDITED, folder)
            else:
                data = {"config": config.to_json(), "versions": versions}
                found = _written(folder)
                files.write_aside(path, json.dumps(data, indent=2).encode())
            files.remove_left(folder, (path.name, METRICS))
            files.remove_left(there, (AGENT, TRAINER))
            parallel.wait()
            yield
        except BaseException:
            # One that was refused, as for its memory, leaves nothing that another would be held to.
            if found == _written(folder):
                path.unlink(missing_ok=True)
            raise


def _written(folder: Path) -> tuple[list[int], int]:
    """Return what a training writes: the steps of checkpoints, and the bytes of metrics.jsonl."""
    metrics = folder / METRICS
    return steps_saved(folder), metrics.stat().st_size if metrics.exists() else 0


def _check_folders(there: Path, config: Config) -> None:
    """Raise OSError if a training could not write its checkpoints to `there`, or its log."""
    named = (path for path in there.glob("*") if STEPS.fullmatch(path.name))
    mine = (one for one in named if int(one.name) % config.batch == 0)
    for path in (there, there.with_name(BOARD), *mine):
        if os.path.lexists(path) and not path.is_dir():  # as a link to a disk that is not there
            raise NotADirectoryError(f"{path} must be a folder, or not be there")
    if there.exists():  # it may be another user's, or lead to a disk that is only read
        files.check_writable(there / AGENT)


def check(folder: Path, config: Config) -> None:
    """Raise ValueError unless the run in `folder` has these settings."""
    _compare(read_config(folder), config, f"{folder} holds a run with other settings")


def check_all(runs: Mapping[Path, Config]) -> None:
    """Raise as `claim` does if a training could not begin in its folder, before the first does.

    Raises:
        OSError: If it could not write its checkpoints.
    """
    for run, config in runs.items() if parallel.first() else ():
        files.check_writable(run / CONFIG)
        _check_folders(run / "checkpoints", config)
        if (run / CONFIG).exists():
            check(run, config)


def _compare(there: Config, here: Config, what: str) -> None:
    """Raise ValueError if two trainings would differ."""
    one, two = (json.loads(json.dumps(c.identity())) for c in (there, here))
    differ = [f"{n} is {one[n]!r} there, {two[n]!r} here" for n in two if one[n] != two[n]]
    if differ:
        raise ValueError(f"{what}: {', '.join(differ)}")


@policy.defaults("cpu")
def save(folder: Path, trainer: Trainer) -> None:
    """Write a checkpoint; of older ones keep the last two, and the agents of milestones."""
    there, game = folder / "checkpoints", trainer.config.game
    tensors = {name: tensor.contiguous() for name, tensor in trainer.tensors().items()}
    header = policy.header(game, config=trainer.config.to_json())
    if not parallel.first():
        return
    with files.folder_aside(final := there / f"{trainer.steps}") as aside:
        files.write_aside(
            aside / AGENT, policy.weights(trainer.network, trainer.architecture, game)
        )
        files.write_aside(aside / TRAINER, to_bytes(tensors, header))
        os.replace(aside, final)
    saved = steps_saved(folder)
    firsts = {next((s for s in saved if s >= m), None) for m in trainer.config.milestones}
    for old in saved[:-2]:
        if not files.holds_only(place := there / f"{old}", (AGENT, TRAINER)):
            continue  # it leads elsewhere, or the user keeps something in it
        with contextlib.suppress(PermissionError):  # Windows, while it is read: so the next time
            if old in firsts:
                (place / TRAINER).unlink(missing_ok=True)
            else:
                os.replace(place, files.aside_of(place))  # at once: a kill may leave half of it
                files.remove_left(there, (AGENT, TRAINER))


def restore(folder: Path, trainer: Trainer) -> None:
    """Restore the last checkpoint into `trainer`, if any; raise ValueError if it is damaged."""
    if not (saved := steps_saved(folder)):
        return
    config, path = trainer.config, latest(folder)
    _check_metrics(folder, saved[-1])
    policy.load_into(trainer.network, path / AGENT, config.game)
    try:
        tensors, header = policy.read_tensors(path / TRAINER, config.game)
        saved = Config.from_json(header["config"])
        _compare(saved, config, "it is of another run")
        if saved.device != config.device:  # which has no use for the other's random states
            for name, player in trainer.players().items():
                tensors[f"{name}.generator"] = player.reseeded(int(path.name))
        trainer.restore(tensors)
        if path.name != f"{trainer.steps}":
            raise ValueError(f"it is of step {trainer.steps}")
    except (SafetensorError, OSError, KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{path / TRAINER} cannot be resumed from: {brief(error)}") from error


def finished(folder: Path, config: Config) -> bool:
    """Return whether a run is complete; raise ValueError for other settings or lost metrics."""
    steps = steps_saved(folder)
    if steps:
        check(folder, config)
        _check_metrics(folder, steps[-1])
    return bool(steps) and steps[-1] >= config.iterations * config.batch


def _check_metrics(folder: Path, steps: int) -> None:
    """Raise ValueError if metrics.jsonl ends before the last checkpoint: its lines come first.

    Log a warning if it was deleted.
    """
    if not (path := folder / METRICS).exists():
        LOG.warning("%s is missing: this training has no curve up to step %d", path, steps)
    else:
        last = max((line["steps"] for line in metrics(folder)), default=0)
        if last < steps:
            raise ValueError(
                f"{path} ends at step {last:,}, and the last checkpoint is of step {steps:,}; "
                f"remove {folder}, and it is trained again"
            )


def metrics(folder: Path) -> list[dict[str, Any]]:
    """Return the complete lines of metrics.jsonl."""
    return [measured for _, measured in read_metrics(folder / METRICS)]
