"""The report of a sweep: the agents' behaviour for each combination, and its command."""

import itertools
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import polars as pl

from astray.analysis.outcomes import INTENDED, MISGENERALIZED, load_shift, rates
from astray.analysis.runs import LEVELS_PLAYED
from astray.estimate import Estimate
from astray.experiments.outcomes import AGENTS
from astray.experiments.sweep.settings import TEST, TRAINING, Sweep
from astray.figures import charts
from astray.figures.axes import COLOURS
from astray.figures.grids import cells
from astray.report.findings import Findings, Heading, Plot, Table
from astray.training.config import PRESETS, Config
from astray.training.settings import KNOB
from astray.validation import command_of


def heading(sweep: Sweep, folder: Path, told: str = "") -> Heading:
    return Heading(
        name=folder.name,
        size=f"{sweep.seeds} seeds",
        title=f"A sweep of {sweep.base.game} {sweep.base.variant}",
        reproduces="",
        differences="",
        question=f"What do agents pursue, by {' and '.join(map(named, sweep.varied()))}?",
        command=told or command(sweep),
    )


def named(column: str) -> str:
    """Return a setting's name as users give it, without the mark of a variant's knobs."""
    return column.removeprefix(KNOB)


def command(sweep: Sweep) -> str:
    """Return the command of the sweep: a preset and the changed settings."""
    base, words = sweep.base, ["astray", "sweep", sweep.base.game, sweep.base.variant]

    def changes(preset: Config) -> dict[str, Any]:
        told, apart = preset.flat(), {"game", "variant", "knobs", *sweep.axes}
        return {n: v for n, v in base.flat().items() if n not in apart and v != told[n]}

    preset = min(PRESETS, key=lambda name: (len(changes(PRESETS[name])), name != "small"))
    words += ["--preset", preset] if preset != "small" else []
    for name, given in sorted(changes(PRESETS[preset]).items()):
        flag = name.replace("_", "-")
        if isinstance(given, bool):
            words.append(f"--{flag}" if given else f"--no-{flag}")
        else:
            words += [f"--{flag}", str(given)]
    alone = {f"{KNOB}{name}": [given] for name, given in base.knobs.items()}
    for name, values in (alone | dict(sweep.axes)).items():
        words += ["--set", f"{named(name)}={','.join(map(str, values))}"]
    words += ["--seeds", str(sweep.seeds)]
    words += [] if sweep.levels == LEVELS_PLAYED else ["--num-test-levels", str(sweep.levels)]
    words += [] if sweep.shift is None else ["--shift", sweep.shift]
    words += [] if sweep.longest is None else ["--longest", str(sweep.longest)]
    return command_of(*words)


def findings(sweep: Sweep, episodes: pl.DataFrame, table: pl.DataFrame) -> Findings:
    """Return the figures, and a sentence on the extreme combinations."""
    agents, (outcome, goal) = table.filter(policy=AGENTS), _asked(sweep)
    asked = agents.filter(test=TEST, outcome=outcome).sort("mean", maintain_order=True)
    ends = [
        f"{', '.join(f'{named(x)} {row[x]}' for x in sweep.varied())}: {Estimate.of(row).short()}"
        for row in (asked.row(0, named=True), asked.row(-1, named=True))
    ]
    settings = {name: str(x) for name, x in sweep.base.flat().items() if name not in sweep.axes}
    count, told = len(asked), f"least often with {ends[0]}, and most often with {ends[1]}."
    told += (
        f" The extremes of {count} combinations differ by chance too: each interval is for one of "
        "them alone."
    ) * (count > 2)
    if asked["mean"].n_unique() == 1:
        told = (
            f"equally often in each of {count} combinations, as " * (count > 1) + f"with {ends[0]}."
        )
    return Findings(
        answer=f"{goal} is reached first in the test {told}",
        claims=[],
        plots=list(_plots(sweep, episodes)),
        tables=[Table("agents", "Outcomes of the agents", agents.drop("policy"))],
        settings=settings | {"seeds": str(sweep.seeds), "levels": str(sweep.levels)},
    )


def _asked(sweep: Sweep) -> tuple[str, str]:
    """Return the outcome that is compared in the test, of the proxies if any, and its goal."""
    plan = next(iter(sweep.plans().values()))
    shift = load_shift(plan.game, plan.tests[TEST].shift)
    proxy = MISGENERALIZED, "The proxy"
    return proxy if shift.proxies else (INTENDED, f"“{shift.intended}”")


def _plots(sweep: Sweep, episodes: pl.DataFrame) -> Iterator[Plot]:
    """Plot each pair of settings, or a single one."""
    mine, several = episodes.filter(policy=AGENTS), sweep.varied()
    pairs = list(itertools.combinations(several, 2)) or [tuple(several)[:1]]
    for pair in pairs:
        data = pl.concat(
            rates(mine.filter(test=test), pair, [outcome])
            .rename({"outcome": "what"})
            .with_columns(what=pl.lit(f"{outcome}, {test}"))
            for outcome, test in ((INTENDED, TRAINING), (_asked(sweep)[0], TEST))
        )
        name = "-".join(one.replace(".", "-").replace("_", "-") for one in pair)
        others = [one for one in several if one not in pair]
        caption = f"Outcomes of agents, by {' and '.join(map(named, pair))}; fractions of episodes"
        if others:
            caption += f", over all values of {', '.join(map(named, others))}"
        x, *y = pair
        drawn = (
            cells(data, COLOURS, x=x, y=y[0], panel="what", x_label=named(x), y_label=named(y[0]))
            if y
            else charts.curves(
                data, x=x, line="what", label="fraction of episodes", x_label=named(x), even=True,
                whiskers=True, percent="y", limits=(-0.03, 1.03),
            )
        )  # fmt: skip
        yield Plot(name, f"{caption}.", drawn, data)
