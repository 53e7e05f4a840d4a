"""Pretrained agents: weights without the training's state, and a card about the agent's goals."""

import functools
import io
import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from astray.acting import LASTING
from astray.analysis.outcomes import load_shift, outcomes_of
from astray.analysis.pages import templates
from astray.analysis.results import Result
from astray.analysis.runs import evaluate_runs, open_run, shift_of
from astray.analysis.tables import write_table
from astray.experiments import catalogue
from astray.experiments.spec import Size, name_of_run
from astray.experiments.videos import write_video
from astray.files import write_aside
from astray.training import checkpoint, folders
from astray.training.config import Config
from astray.training.log import METRICS
from astray.validation import AT_ONCE, bounded, path_of
from astray.world import World

LARGEST = 3_000_000  # bytes of an agent that is kept
POINTS = 300  # of its curve, at most


def keep(
    run: Path,
    name: str,
    *,
    shift: str | None = None,
    folder: Path = folders.PRETRAINED,
    levels: int = 1000,
    largest: int = LARGEST,
) -> Path:
    """Keep the agent of a run or checkpoint as `folder`/`name`; return that folder.

    Args:
        shift: Shift with intended goal and proxies; None for the one of its training.
        levels: Number of levels for its evaluation, the first outside of its training.
        largest: Largest size of its weights in bytes.

    Raises:
        ValueError: If the name is invalid or taken, levels are none or too many, the weights are
            too large, or there are no metrics of its training, as of an agent that was kept.
    """
    folder = path_of("folder", folder)
    folders.check_new(name, folder)
    agent, config = open_run(run)
    if (size := agent.path.stat().st_size) > largest:
        raise ValueError(
            f"the agent is {size / 1e6:.1f} MB; a pretrained one is at most {largest / 1e6:g} MB"
        )
    if isinstance(config.find_game(), World):  # which another process may not know by its name
        raise ValueError(f"agents of games are kept; {run} plays the World {config.game!r}")
    bounded("levels", levels, 1, AT_ONCE)  # all but the last would take 17 GB
    source = folders.AgentFolder.of(agent.path)
    named = shift_of(config) if shift is None else shift
    if not (source.path / METRICS).exists():
        raise ValueError(f"{run} cannot be kept: it has no {METRICS}, for its curve")
    with folders.made(folder, name) as aside:
        there = aside / "checkpoints" / f"{source.steps}"
        there.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(agent.path, there / folders.AGENT)
        settings = source.noted()
        if (deviation := source.deviation()) is not None:
            settings[folders.DEVIATION] = deviation
        write_aside(aside / folders.CONFIG, json.dumps(settings, indent=2).encode())
        draw_curve(source.path, config, source.steps, aside)
        write_card(name, aside, named, levels)
    return folder / name


def draw_curve(run: Path, config: Config, steps: int, folder: Path) -> None:
    """Write `curve.csv`, metrics of the run up to `steps`, and their plot `curve.png`.

    Raises:
        ValueError: If its metrics have no rewards.
    """
    from astray.report.learning import learning_curves  # here: matplotlib takes a second

    metrics = pl.DataFrame(checkpoint.metrics(run), infer_schema_length=None)
    ends = "training/return" in metrics.columns  # else no episode has ended
    kind = "return" if ends else "reward_per_step"
    both = {f"training/{kind}": config.variant, f"validation/{kind}": config.validation}
    there = {name: of for name, of in both.items() if of and name in metrics.columns}
    if not there:
        raise ValueError(f"the metrics of {run} have no training/{kind} to draw")
    data = metrics.filter(pl.col("steps") <= steps).select("steps", *there)
    every = -(-len(data) // POINTS)
    data = data.gather_every(every, (len(data) - 1) % every)  # with the last
    write_table(data, folder / "curve.csv")
    data = data.with_columns(seed=pl.lit(config.seed))
    drawn = learning_curves(data, there, kind.replace("_", " "))
    drawn.savefig(file := io.BytesIO())
    write_aside(folder / "curve.png", file.getvalue())


def write_card(name: str, run: Path, shift: str, levels: int) -> None:
    """Write `README.md` and `episode.gif` of an agent; `levels` are played where episodes end."""
    agent, config = open_run(run)
    between, game = load_shift(config.find_game(), shift), config.find_game()
    numbers = np.array(config.unseen_levels[:levels])
    played = {
        variant: evaluate_runs([run], numbers, variant=variant, shift=shift)
        for variant in dict.fromkeys((between.test, config.variant))  # the test may be refused
        if variant == between.test or config.variant_for(variant).time_limit <= LASTING
    }
    write_video(agent, config, between, played[between.test].episodes, run / "episode.gif")
    card = templates("astray.experiments", markdown=True).get_template("card.md")
    text = card.render(
        name=name,
        about=game.about,
        config=config,
        steps=folders.AgentFolder.of(agent.path).steps,
        trained_on=config.training_variant().about,
        commands=commands(config),
        shift=shift,
        between=between,
        levels=f"{levels:,}",
        outcomes=outcomes_of(game),
        rows=[
            row for variant, result in reversed(played.items()) for row in _rows(variant, result)
        ],
        settings=config.flat(),
    )
    write_aside(run / folders.CARD, text.encode())


def commands(config: Config) -> list[str]:
    """Return the commands that train an agent with these settings, on this device or another."""
    its = name_of_run(config)
    return [
        f"astray reproduce {name} --size {size}"
        for name in catalogue.NAMES
        for size, plan in catalogue.load(name).sizes.items()
        if any(one.game == config.game for one in plan.agents.values())
        and its in _trained(name, size)
    ]


@functools.cache
def _trained(name: str, size: Size) -> set[str]:
    """Return the names of the runs of an experiment of the catalogue."""
    trainings = catalogue.load(name).sizes[size].trainings()
    return {name_of_run(config) for configs in trainings.values() for config in configs}


def _rows(variant: str, result: Result) -> Iterator[list[Any]]:
    """Return a row per policy, the agent first: levels, name, outcomes; none of levels twice."""
    (agent,) = result.agents
    every = pl.col("levels_played") == "all"
    order = result.table.filter(every | (pl.col("levels") < pl.col("levels").max())).sort(
        pl.col("levels_played") != "all", pl.col("policy") != agent, maintain_order=True
    )
    for policy, which, levels, *outcomes in order.iter_rows():
        where = f"`{variant}`"
        if which != "all":
            where += f", the {levels} distinguishing levels"
        yield [where, "the agent" if policy == agent else policy, *outcomes]
