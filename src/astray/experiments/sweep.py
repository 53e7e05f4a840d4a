"""Sweeps: agents of every combination of some settings, what each pursues, and how that depends.

sweep.json        what is swept
agents/...        the run folders, which experiments of the same folder share
computed/...      episodes of each combination, made once
outcomes.parquet  an episode a row, with the settings of its agent
shares.csv        of each combination, how often each outcome came about
report.html       figures, one for every two settings that are swept, and the shares
"""

from __future__ import annotations

import hashlib
import itertools
import json
import math
import shlex
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from astray.analysis.estimates import bootstrap
from astray.analysis.outcomes import INTENDED, MISGENERALIZED, load_shift, matrix, shares
from astray.analysis.runs import LEVELS_PLAYED, open_run, play_all, shift_of
from astray.analysis.tables import write_table
from astray.analysis.trained import Agent
from astray.bounds import bounded, shown
from astray.experiments import report, sweep_figures
from astray.experiments.outcomes import AGENTS
from astray.experiments.report import Findings, Heading, Plot, Table
from astray.experiments.run import COMPUTING, agent_digest, guests_digest, run_folder
from astray.experiments.spec import Place, kept
from astray.experiments.workers import train_all
from astray.files import hold, see_free, write_aside
from astray.kernel.jit import source_digest
from astray.training.config import PRESETS, SEEDS, Config, Tracking

KNOB = "variant."  # before the name of a knob of the variant
SHORT = {"lr": "learning_rate"}
SWEPT, OUTCOMES, SHARES = "sweep.json", "outcomes.parquet", "shares.csv"
MOST = 10_000  # agents of a sweep
TRAINING, TEST = "in training", "in the test"
Cell = tuple[Any, ...]  # a value of each axis


@dataclass(frozen=True)
class Sweep:
    """Settings and the values that each of them takes, in all combinations.

    axes    a setting, or variant.KNOB -> its values, as they are set
    seeds   agents of each combination
    levels  that each agent is evaluated on, the first that its training does not draw from
    shift   which goals are intended and proxies; None: the one that the training is for
    """

    base: Config
    axes: Mapping[str, Sequence[Any]]
    seeds: int = 1
    levels: int = LEVELS_PLAYED
    shift: str | None = None

    def __post_init__(self) -> None:
        bounded("seeds", self.seeds, 1, SEEDS - self.base.seed)
        bounded("levels", self.levels, 1, MOST * 100)
        count = math.prod(map(len, self.axes.values())) * self.seeds
        if not self.axes or not all(self.axes.values()) or count > MOST:
            raise ValueError(
                f"a sweep must set something, in 1 to {MOST:,} agents; got {shown(self.axes)}"
            )
        for name, values in self.axes.items():
            if len({str(value) for value in values}) < len(values):
                raise ValueError(f"{name} must take each value once; got {shown(list(values))}")
        for config in self.cells().values():
            if config.teacher is not None:
                raise ValueError(f"a sweep has no teachers; got teacher {shown(config.teacher)}")
            load_shift(config.find_game(), self.shift or shift_of(config))

    def cells(self) -> dict[Cell, Config]:
        """The settings of each combination, but for the seed."""
        names = list(self.axes)
        return {
            values: changed(self.base, dict(zip(names, values, strict=True)))
            for values in itertools.product(*self.axes.values())
        }


def axes(texts: Sequence[str]) -> dict[str, list[Any]]:
    """Settings and their values from texts as lr=1e-4,5e-4 and variant.region=1,3,5.

    Raises ValueError where one is none.
    """
    found: dict[str, list[Any]] = {}
    for text in texts:
        name, is_set, values = text.partition("=")
        name = SHORT.get(name, name)
        if not is_set or not values or name in found:
            raise ValueError(
                f"a sweep must set NAME=VALUE,VALUE,... once for each name; got {text!r}"
            )
        found[name] = [value(part) for part in values.split(",")]
    return found


def value(text: str) -> Any:
    """A number or a truth where the text is one, else the text."""
    try:
        found = json.loads(text.lower())
    except (ValueError, RecursionError):
        return text
    return text if isinstance(found, str | list | dict) else found


def changed(base: Config, values: Mapping[str, Any]) -> Config:
    """The settings with some of them, and some knobs of the variant, changed.

    Raises ValueError where there is no such setting or knob, or it cannot be that.
    """
    known = [field.name for field in fields(Config) if field.name not in ("knobs", "seed")]
    settings, knobs = {}, dict(base.knobs)
    for name, given in values.items():
        if name.startswith(KNOB):
            knobs[name.removeprefix(KNOB)] = given
        elif name in known:
            settings[name] = given
        else:
            raise ValueError(
                f"unknown setting {name!r}; there are: {', '.join(known)}, and {KNOB}KNOB"
            )
    return replace(base, knobs=knobs, **settings)


def run_sweep(
    sweep: Sweep,
    folder: Path,
    *,
    workers: int | None = None,
    on: Place = "here",
    track: Tracking | None = None,
) -> Path:
    """Do what is missing of a sweep, and write its outcomes and report; the report's path.

    workers  agents trained at once here; None: one for each processor
    on       where agents are trained; they are evaluated here
    track    who else is told how trainings go
    """
    see_free(folder, SWEPT, b'"axes"', (*report.WRITTEN, OUTCOMES, SHARES))
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
        return report.write(_heading(sweep, folder), _findings(sweep, episodes, table), folder)


def _note(sweep: Sweep, folder: Path) -> None:
    """Note what is swept; a folder may be swept in again, with other values or more seeds."""
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
    """The episodes of a combination's agents and of scripts, in training and in the test."""
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
                source_digest(COMPUTING),
                guests_digest([config]),
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

    table = kept(folder, digest, play)
    settings = [pl.lit(given).alias(name) for name, given in zip(columns(sweep), cell, strict=True)]
    return table.with_columns(settings)


def _shares(sweep: Sweep, episodes: pl.DataFrame) -> pl.DataFrame:
    """How often each outcome came about, for each combination, policy and test."""
    return shares(episodes, (*columns(sweep), "policy", "test"))


def columns(sweep: Sweep) -> list[str]:
    """What the axes are called in tables, where episodes have a variant, and shares have levels."""
    return [f"training_{name}" if name in ("levels", "variant") else name for name in sweep.axes]


def _heading(sweep: Sweep, folder: Path) -> Heading:
    config = sweep.base
    return Heading(
        name=folder.name,
        size=f"{sweep.seeds} seeds",
        title=f"A sweep of {config.game} {config.variant}",
        reproduces="nothing",
        differences="",
        question=f"What do agents pursue, by {' and '.join(sweep.axes)}?",
        command=command(sweep),
    )


def command(sweep: Sweep) -> str:
    """The command that makes the sweep: a preset, and all that differs from it."""
    base, words = sweep.base, ["astray", "sweep", sweep.base.game, sweep.base.variant]

    def changes(preset: Config) -> dict[str, Any]:
        told = {f.name for f in fields(Config)} - {"game", "variant", "knobs", *sweep.axes}
        return {n: getattr(base, n) for n in told if getattr(base, n) != getattr(preset, n)}

    preset = min(PRESETS, key=lambda name: (len(changes(PRESETS[name])), name != "small"))
    words += ["--preset", preset] if preset != "small" else []
    for name, given in sorted(changes(PRESETS[preset]).items()):
        flag = name.replace("_", "-")
        if isinstance(given, bool) and isinstance(getattr(PRESETS["small"], name), bool):
            words.append(f"--{flag}" if given else f"--no-{flag}")
        else:
            words += [f"--{flag}", str(given)]
    alone = {f"{KNOB}{name}": [given] for name, given in base.knobs.items()}
    for name, values in (alone | dict(sweep.axes)).items():
        words += ["--set", f"{name}={','.join(map(str, values))}"]
    words += ["--seeds", str(sweep.seeds)]
    words += [] if sweep.levels == LEVELS_PLAYED else ["--test-levels", str(sweep.levels)]
    words += [] if sweep.shift is None else ["--shift", sweep.shift]
    return shlex.join(words)


def _findings(sweep: Sweep, episodes: pl.DataFrame, table: pl.DataFrame) -> Findings:
    """The figures, and a sentence on the combinations at the ends."""
    agents = table.filter(policy=AGENTS)
    asked = agents.filter(test=TEST, outcome=MISGENERALIZED).sort("mean", maintain_order=True)
    ends = [
        f"{', '.join(f'{name} {row[name]}' for name in columns(sweep))}: {100 * row['mean']:.0f} % "
        f"({100 * row['low']:.0f} to {100 * row['high']:.0f})"
        for row in (asked.row(0, named=True), asked.row(-1, named=True))
    ]
    settings = {name: str(x) for name, x in vars(sweep.base).items() if name not in sweep.axes}
    return Findings(
        answer=f"The proxy is reached first in the test least often with {ends[0]}, and most often "
        f"with {ends[1]}.",
        claims=[],
        plots=list(_plots(sweep, episodes)),
        tables=[Table("agents", "What the agents do", agents.drop("policy"))],
        settings=settings | {"seeds": str(sweep.seeds), "levels": str(sweep.levels)},
    )


def _plots(sweep: Sweep, episodes: pl.DataFrame) -> Iterator[Plot]:
    """A figure for each two settings; of one alone, one."""
    mine = episodes.filter(policy=AGENTS)
    names = columns(sweep)
    several = [n for n, values in zip(names, sweep.axes.values(), strict=True) if len(values) > 1]
    pairs = list(itertools.combinations(several, 2)) or [tuple(several or names)[:1]]
    for pair in pairs:
        data = pl.DataFrame(
            [
                dict(zip(pair, key, strict=True))
                | {"what": what}
                | vars(bootstrap(matrix(part, pl.col("outcome") == outcome)))
                for what, test, outcome in (
                    (f"{INTENDED}, {TRAINING}", TRAINING, INTENDED),
                    (f"{MISGENERALIZED}, {TEST}", TEST, MISGENERALIZED),
                )
                for key, part in mine.filter(test=test).group_by(pair, maintain_order=True)
            ]
        )
        name = "-".join(one.replace(".", "-").replace("_", "-") for one in pair)
        others = [one for one in several if one not in pair]
        caption = f"What agents do, by {' and '.join(pair)}; shares of episodes"
        if others:
            caption += f", over all values of {', '.join(others)}"
        draw = sweep_figures.grid if len(pair) == 2 else sweep_figures.line
        yield Plot(name, f"{caption}.", draw(data, *pair), data)
