"""Which network learns most from images in the same time on one processor?"""

import itertools
from dataclasses import replace

import numpy as np
import polars as pl

from astray.analysis.estimates import estimate_difference, over_agents
from astray.estimate import Estimate
from astray.experiments import outcomes
from astray.experiments.spec import Experiment, Plan, Work
from astray.figures import charts
from astray.report.claims import above
from astray.report.findings import Findings, Plot, Table
from astray.training.config import PRESETS

# Steps per second of one thread, to three digits, as `astray bench networks` measured them: they
# decide how many steps a network gets, so that all get the same time.
SPEEDS = {"impala": 216, "nature": 1900, "patch-impala": 1260, "overlap": 4120, "patch": 4270}
PAPER, OURS = "impala", "patch"
SECONDS = 180
GAMES = {
    "maze": replace(PRESETS["pixels"], variant="corner-small"),
    "coinrun": replace(
        PRESETS["pixels"], game="coinrun", variant="coin-end-calm", gamma=0.99, entropy_weight=0.01
    ),
}
LAST = 0.1  # the end of a training, as a fraction of its steps


def name_of(game: str, network: str) -> str:
    """Return the name of a network's agents in a game."""
    return f"{game}, {network}"


def find(work: Work) -> Findings:
    measured = outcomes.curves(work.runs).select(
        "agent", "seed", "steps", pl.col("training/return").cast(pl.Float64).alias("return")
    )
    ends, rows = {}, []
    for game, network in itertools.product(GAMES, SPEEDS):
        name = name_of(game, network)
        ends[game, network] = values = mean_return(measured, name, LAST)
        mean, low, high = over_agents(values[:, None])[:, 0].tolist()
        told = {"game": game, "network": network, "steps": work.plan.agents[name].steps}
        throughout = float(mean_return(measured, name, 1.0).mean())
        rows.append(told | {"mean": mean, "low": low, "high": high, "throughout": throughout})
    table = pl.DataFrame(rows)
    best = {
        game: table.filter(game=game).sort("throughout", descending=True).row(0, named=True)
        for game in GAMES
    }
    told = "; ".join(
        f"{game}: {row['network']} with {row['throughout']:z.1f}, and {row['mean']:z.1f} at the end"
        for game, row in best.items()
    )
    names = pl.col("agent").str.split(", ").list
    returns = charts.curves(
        measured.with_columns(game=names[0], network=names[1], mean="return").with_columns(
            seconds=pl.col("steps") / pl.col("network").replace_strict(SPEEDS)
        ),
        x="seconds", line="network", panel="game", each="seed", label="return in training",
        x_label="seconds of one processor",
    )  # fmt: skip
    return Findings(
        answer=f"In {SECONDS} seconds of one processor, as the benchmark times them, these return "
        f"most throughout training: {told}, of 10.",
        claims=[
            above(
                f"{game}: in the same time the network of patches learns more than the paper's.",
                "not measured",
                f"{OURS} minus {PAPER}",
                estimate_difference(*(ends[game, one][:, None] for one in (OURS, PAPER))),
                told=Estimate.change,
            )
            for game in GAMES
        ],
        plots=[
            Plot(
                "returns",
                "Return of recent training episodes by seconds of one processor, a "
                "line an agent; seconds are steps divided by the steps per second of the "
                "network.",
                returns,
                measured,
            )
        ],
        tables=[Table("ends", "Return in the last tenth of training, and throughout it", table)],
        settings=outcomes.settings(work.plan)
        | {"steps per second": ", ".join(f"{n}: {v:,}" for n, v in SPEEDS.items())},
    )


def mean_return(measured: pl.DataFrame, agent: str, fraction: float) -> np.ndarray:
    """Return the mean return in the last `fraction` of training, [seeds]; 0 without episodes."""
    mine = measured.filter(agent=agent).with_columns(pl.col("return").fill_null(0.0))
    last = mine.filter(pl.col("steps") > pl.col("steps").max() * (1 - fraction))
    return last.group_by("seed").agg(pl.col("return").mean()).sort("seed")["return"].to_numpy()


EXPERIMENT = Experiment(
    title="Networks for images",
    reproduces="nothing, a question of our own",
    question="Which network learns most from the paper's images in three minutes of one processor?",
    sizes={
        "pixels": Plan(
            agents={
                name_of(game, network): replace(config, network=network, steps=SECONDS * speed)
                for game, config in GAMES.items()
                for network, speed in SPEEDS.items()
            },
            seeds=3,
            levels=1,  # there are no tests
            differences="worlds of 7 cells, and levels of one or two sections without hazards; "
            "three minutes of one processor instead of 200 million steps",
        )
    },
    find=find,
)
