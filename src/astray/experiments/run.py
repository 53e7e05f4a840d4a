"""Running an experiment: plans, does what is missing, and writes the report."""

from __future__ import annotations

import json
import multiprocessing
import os
import sys
import threading
import time
from collections.abc import Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from dataclasses import replace
from pathlib import Path

import polars as pl
from rich.console import Console
from rich.live import Live
from rich.table import Table

from astray import experiments
from astray.analysis.outcomes import load_shift
from astray.analysis.overlap import unseen
from astray.analysis.runs import open_run, play_all, playing
from astray.experiments.spec import Plan, Size, Study
from astray.training import checkpoint
from astray.training.config import Config
from astray.training.loop import train

EPISODES = "episodes.parquet"


def reproduce(name: str, size: Size, folder: Path, *, workers: int | None = None) -> Path:
    """Do what is missing of the experiment in `folder` and write its report there; its path.

    workers  agents trained at once; None: one for each processor
    """
    experiment = experiments.load(name)
    if size not in experiment.sizes:
        raise ValueError(
            f"unknown size {size!r} of {name}; there are: {', '.join(experiment.sizes)}"
        )
    folder.mkdir(parents=True, exist_ok=True)
    if isinstance(experiment, Study):
        return experiment.tell(experiment, name, size, folder)

    from astray.experiments.tell import tell  # matplotlib, two seconds

    plan = experiment.sizes[size]
    runs = train_all(plan, folder, workers or os.cpu_count() or 1)
    episodes = episodes_of(plan, runs, folder)
    return tell(experiment, name, size, plan, runs, episodes, folder)


def configs(plan: Plan) -> list[Config]:
    """The settings of every agent."""
    return [replace(plan.config, seed=seed) for seed in range(plan.seeds)]


def train_all(plan: Plan, folder: Path, workers: int) -> list[Path]:
    """Train every agent that is not yet trained, several at once; the run folders."""
    todo = {folder / "runs" / f"seed-{config.seed}": config for config in configs(plan)}
    missing = {run: config for run, config in todo.items() if not checkpoint.finished(run, config)}
    # Spawned, not forked: torch's and the environments' threads do not survive a fork.
    context = multiprocessing.get_context("spawn")
    workers = max(1, min(workers, len(missing)))
    if missing:  # then older episodes are not these agents'
        (folder / EPISODES).unlink(missing_ok=True)
    with ProcessPoolExecutor(workers, context) as pool:
        running = {run: pool.submit(_train, config, run) for run, config in missing.items()}
        try:
            _watch(running, missing)
            for future in running.values():
                future.result()
        except BaseException:
            pool.shutdown(cancel_futures=True)
            raise
    return list(todo)


def _train(config: Config, run: Path) -> None:
    threading.Thread(target=_end_with_parent, daemon=True).start()
    train(config, run, progress=False)


def _end_with_parent() -> None:
    """Else a training would go on after its experiment was killed, and hold its run folder."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    parent.join()
    os._exit(1)


def _watch(running: dict[Path, Future], configs: dict[Path, Config]) -> None:
    """Show how the trainings go until all have ended; on a terminal a table, else a few lines."""
    console = Console(stderr=True)
    began, said = time.monotonic(), -1
    with Live(console=console, transient=True, auto_refresh=False) as live:
        while not all(future.done() for future in running.values()):
            time.sleep(0.5)
            for future in running.values():
                if future.done():
                    future.result()  # raises what it raised, before the others end
            rows = [_progress(run, configs[run]) for run in running]
            if console.is_terminal:
                live.update(_table(rows), refresh=True)
            elif (minute := int((time.monotonic() - began) // 60)) > said:
                said = minute
                print("; ".join(" ".join(row) for row in rows), file=sys.stderr, flush=True)


def _progress(run: Path, config: Config) -> tuple[str, str, str]:
    """Name, steps done and recent return of a training."""
    last = {"steps": 0}
    path = run / "metrics.jsonl"
    if path.exists():
        lines = [line for line in path.read_text().splitlines(keepends=True) if line.endswith("\n")]
        last = json.loads(lines[-1]) if lines else last
    steps = f"{last['steps']:,} of {config.iterations * config.batch:,} steps"
    return run.name, steps, f"return {last.get('training/return', 0.0):.2f}"


def _table(rows: Sequence[tuple[str, str, str]]) -> Table:
    table = Table("agent", "trained", "recent episodes")
    for row in rows:
        table.add_row(*row)
    return table


def episodes_of(plan: Plan, runs: Sequence[Path], folder: Path) -> pl.DataFrame:
    """The episodes of all agents and of the scripted policies, in both variants of the shift.

    As `analysis.runs.play_all`, and where: "train" or "test".
    """
    path = folder / EPISODES
    if path.exists():
        there = pl.read_parquet(path)
        played = there.filter(pl.col("seed").is_not_null()).unique(["seed", "where", "level"])
        if len(played) == 2 * len(runs) * plan.levels:
            return there
    game, shift = plan.config.game, load_shift(plan.config.game, plan.shift)
    config, trained = plan.config, plan.config.training_variant()
    agents = [open_run(run)[0] for run in runs]
    parts = []
    for where, name in (("train", shift.train), ("test", shift.test)):
        variant = playing(config, name, {})
        levels = unseen(config.game, trained, config.training_levels, variant,
                        config.unseen_levels, plan.levels)  # fmt: skip
        played = play_all(game, name, variant, plan.shift, levels, agents)
        parts.append(played.with_columns(where=pl.lit(where)))
    table = pl.concat(parts)
    aside = path.with_name(f".{path.name}")
    table.write_parquet(aside)
    aside.replace(path)
    return table
