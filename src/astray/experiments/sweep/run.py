"""A sweep in its folder: train and play what is missing.

sweep.json: the settings of the sweep. agents/...: run folders, shared with experiments in the same
folder. computed/...: episodes of each combination, computed once. outcomes.parquet: a row per
episode, with its agent's settings. shares.csv: rate of each outcome for each combination.
report.html: figures for each pair of settings, and the rates.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl

from astray.analysis.outcomes import load_shift, outcomes_of, shares
from astray.analysis.runs import open_run, play_all, shift_of
from astray.analysis.tables import write_table
from astray.analysis.trained import Agent
from astray.experiments.run import agent_digest, provenance_of, run_folder
from astray.experiments.spec import Place, cached
from astray.experiments.sweep.report import TEST, TRAINING, findings, heading
from astray.experiments.sweep.settings import Cell, Sweep
from astray.experiments.workers import train_all
from astray.files import check_free, hold, write_aside
from astray.report import page as report
from astray.training.config import Config, Tracking

SWEPT, OUTCOMES, SHARES = "sweep.json", "outcomes.parquet", "shares.csv"


def run_sweep(
    sweep: Sweep,
    folder: Path,
    *,
    workers: int | None = None,
    on: Place = "here",
    track: Tracking | None = None,
) -> Path:
    """Compute what is missing of a sweep, write outcomes and report, and return its path.

    Args:
        workers: Number of agents trained at once here; None for one per processor.
        on: Place of the trainings; evaluation happens here.
        track: External tracker of the trainings.
    """
    check_free(folder, SWEPT, b'"axes"', (*report.WRITTEN, OUTCOMES, SHARES))
    folder.mkdir(parents=True, exist_ok=True)
    with hold(folder, "sweeps in"):
        _note(sweep, folder)
        agents = {cell: list(_agents(sweep, config)) for cell, config in sweep.cells().items()}
        todo = {run_folder(folder, one): one for configs in agents.values() for one in configs}
        train_all(todo, workers, on, track)
        parts = []
        for cell, configs in agents.items():
            runs = [run_folder(folder, config) for config in configs]
            parts.append(_episodes(sweep, folder, cell, configs[0], runs))
        episodes = pl.concat(parts, how="diagonal_relaxed")
        write_table(episodes, folder / OUTCOMES)
        table = _shares(sweep, episodes)
        write_table(table, folder / SHARES)
        return report.write(heading(sweep, folder), findings(sweep, episodes, table), folder)


def _note(sweep: Sweep, folder: Path) -> None:
    """Record the sweep; a later one in the folder may have other values or more seeds."""
    data = {
        "base": sweep.base.to_json(),
        "axes": {k: list(v) for k, v in sweep.axes.items()},
        "seeds": sweep.seeds,
        "levels": sweep.levels,
        "shift": sweep.shift,
    }
    write_aside(folder / SWEPT, json.dumps(data, indent=1).encode())


def _agents(sweep: Sweep, config: Config) -> Iterator[Config]:
    for seed in range(config.seed, config.seed + sweep.seeds):
        yield replace(config, seed=seed)


def _episodes(
    sweep: Sweep, folder: Path, cell: Cell, config: Config, runs: Sequence[Path]
) -> pl.DataFrame:
    """Return the episodes of a combination's agents and of scripts, in training and test."""
    shift = sweep.shift or shift_of(config)
    between = load_shift(config.find_game(), shift)
    numbers = np.array(config.unseen_levels[: sweep.levels])
    digest = hashlib.sha256(
        repr(
            [
                shift,
                sweep.levels,
                config.to_json(),
                [agent_digest(run) for run in runs],
                between,
                config.variant_for(between.test),
                provenance_of([config], play_all),
            ]
        ).encode()
    ).hexdigest()[:16]

    def play() -> pl.DataFrame:
        opened: list[Agent] = [open_run(run)[0] for run in runs]
        played = [
            play_all(
                config.find_game(), name, config.variant_for(name), shift, numbers, opened
            ).with_columns(test=pl.lit(test))
            for test, name in ((TRAINING, config.variant), (TEST, between.test))
        ]
        return pl.concat(played)

    table = cached(folder, digest, play)
    axes = zip(sweep.columns(), cell, strict=True)
    return table.with_columns(pl.lit(given).alias(name) for name, given in axes)


def _shares(sweep: Sweep, episodes: pl.DataFrame) -> pl.DataFrame:
    """Return the rate of each outcome for each combination, policy and test."""
    names = outcomes_of(sweep.base.find_game())
    return shares(episodes, (*sweep.columns(), "policy", "test"), names)
