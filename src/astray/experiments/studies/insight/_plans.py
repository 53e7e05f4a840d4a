"""Pretrained and published agents for interpretability studies, which train none."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import polars as pl

from astray.analysis.estimates import estimate_mean
from astray.analysis.runs import open_run
from astray.analysis.trained import Agent
from astray.estimate import Estimate
from astray.experiments.levels import levels_of
from astray.experiments.spec import Plan, Test, Work
from astray.experiments.studies.coinrun import _agents
from astray.game import Variant
from astray.training.config import PRESETS, Config

MOUSE = "mouse"
CORNER_MOUSE = replace(PRESETS["small"], variant="corner-small", validation="anywhere-small")
CHEESE_MOUSE = replace(
    PRESETS["paper"],
    game="maze",
    variant="anywhere-easy",
    observation="image",
    network="impala",
    art="original",
    levels=100_000,
)
SMALL = Test("anywhere-small", "corner-small")
LARGE = Test("anywhere-easy", "corner-easy", {"smallest": 11})  # cells a side, of 15
CORNER = "the mouse of the corner that comes with astray, in worlds of 7 cells, seen as symbols"
CHEESE = "a mouse that others trained with cheese anywhere, in mazes of 11 to 15 cells"


def existing(
    name: str, config: Config, agent: str, differences: str, levels: int, **more: Any
) -> Plan:
    """Return a plan with one agent that exists: pretrained, or trained by others."""
    return Plan(
        agents={name: config},
        published={name: agent},
        levels=levels,
        differences=differences,
        **more,
    )


of_corner_mouse = partial(existing, MOUSE, CORNER_MOUSE, "maze-corner", CORNER)
of_cheese_mouse = partial(existing, MOUSE, CHEESE_MOUSE, "maze-160m", CHEESE)
of_kept_runner = partial(
    existing, _agents.RUNNER, _agents.AGENTS["smoke"], "coin-end", _agents.DIFFERENCES["smoke"]
)


def opened(work: Work, where: str) -> tuple[Agent, Variant, np.ndarray]:
    """Return the agent of a plan with one, a test's variant, and its levels [N]."""
    test = work.plan.visited[where]
    ((run,),) = work.runs.values()
    agent, _ = open_run(run)
    return agent, test.variant_for(work.plan.config), levels_of(work.plan, test)


def of_levels(rows: pl.DataFrame, value: str, condition: str, minus: str | None = None) -> Estimate:
    """Return the mean over levels of a column under a condition, minus another's if given.

    Levels where it is null do not count.
    """
    one = rows.filter(condition=condition).select("level", value)
    if minus is not None:
        other = rows.filter(condition=minus).select("level", pl.col(value).alias("other"))
        one = one.join(other, on="level").with_columns(pl.col(value) - pl.col("other"))
    return estimate_mean(one.sort("level")[value].drop_nulls().to_numpy())
