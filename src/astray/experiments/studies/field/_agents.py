"""Agents, plans and estimates of the studies of the field's worlds."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import polars as pl

from astray.analysis.estimates import estimate_mean
from astray.estimate import Estimate
from astray.experiments import outcomes
from astray.experiments.spec import Experiment, Plan, Test, Work
from astray.report.findings import Findings
from astray.training.config import PRESETS, Config

OWN_WORLD = "world and rules are written anew and simpler; PPO with a network of two hidden layers"


def agent(game: str, variant: str, steps: int, *, width: int = 128, **settings: Any) -> Config:
    """Return the settings of an agent that sees symbols, with many small updates."""
    return replace(
        PRESETS["small"],
        game=game,
        variant=variant,
        steps=steps,
        num_envs=64,
        minibatches=8,  # of 64 x 64 / 8 = 512 samples
        width=width,
        **settings,
    )


def study(
    find: Callable[[Work], Findings],
    title: str,
    *,
    reproduces: str,
    question: str,
    agents: Mapping[str, Config],
    tests: Mapping[str, Test],
    levels: int,
    differences: str,
    first_seed: int = 0,
) -> Experiment:
    """Return a study of five agents at size smoke, in a world that was written anew."""
    plan = Plan(
        agents=agents, seeds=5, first_seed=first_seed, tests=tests, levels=levels,
        differences=f"{OWN_WORLD}; {differences}",
    )  # fmt: skip
    return Experiment(title, reproduces, question, {"smoke": plan}, find)


def happens(work: Work, test: str, event: str) -> Estimate:
    """Estimate the rate of an event in a test's episodes."""
    return estimate_mean(outcomes.played(work, test, pl.col(event).is_not_null()))
