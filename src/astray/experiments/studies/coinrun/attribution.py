"""What in a picture the critic's value depends on: the end wall, or the coin."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import polars as pl

from astray.analysis.critic import observe, visit
from astray.analysis.estimates import Estimate, group_means, mean_of
from astray.analysis.runs import open_run
from astray.analysis.trained import Agent
from astray.envs.vector import picture
from astray.experiments import outcomes
from astray.experiments.claims import Claim
from astray.experiments.levels import levels_of
from astray.experiments.report import Findings, Plot, Table
from astray.experiments.spec import Experiment, Test, Work
from astray.experiments.studies.coinrun import _agents, _figures
from astray.experiments.studies.coinrun._agents import RUNNER
from astray.games.coinrun.edits import PARTS
from astray.insight import attribution

TESTS = {
    "in training": Test("coin-end", "coin-end"),
    "in the test": Test("coin-anywhere", "coin-end"),
}
# As long as nearly all that gets anywhere takes; who misses the coin stays for 1,000 steps.
BRIEF = {name: replace(test, knobs={"time_limit": 200}) for name, test in TESTS.items()}
METHODS: dict[str, Callable[[Agent, np.ndarray], np.ndarray]] = {
    "gradient": attribution.gradients,  # the paper's
    "integrated gradients": attribution.integrated_gradients,
    "occlusion": attribution.occlusion,
}
COIN, WALL = "coin", "end wall"
DRAWN = 3  # states of each episode
PIXELS = 208  # a side of a picture for people


def find(work: Work) -> Findings:
    """How much of each map is on each part of what is seen, and some maps."""
    table = work.keep("shares", lambda: shares(work))
    bars = group_means(table, "attribution", ["test", "method", "part"])
    by_size = group_means(table, "attribution", ["test", "method", "part"], per="area")
    gaps = {method: gap(table.filter(method=method)) for method in METHODS}
    walls = {
        row["test"]: Estimate.of(row)
        for row in by_size.filter(part=WALL, method="gradient").to_dicts()
    }
    examples = work.keep("maps", lambda: maps_of_some(work))
    return Findings(
        answer="Where both are in view, the end wall has "
        + "; ".join(
            f"{100 * one.wall.mean:.1f}\u00a0% of the attribution by {method} and the coin "
            f"{100 * one.coin.mean:.1f}\u00a0%"
            for method, one in gaps.items()
        )
        + ".",
        claims=[
            Claim(
                "The end wall is highlighted at least as much as the coin.",
                "at least as much (by eye)",
                "share of the gradient, end wall less coin, where both are in view: "
                f"{gaps['gradient'].less.percent()}; holds where the interval is not below 0",
                gaps["gradient"].less.low >= 0,
            ),
            Claim(
                "In training and in the test the end wall is assigned a large attribution.",
                "large (by eye)",
                "share of the gradient over share of the observation: "
                + "; ".join(f"{test} {times.amount()}" for test, times in walls.items())
                + "; holds where both intervals are above 1",
                len(walls) == len(TESTS) and all(times.low > 1 for times in walls.values()),
            ),
        ],
        plots=[
            Plot(
                "parts",
                "The share of attribution on each part, by three methods, with 95\u00a0% "
                "intervals over agents and levels; the mark is the part's share of what is seen, "
                "which it would have if it mattered no more than its size.",
                _figures.parts(bars, sizes(table)),
                bars,
            ),
            Plot(
                "maps",
                "Maps of some states: blue is what raises the value, red what lowers it.",
                _figures.maps(examples),
                examples,
            ),
        ],
        tables=[
            Table("shares", "Share of attribution on each part", bars),
            Table("by-size", "Share of attribution over share of what is seen", by_size),
        ],
        settings=outcomes.settings(work.plan)
        | {
            "states": f"up to {DRAWN} of each episode",
            "the paper and its code": "There eight pictures were looked at. Here parts are found "
            "in every state by drawing it without them. Of symbols, cells in which there is "
            "nothing are a part of their own, for a gradient asks what adding something would do.",
        },
    )


def visited(work: Work, where: str, seed: int) -> tuple[Agent, pl.DataFrame, np.ndarray]:
    """An agent, and states of its episodes in a test, with their rows."""
    test = work.plan.visited[where]
    agent, config = open_run(work.runs[RUNNER][seed])
    levels = levels_of(work.plan, test)
    rows, states = visit(agent, test.variant_for(work.plan.config), levels, per_episode=DRAWN)
    told = pl.lit(config.seed).alias("agent"), pl.lit(where).alias("test")
    return agent, rows.select("level", "step", *told), states


def shares(work: Work) -> pl.DataFrame:
    """A row for each state, method and part: agent, test, level, step, method, part, attribution,
    area."""
    parts = []
    for where in work.plan.visited:
        for seed in range(work.plan.seeds):
            agent, rows, states = visited(work, where, seed)
            variant = work.plan.visited[where].variant_for(work.plan.config)
            seen = attribution.masks(agent, variant, states, PARTS)
            shown = observe(agent, variant, states)
            for method, attribute in METHODS.items():
                told = attribution.shares(rows, attribute(agent, shown), seen)
                parts.append(told.with_columns(method=pl.lit(method)))
    return pl.concat(parts)


@dataclass(frozen=True)
class Gap:
    """The share of a map on the end wall and on the coin, of states in which both are seen."""

    wall: Estimate
    coin: Estimate
    less: Estimate  # the wall's share less the coin's


def gap(table: pl.DataFrame) -> Gap:
    """The gap in the rows of one method of `shares`."""
    keys = ["agent", "test", "level", "step"]
    wall, coin = (
        table.filter(part=part).filter(pl.col("area") > 0).select(*keys, part="attribution")
        for part in (WALL, COIN)
    )
    both = wall.join(coin, on=keys, suffix="_coin")
    less = pl.col("part") - pl.col("part_coin")
    return Gap(mean_of(both, "part"), mean_of(both, "part_coin"), mean_of(both, less))


def sizes(table: pl.DataFrame) -> pl.DataFrame:
    """The mean area of each part in each test."""
    return table.group_by("test", "part", maintain_order=True).agg(pl.col("area").mean())


def maps_of_some(work: Work) -> pl.DataFrame:
    """Of each test a state at the end wall, and one of which most is hazards: name, picture
    (values of grey), and the map of each method, as lists of rows."""
    found = []
    for where in work.plan.visited:
        agent, _, states = visited(work, where, 0)
        variant = work.plan.visited[where].variant_for(work.plan.config)
        seen = attribution.masks(agent, variant, states, PARTS)
        area = {part: mask.reshape(len(states), -1).sum(1) for part, mask in seen.items()}
        hazards = (area["walkers"] + area["saws"]) * (area[WALL] == 0)
        for what, much in (("the end wall", area[WALL]), ("hazards", hazards)):
            if not much.any():
                continue
            one = states[[int(much.argmax())]]
            shown = observe(agent, variant, one)
            row = {"name": f"{what}, {where}", "picture": grey(agent, variant, one)}
            for method, attribute in METHODS.items():
                row[method] = flat(attribute(agent, shown)[0]).tolist()
            found.append(row)
    return pl.DataFrame(found)


def grey(agent, variant, states: np.ndarray) -> list:
    """The picture of one state for people, [PIXELS, PIXELS] from 0 to 255."""
    shown = picture("coinrun", variant, states, PIXELS, agent.art)[0]
    return shown.mean(2).round().astype(int).tolist()


def flat(one: np.ndarray) -> np.ndarray:
    """A map as [H, W], planes added up, its largest absolute value 1."""
    added = one.sum(0) if one.ndim == 3 else one
    return added / max(abs(added).max(), np.finfo(float).tiny)


EXPERIMENT = Experiment(
    title="What the critic looks at",
    reproduces="Figure 8",
    question="What in view does the critic's value depend on: the coin, the end wall, hazards?",
    sizes={
        "smoke": _agents.plan("smoke", 2, 100, visited=TESTS),
        "pixels": _agents.plan("pixels", 3, 100, visited=TESTS),
        "hour": _agents.plan("hour", 1, 200, visited=TESTS),
        "paper": _agents.plan("paper", 3, 500, visited=TESTS),
        "published": _agents.plan("published", 1, 120, visited=BRIEF),
    },
    find=find,
    needs={"captum": "insight"},
)
