"""Does the critic's value depend on the end wall, or on the coin?"""

import textwrap
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from astray.analysis.critic import observe, visit
from astray.analysis.estimates import Estimate, group_means, mean_of, minus
from astray.analysis.runs import open_run
from astray.analysis.trained import Agent
from astray.envs.pictures import picture
from astray.experiments import outcomes
from astray.experiments.levels import levels_of
from astray.experiments.spec import Experiment, Test, Work
from astray.experiments.studies.coinrun import _agents
from astray.experiments.studies.coinrun._agents import RUNNER
from astray.figures import charts
from astray.figures.grids import FADED, SIGNS, Picture, images
from astray.games.coinrun.edits import PARTS
from astray.insight import attribution
from astray.insight.probes import untrained
from astray.report.claims import Claim, above
from astray.report.claims import every as every_one
from astray.report.findings import Findings, Plot, Table

TESTS = {
    "in training": Test("coin-end", "coin-end"),
    "in the test": Test("coin-anywhere", "coin-end"),
}
BRIEF = 200  # steps: what nearly all that gets anywhere takes; who misses the coin stays for 1,000
METHODS: dict[str, Callable[[Agent, np.ndarray], np.ndarray]] = {
    "gradient": attribution.gradients,  # the paper's
    "integrated gradients": attribution.integrated_gradients,
    "occlusion": attribution.occlusion,
}
COIN, WALL = "coin", "end wall"
TRAINED, UNTRAINED = "trained", "never trained"
NETWORKS = 6  # that were never trained, at least
CHANGE = Estimate.change
DRAWN = 3  # states of each episode
PIXELS = 208  # a side of a picture for people


def find(work: Work) -> Findings:
    every = work.keep("fractions", lambda: fractions(work))
    table, blanks = (every.filter(network=name) for name in (TRAINED, UNTRAINED))
    bars = group_means(table, "attribution", ["test", "method", "part"])
    by_size = group_means(table, "attribution", ["test", "method", "part"], per="area")
    gaps = {method: gap(table.filter(method=method)) for method in METHODS}
    dense, chance = (per_area(part.filter(method="gradient")) for part in (table, blanks))
    ratios = group_means(blanks, "attribution", ["test", "method", "part"], per="area")
    examples = work.keep("maps", lambda: maps_of_some(work))
    parts = charts.points(
        pl.concat([sizes(table), bars], how="diagonal_relaxed"), row="part", group="method",
        panel="test", percent=True, label="fraction of attribution",
    )  # fmt: skip
    return Findings(
        answer="Where both are in view, the end wall has "
        + "; ".join(
            f"{100 * one.wall.mean:.1f}\u00a0% of the attribution by {method} and the coin "
            f"{100 * one.coin.mean:.1f}\u00a0%"
            for method, one in gaps.items()
        )
        + f". For its size, by gradient, the wall has {dense.wall.mean:.2f} times what it would "
        f"have if all places were alike, and the coin {dense.coin.mean:.2f} times (networks that "
        f"were never trained: {chance.wall.mean:.2f} and {chance.coin.mean:.2f}).",
        claims=claims(table, blanks),
        plots=[
            Plot(
                "parts",
                "The fraction of attribution on each part, by three methods, with 95\u00a0% "
                "intervals; the mark is the part's fraction of what is seen, "
                "which it would have if it mattered no more than its size.",
                parts,
                bars,
            ),
            Plot(
                "maps",
                "Maps of some states: blue is what raises the value, red what lowers it.",
                images([pictures(one) for one in examples.to_dicts()], (2.0, 2.2)),
                examples,
            ),
        ],
        tables=[
            Table("fractions", "Fraction of attribution on each part", bars),
            Table("by-size", "Fraction of attribution over fraction of what is seen", by_size),
            Table("untrained", "The same of networks that were never trained", ratios),
        ],
        settings=outcomes.settings(work.plan)
        | {
            "states": f"up to {DRAWN} of each episode",
            "the paper and its code": "There eight pictures were looked at. Here parts are found "
            "in every state by drawing it without them. In symbols, empty cells are "
            "a part of their own, because a gradient asks what adding something would do.",
        },
    )


def claims(trained: pl.DataFrame, untrained: pl.DataFrame) -> list[Claim]:
    """Return the paper's claims, relative to a part's size and to untrained networks.

    The wall has a hundred times the coin's area, so every network has more attribution there.
    """
    rows = [part.filter(method="gradient") for part in (trained, untrained)]
    own, chance = (per_area(part).difference for part in rows)
    walls, blank = (
        {
            row["test"]: Estimate.of(row)
            for row in group_means(part, "attribution", ["test", "part"], per="area").to_dicts()
            if row["part"] == WALL
        }
        for part in rows
    )
    nothing = Estimate.nothing()
    large = []
    for test in TESTS:
        times, by_chance = (found.get(test, nothing) for found in (walls, blank))
        large += [
            above("", "", f"fraction over size, {test}", times, 1, told=Estimate.amount),
            above("", "", "minus untrained", minus(times, by_chance), told=CHANGE),
        ]
    return [
        every_one(
            "For its size the end wall is highlighted at least as much as the coin, and more so "
            "than by networks that were never trained.",
            "at least as much (by eye)",
            [
                above("", "", "per area, end wall minus coin", own, told=CHANGE),
                above("", "", "that, minus untrained", minus(own, chance), told=CHANGE),
            ],
        ),
        every_one(
            "In training and in the test the end wall is assigned a large attribution.",
            "large (by eye)",
            large,
        ),
    ]


def visited(work: Work, where: str, seed: int) -> tuple[Agent, pl.DataFrame, np.ndarray]:
    """Return an agent, rows of its episodes in a test, and their states [rows]."""
    test = work.plan.visited[where]
    agent, config = open_run(work.runs[RUNNER][seed])
    levels = levels_of(work.plan, test)
    rows, states = visit(agent, test.variant_for(work.plan.config), levels, per_episode=DRAWN)
    told = pl.lit(config.seed).alias("agent"), pl.lit(where).alias("test")
    return agent, rows.select("level", "step", *told), states


def fractions(work: Work) -> pl.DataFrame:
    """Return a row per state, method and part.

    Columns: agent, network, test, level, step, method, part, attribution, area. Untrained networks
    of the same shape are included, in the same states, by gradient.
    """
    parts = []
    for where in work.plan.visited:
        for seed in range(work.plan.seeds):
            agent, rows, states = visited(work, where, seed)
            variant = work.plan.visited[where].variant_for(work.plan.config)
            seen = attribution.masks(agent, variant, states, PARTS)
            shown = observe(agent, variant, states)
            for method, attribute in METHODS.items():
                told = attribution.fractions(rows, attribute(agent, shown), seen)
                parts.append(told.with_columns(method=pl.lit(method), network=pl.lit(TRAINED)))
            for number in range(-(-NETWORKS // work.plan.seeds)):
                named = rows.with_columns(agent=pl.lit(NETWORKS * seed + number))
                maps = METHODS["gradient"](untrained(agent, NETWORKS * seed + number), shown)
                told = attribution.fractions(named, maps, seen)
                parts.append(
                    told.with_columns(method=pl.lit("gradient"), network=pl.lit(UNTRAINED))
                )
    return pl.concat([part.with_columns(pl.col("agent").cast(pl.Int64)) for part in parts])


@dataclass(frozen=True)
class Gap:
    """Fractions of a map on the end wall and on the coin, in states with both in view."""

    wall: Estimate
    coin: Estimate
    difference: Estimate  # the wall's fraction minus the coin's


def gap(table: pl.DataFrame, value: str = "attribution") -> Gap:
    """Return the gap in the rows of one method of `fractions`."""
    keys = ["agent", "test", "level", "step"]
    wall, coin = (
        table.filter(part=part).filter(pl.col("area") > 0).select(*keys, part=value)
        for part in (WALL, COIN)
    )
    both = wall.join(coin, on=keys, suffix="_coin")
    difference = pl.col("part") - pl.col("part_coin")
    return Gap(mean_of(both, "part"), mean_of(both, "part_coin"), mean_of(both, difference))


def per_area(table: pl.DataFrame) -> Gap:
    """Return the `gap` relative to area: the wall is many times larger than the coin."""
    return gap(table.with_columns(dense=pl.col("attribution") / pl.col("area")), "dense")


def sizes(table: pl.DataFrame) -> pl.DataFrame:
    """Return the mean area of each part in each test."""
    return table.group_by("test", "part", maintain_order=True).agg(
        mean=pl.col("area").mean(), method=pl.lit("fraction of what is seen")
    )


def maps_of_some(work: Work) -> pl.DataFrame:
    """Return maps of two states per test: one at the end wall, and one with many hazards.

    Columns: name, picture (grey values), and the map of each method, as lists of rows.
    """
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
            grey = picture("coinrun", variant, one, PIXELS, agent.art)[0].mean(2).round()
            row = {"name": f"{what}, {where}", "picture": grey.astype(int).tolist()}
            for method, attribute in METHODS.items():
                row[method] = flat(attribute(agent, shown)[0]).tolist()
            found.append(row)
    return pl.DataFrame(found)


def pictures(example: dict[str, Any]) -> list[Picture]:
    """Draw a row of `maps_of_some`: its picture, and each method's map over a pale one."""
    image = np.array(example["picture"]) / 255
    found = [Picture(textwrap.fill(example["name"], 26), image)]
    for method in METHODS:
        map_ = np.array(example[method])
        pale = 1 - 0.35 * (1 - image)
        found.append(Picture(method, pale, map_, (-1, 1), SIGNS, opacity=FADED))
    return found


def flat(one: np.ndarray) -> np.ndarray:
    """Sum a map [H, W] or [C, H, W] to [H, W], with largest absolute value 1."""
    added = one.sum(0) if one.ndim == 3 else one
    return added / max(abs(added).max(), np.finfo(float).tiny)


EXPERIMENT = Experiment(
    title="What the critic looks at",
    reproduces="Figure 8",
    question="What in view does the critic's value depend on: the coin, the end wall, hazards?",
    sizes=_agents.plans(
        {"smoke": 100, "pixels": 100, "night": 100, "hour": 200, "paper": 500, "published": 120},
        visited=TESTS,
        brief=BRIEF,
    ),
    find=find,
    needs={"captum": "insight"},
)
