"""What a training tells: metrics.jsonl, TensorBoard, a progress bar."""

from __future__ import annotations

import json
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from astray.files import read, write_aside
from astray.training.config import Config


class Log:
    """Writes one line per iteration; lines after `steps`, of a run that was killed, are dropped."""

    def __init__(self, folder: Path, steps: int, config: Config, progress: bool):
        from torch.utils.tensorboard import SummaryWriter  # a second to import

        path = folder / "metrics.jsonl"
        lines = read(path).decode().splitlines(keepends=True) if path.exists() else []
        kept = [
            line for line in lines if line.endswith("\n") and json.loads(line)["steps"] <= steps
        ]
        write_aside(path, "".join(kept).encode())
        self._file = open(path, "a")  # noqa: SIM115
        self._board = SummaryWriter(str(folder / "tensorboard"), purge_step=steps)
        columns = (
            TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[text]}"),
            TimeRemainingColumn(),
        )  # fmt: skip
        self._bar = Progress(*columns, console=Console(stderr=True), disable=not progress)
        name = f"{config.game} {config.variant} seed {config.seed}"
        self._task = self._bar.add_task(name, total=config.iterations * config.batch,
                                        completed=steps, text="")  # fmt: skip
        self._bar.start()

    def write(self, steps: int, values: dict[str, float], speed: dict[str, float]) -> None:
        """`values` are reproducible and go to metrics.jsonl; `speed` is shown, not kept."""
        self._file.write(json.dumps({"steps": steps, **values}) + "\n")
        self._file.flush()
        for name, value in (values | {f"speed/{k}": v for k, v in speed.items()}).items():
            self._board.add_scalar(name, value, steps)
        text = f"{steps:,} steps  {speed['steps_per_second']:,.0f}/s"
        if "training/return" in values:
            text += f"  return {values['training/return']:.2f}"
        self._bar.update(self._task, completed=steps, text=text)

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *error: object) -> None:
        self._bar.stop()
        self._board.close()
        self._file.close()
