"""Logs of a training: metrics.jsonl, TensorBoard, a progress bar."""

from __future__ import annotations

import json
import reprlib
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from astray.files import read, write_aside
from astray.training.config import Config

METRICS, BOARD = "metrics.jsonl", "tensorboard"  # in the run folder
EVERY = 30  # seconds between progress lines if standard error is not a terminal
BEGINNING = '{"steps": '  # prefix of each of its lines


def read_metrics(path: Path) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield each complete line of a metrics.jsonl with its parsed values.

    Raises:
        ValueError: If `Log` did not write a line; the message has its number.
    """
    try:
        lines = read(path).decode().splitlines(keepends=True)
    except UnicodeDecodeError as error:
        raise ValueError(f"{path} is not text: {error}") from error
    for number, line in enumerate(lines, 1):
        if line.endswith("\n"):
            try:
                yield line, measured(line)
            except ValueError as error:
                raise ValueError(f"{path}, line {number}: {error}") from error
        elif not (line.startswith(BEGINNING) or BEGINNING.startswith(line)):
            raise ValueError(f"{path}, line {number}: a training did not write it")


def measured(line: str | bytes) -> dict[str, Any]:
    """Parse a line of a metrics.jsonl; raise ValueError if it is not one of `Log`'s."""
    try:
        data = json.loads(line)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"it is not JSON: {error}") from error
    if not isinstance(data, dict) or type(data.get("steps")) is not int or data["steps"] < 0:
        raise ValueError(f"it must be an object with a number of steps; got {reprlib.repr(data)}")
    for name, value in data.items():
        if type(value) not in (int, float):
            raise ValueError(f"{name} must be a number; got {reprlib.repr(value)}")
    return data


class Log:
    """Log with one line per iteration; lines of a killed run after `steps` are dropped."""

    def __init__(self, folder: Path, steps: int, config: Config, progress: bool):
        from torch.utils.tensorboard import SummaryWriter  # a second to import

        path = folder / METRICS
        there = read_metrics(path) if path.exists() else ()
        kept = [line for line, data in there if data["steps"] <= steps]
        write_aside(path, "".join(kept).encode())
        self._file = open(path, "a")  # noqa: SIM115
        self._board = SummaryWriter(str(folder / BOARD), purge_step=steps + 1)
        columns = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[text]}")
        console = Console(stderr=True)
        self._in_lines, self._told = progress and not console.is_terminal, time.monotonic()
        shown = progress and console.is_terminal
        self._bar = Progress(*columns, TimeRemainingColumn(), console=console, disable=not shown)
        self._name = f"{config.game} {config.variant} seed {config.seed}"
        total = config.iterations * config.batch
        if progress and total > 1.01 * config.steps:
            told = f"{self._name}: {total:,} steps, as rollouts of {config.batch:,} are whole"
            print(told, file=sys.stderr, flush=True)
        self._task = self._bar.add_task(self._name, total=total, completed=steps, text="")
        self._bar.start()

    def write(self, steps: int, values: dict[str, float], speed: dict[str, float]) -> None:
        """Write reproducible `values` to metrics.jsonl; `speed` is only shown."""
        self._file.write(json.dumps({"steps": steps, **values}) + "\n")
        self._file.flush()
        for name, value in (values | {f"speed/{k}": v for k, v in speed.items()}).items():
            self._board.add_scalar(name, value, steps)
        text = f"{steps:,} steps  {speed['steps_per_second']:,.0f}/s"
        if "training/return" in values:
            text += f"  return {values['training/return']:z.2f}"
        elif "training/reward_per_step" in values:
            text += f"  reward {values['training/reward_per_step']:z.3f} a step"
        self._bar.update(self._task, completed=steps, text=text)
        if self._in_lines and time.monotonic() - self._told >= EVERY:
            self._told = time.monotonic()
            print(f"{self._name}: {text}", file=sys.stderr, flush=True)

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()
        self._board.close()
        self._file.close()
