"""External trackers in addition to TensorBoard: Weights & Biases (wandb) and Trackio.

They receive the settings, the metrics of every iteration, and finally videos and tables. Their own
settings decide where the data goes: `WANDB_MODE=offline` for wandb; Trackio stays on this machine
unless it is given a Space.
"""

import contextlib
import json
import os
import uuid
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

from astray import imports
from astray.files import read, write_aside
from astray.training import checkpoint, parallel
from astray.training.config import Config, Tracking
from astray.training.loop import Iteration, iterate
from astray.validation import one_of

PROJECT = "astray"
IDS = "track.json"  # in the run folder: its ids in the trackers, for resuming
LARGEST = 10_000  # bytes of it
ROWS = 10_000  # of a table, at most


class Tracker:
    """One run of a tracker. Values that it refuses are reported once in a warning and are harmless.

    Raises:
        ImportError: If the tracker is not installed.
        RuntimeError: If it cannot begin.
    """

    def __init__(self, by: Tracking, name: str, folder: Path, settings: Mapping[str, Any]):
        check_installed(by)
        self.by, self._warned = by, False
        begin = _begin_wandb if by == "wandb" else _begin_trackio
        with _beginning(by):
            self._run, self._library = begin(name, folder, settings)

    def log(self, steps: int, values: Mapping[str, Any]) -> None:
        """Log `values` by name after `steps` environment steps."""

        def tell() -> None:
            if self.by == "wandb":
                self._run.log({"steps": steps, **values})
            else:
                self._run.log(dict(values), step=steps)

        self._safely(tell)

    def video(self, steps: int, name: str, path: Path) -> None:
        """Log a video, an .mp4 or .gif file."""
        self._media(steps, name, lambda: self._library.Video(str(path), format=path.suffix[1:]))

    def picture(self, steps: int, name: str, path: Path) -> None:
        """Log a picture, a .png file."""
        self._media(steps, name, lambda: self._library.Image(str(path)))

    def table(
        self, steps: int, name: str, columns: Sequence[str], rows: Sequence[Sequence[Any]]
    ) -> None:
        """Log the first 10,000 rows of a table."""
        data = [list(row) for row in rows[:ROWS]]
        self._media(steps, name, lambda: self._library.Table(columns=list(columns), data=data))

    def finish(self) -> None:
        """End the run after everything is written."""
        self._safely(self._run.finish)

    def _media(self, steps: int, name: str, make: Callable[[], Any]) -> None:
        self._safely(lambda: self.log(steps, {name: make()}))

    def _safely(self, tell: Callable[[], None]) -> None:
        try:
            tell()
        except Exception as error:  # no tracker's error may end a training of hours
            if not self._warned:
                warnings.warn(f"{self.by} did not take something: {error}", stacklevel=4)
            self._warned = True


def check_installed(by: Tracking) -> None:
    """Raise ImportError if a tracker is not installed, and RuntimeError if it has no login."""
    one_of("tracker", by, Tracking)
    with imports.extra("track", f"{by} is not installed"):
        library: Any = import_module(by)
    if by == "wandb" and os.environ.get("WANDB_MODE", "online") == "online":
        with _beginning(by):
            library.login()


@contextlib.contextmanager
def _beginning(by: Tracking) -> Iterator[None]:
    try:
        yield
    except Exception as error:
        raise RuntimeError(f"{by} cannot track this run: {error}") from error


def train_tracked(
    config: Config,
    folder: Path,
    track: Tracking | None = None,
    *,
    progress: bool = True,
    wait: bool = False,
) -> Path:
    """Train as `loop.train` does, with a tracker; return the last checkpoint."""
    told = track if parallel.first() else None
    iterations = iterate(config, folder, progress=progress, wait=wait)
    for _ in tracked(iterations, told, config, folder) if told else iterations:
        pass
    return checkpoint.latest(folder)


def tracked(
    iterations: Iterable[Iteration], by: Tracking, config: Config, folder: Path
) -> Iterator[Iteration]:
    """Yield the iterations of a training and log each with a tracker."""
    tracker = None
    check_installed(by)
    try:
        for iteration in iterations:
            if tracker is None:  # only now is the folder known to be this run's
                tracker = Tracker(by, label(config), folder, config.to_json())
            speed = {f"speed/{name}": value for name, value in iteration.speed.items()}
            tracker.log(iteration.steps, {**iteration.metrics, **speed})
            yield iteration
    finally:
        if tracker:
            tracker.finish()


def label(config: Config) -> str:
    """Return a run's name for trackers."""
    return f"{config.game}-{config.variant}-seed-{config.seed}"


def _begin_wandb(name: str, folder: Path, settings: Mapping[str, Any]) -> tuple[Any, Any]:
    import wandb  # pyrefly: ignore

    run = wandb.init(
        project=os.environ.get("WANDB_PROJECT", PROJECT),
        name=name,
        id=_id(folder, "wandb"),
        resume="allow",
        config=dict(settings),
        dir=str(folder),
        settings=wandb.Settings(console="off", quiet=True),
    )
    run.define_metric("*", step_metric="steps")  # a resumed run may tell of steps again
    return run, wandb


def _begin_trackio(name: str, folder: Path, settings: Mapping[str, Any]) -> tuple[Any, Any]:
    import trackio  # pyrefly: ignore

    run = trackio.init(
        project=PROJECT,
        name=f"{name}-{_id(folder, 'trackio')[:6]}",
        resume="allow",
        config=json.loads(json.dumps(settings)),
        embed=False,
        auto_log_cpu=False,
    )
    return run, trackio


def _id(folder: Path, by: str) -> str:
    """Return the id by which a tracker knows the run of a folder."""
    path = folder / IDS
    try:
        ids = json.loads(read(path, LARGEST)) if path.exists() else {}
        if not isinstance(ids, dict) or not all(isinstance(x, str) for x in ids.values()):
            raise ValueError("it must map names to texts")
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path} is not as astray writes it: {error}") from error
    if by not in ids:
        ids[by] = uuid.uuid4().hex[:12]
        write_aside(path, json.dumps(ids).encode())
    return ids[by]
