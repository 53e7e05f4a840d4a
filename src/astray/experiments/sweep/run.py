"""A sweep in its folder: train and play what is missing.

sweep.json: the settings of the sweep. agents/...: run folders, shared with experiments in the same
folder. computed/...: episodes of each combination, computed once. outcomes.parquet: a row per
episode, with its agent's settings. rates.csv: rate of each outcome for each combination.
report.html: figures for each pair of settings, and the rates.
"""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import polars as pl

from astray.analysis.outcomes import outcomes_of, rates
from astray.analysis.tables import write_table
from astray.experiments.levels import play, try_tests
from astray.experiments.run import code_of, inputs, train_agents
from astray.experiments.spec import Place, Plan, Runs, cached
from astray.experiments.sweep.report import findings, heading
from astray.experiments.sweep.settings import Cell, Sweep
from astray.files import check_free, hold, write_aside
from astray.report import page as report
from astray.training.config import Config, Tracking
from astray.training.folders import read_json
from astray.training.track import check_installed
from astray.validation import shown

SWEPT, OUTCOMES, RATES = "sweep.json", "outcomes.parquet", "rates.csv"


def run_sweep(
    sweep: Sweep,
    folder: Path,
    *,
    workers: int | None = None,
    on: Place = "here",
    track: Tracking | None = None,
    command: str = "",
) -> Path:
    """Compute the missing parts of a sweep, write outcomes and report, and return its path.

    Args:
        workers: Number of agents to train in parallel; None for one per processor.
        on: Place of the trainings; evaluation happens here.
        track: External tracker of the trainings.
        command: Command that repeats it; empty for one made of the settings.

    Raises:
        FileExistsError: If the folder has outcomes of agents that this sweep does not have.
        ImportError: If the tracker is not installed; RuntimeError if it has no login.
    """
    if track:
        check_installed(track)
    check_free(folder, SWEPT, b'"axes"', (*report.WRITTEN, OUTCOMES, RATES))
    with hold(folder, "sweeps in"):
        _check_extends(sweep, folder / SWEPT)
        plans = sweep.plans()
        agents = {name: config for plan in plans.values() for name, config in plan.agents.items()}
        joined = replace(next(iter(plans.values())), agents=agents, tests={}, first_level=None)
        code_of(joined)  # while its files are still what was imported
        for plan in plans.values():
            try_tests(plan)
        runs = train_agents(joined, folder, workers, on, track)
        # A later one in the folder may have other values or more seeds.
        axes = {name: list(values) for name, values in sweep.axes.items()}
        settings = vars(sweep) | {"base": sweep.base.to_json(), "axes": axes}
        write_aside(folder / SWEPT, json.dumps(settings, indent=1).encode())
        parts = [_episodes(sweep, folder, cell, plan, runs) for cell, plan in plans.items()]
        episodes = pl.concat(parts, how="diagonal_relaxed")
        write_table(episodes, folder / OUTCOMES)
        by = (*sweep.columns(), "policy", "test")
        table = rates(episodes, by, outcomes_of(sweep.base.find_game()))
        write_table(table, folder / RATES)
        told = heading(sweep, folder, command), findings(sweep, episodes, table)
        return report.write(*told, folder)


def _check_extends(sweep: Sweep, path: Path) -> None:
    """Raise FileExistsError if outcomes of another sweep would be replaced by those of fewer."""
    if not path.exists():
        return
    told = read_json(path, dict, ["base", "axes"])
    try:
        there = Sweep(**told | {"base": Config.from_json(told["base"])})
        lacks = bool({*_agents(there)} - {*_agents(sweep)})
    except (ValueError, TypeError, AttributeError, KeyError):  # as of an older version
        lacks = True
    if lacks:
        axes = shown(told["axes"])
        said = f"{path.parent} has a sweep of other agents, {axes}, whose outcomes would be lost"
        raise FileExistsError(f"{said}; change `out`, or sweep these values, too")


def _agents(sweep: Sweep) -> Iterator[str]:
    """Return the settings of each agent of a sweep."""
    for plan in sweep.plans().values():
        for config in (one for its in plan.trainings().values() for one in its):
            yield json.dumps(config.identity(), sort_keys=True)


def _episodes(sweep: Sweep, folder: Path, cell: Cell, plan: Plan, runs: Runs) -> pl.DataFrame:
    """Return the episodes of a combination's agents and of scripts, in training and test."""
    mine = {name: runs[name] for name in plan.agents}
    _, digest = inputs(plan, mine)
    table = cached(folder, digest, lambda: play(plan, mine)).drop("agent")
    axes = zip(sweep.columns(), cell, sweep.axes.values(), strict=True)
    return table.with_columns(  # None is a value as others are, and no gap
        pl.lit(str(given) if None in values else given).alias(name) for name, given, values in axes
    )
