"""Runners trained with the coin at the end of every level, shared by all CoinRun studies."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl
from matplotlib.figure import Figure

from astray.analysis.adapters import Function
from astray.analysis.evaluate import evaluate
from astray.analysis.runs import open_run
from astray.experiments.spec import PUBLISHED, Plan, Size
from astray.figures import charts
from astray.game import Variant
from astray.games.coinrun.rules import ACTIONS
from astray.published.imported import SPARED
from astray.record import LEVELS
from astray.training.config import PRESETS, Config

FATES = ("#2fa393", "#f0a03c", "#8c8c92", "#d2d2ce")  # as of outcomes; who died is darker
ABOUT = {"game": "coinrun", "variant": "coin-end", "validation": "coin-anywhere"}
LARGE = replace(PRESETS["paper"], **ABOUT, device="cuda")
AGENTS: Mapping[Size, Config] = {
    "smoke": replace(
        PRESETS["small"], **ABOUT, num_steps=128, gamma=0.999, entropy_weight=0.01, steps=10_000_000
    ),
    "pixels": replace(
        PRESETS["pixels"],
        **ABOUT,
        knobs={"hazards": False, "time_limit": 300},
        gamma=0.99,
        entropy_weight=0.01,
        steps=1_000_000,
    ),
    # A runner of size smoke teaches for 10 million steps; the others are by rewards alone.
    "night": replace(
        PRESETS["night"],
        **ABOUT,
        network="strided-impala",
        teacher="of the same seed",  # see `plan`
        taught=0.5,
        lesson_rate=5e-4,
        learning_rate=1e-4,
        steps=20_000_000,
        epochs=1,
        minibatches=128,
        gamma=0.995,
    ),
    "hour": replace(LARGE, steps=25_000_000),
    "paper": LARGE,
    # OpenAI's agent, trained on all levels as released; for its tests they are numbered likewise.
    "published": replace(
        PRESETS["paper"],
        game="coinrun",
        variant="coin-end",
        knobs={"numbering": "procgen", "place": "anywhere"},
        network="clear",
        observation="image",
        art="original",
        levels=LEVELS.stop - SPARED,
        normalise_reward=False,
    ),
}
SPEED = {"night": 1500}  # steps a second, where agents take a night
RUNNER = "runner"  # the name of the agents where there are no others
DIFFERENCES: Mapping[Size, str] = {
    "smoke": "levels seen as symbols instead of a picture, by a network of two hidden layers, and "
    "10 million steps instead of 200 million",
    "pixels": "levels without hazards, 300 steps an episode; a network of patches, and 1 "
    "million steps instead of 200 million",
    "night": "two convolutions of stride 2 before one of the network's blocks; 20 instead of 200 "
    "million steps, the first half with a teacher that sees symbols and had 10 million steps; a "
    "discount of 0.995 instead of 0.999, and an entropy bonus of 0.003 instead of 0.01",
    "hour": "25 million steps instead of 200 million",
    "paper": "",
    "published": "the agent is OpenAI's of CoinRun as released, trained by others with "
    "PPO on all levels, the coin at the end as in the paper, another network; one agent, so that "
    "intervals are over levels alone",
}
AGENT = {RUNNER: "openai-coinrun"}
FIRST: Mapping[Size, int] = {"smoke": 20, "pixels": 20, "night": 3}  # lower seeds chose settings
SEEDS: Mapping[Size, int] = {"night": 3, "hour": 1, "paper": 3, PUBLISHED: 1}  # others: 10
# Blind to all: what it takes, it comes by.
RIGHT_AND_JUMP = Function(
    lambda seen: np.full(len(seen), ACTIONS.index("right-up")), "right and jump", "symbolic"
)


def plans(levels: Mapping[Size, int], *, brief: int | None = None, **more: Any) -> dict[Size, Plan]:
    """Return plans of runners of the end, by size; `brief` limits the steps of PUBLISHED's tests.

    There a network this large needs an hour for what the others play in a minute.
    """
    limit = {"time_limit": brief} if brief else {}
    short: dict[str, Any] = {
        kind: {n: replace(test, knobs={**test.knobs, **limit}) for n, test in more[kind].items()}
        for kind in {"tests", "visited"} & more.keys()
    }
    if brief:
        short["differences"] = f"{DIFFERENCES[PUBLISHED]}; test episodes of {brief} steps at most"
    return {
        size: plan(size, count, {RUNNER: {}}, **more | (short if size == PUBLISHED else {}))
        for size, count in levels.items()
    }


def plan(size: Size, levels: int, knobs: Mapping[str, dict[str, Any]], **more: Any) -> Plan:
    """Return a plan of runners of the end with these changed knobs, by name."""
    agent, teacher = AGENTS[size], AGENTS["smoke"]
    usual: dict[str, Any] = {
        "seeds": SEEDS.get(size, 10),
        "first_seed": FIRST.get(size, 0),
        "speed": SPEED.get(size, 0),
        "differences": DIFFERENCES[size],
    }
    return Plan(
        agents={name: replace(agent, knobs=agent.knobs | its) for name, its in knobs.items()},
        published=AGENT if size == PUBLISHED else {},
        teachers={name: replace(teacher, knobs=its) for name, its in knobs.items()}
        if size == "night"
        else {},
        levels=levels,
        **usual | more,
    )


def play(runs: Sequence[Path], variant: Variant, levels: np.ndarray | range) -> pl.DataFrame:
    """Return episodes of agents of one training, as `evaluate`, with columns run and seed."""
    parts = []
    for run in runs:
        agent, config = open_run(run)
        played = evaluate(agent, config.game, variant, levels)
        parts.append(played.with_columns(run=pl.lit(str(run)), seed=pl.lit(config.seed)))
    return pl.concat(parts)


def fate_bars(fates: pl.DataFrame, order: Sequence[str]) -> Figure:
    """Draw a bar of fates for each test; columns test, fate and mean."""
    colours = dict(zip(order, FATES, strict=True))
    return charts.bars(fates, colours, row="test", part="fate", label="fraction of episodes")
