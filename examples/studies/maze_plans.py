"""Does a mouse that ticks plan its way, and to the proxy where the goals come apart?

    astray reproduce examples/studies/maze_plans.py

Bounds of its claims were set on 2026-11-24, before any run. The training was shortened from 600,000
steps on 2026-11-25, as a first mouse had a return of 9.6 of 10 after 125,000; nothing else was
looked at, and that mouse (seed 0) is not one of these.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl

from astray.analysis.critic import visit
from astray.analysis.estimates import estimate_mean
from astray.analysis.runs import open_run
from astray.estimate import Estimate
from astray.experiments import outcomes
from astray.experiments.levels import levels_of
from astray.experiments.spec import Experiment, Plan, Work, tests_of
from astray.games.maze.measures import direction, offset
from astray.insight import probes
from astray.insight.activations import capture
from astray.insight.cell_probes import ahead, at_cells, fit
from astray.report.claims import above, below, rounded
from astray.report.findings import Findings, Table
from astray.training.config import PRESETS

MOUSE = "mouse that ticks"
TRAIN, TEST = "in training", "in the test"
SEEN, TICK, LAST = "encoder.conv1", "tick2", "features.relu"
BEFORE, AFTER, CHEESE, CORNER, FIRST = (
    "cells ahead, before the ticks", "cells ahead, after the ticks", "direction of the cheese",
    "direction of the corner", "corner ahead rather than cheese",
)  # fmt: skip
PUBLISHED = {(CHEESE, TRAIN): 0.85, (CHEESE, TEST): 0.07}  # split-maze, one agent, another network
READABLE, LOST = 0.7, 0.5  # bounds of the claims


def find(work: Work) -> Findings:
    """Measure what probes that were fitted in training read in training, and in the test."""
    rows = work.keep(
        "readings",
        lambda: pl.concat([readings(work, k, run) for k, run in enumerate(work.runs[MOUSE])]),
    )
    places = [(AFTER, TRAIN), (AFTER, TEST), (CHEESE, TRAIN), (CHEESE, TEST), (FIRST, TEST)]
    seen, moved, there, lost, corner = (of(rows, *where) for where in places)
    tables = outcomes.outcome_tables(work)
    return Findings(
        answer=f"Off its last tick, the cells that a mouse will step on are read with a balanced "
        f"accuracy of {rounded(seen.mean)} in training, and of {rounded(moved.mean)} where the "
        f"cheese is anywhere, by the same probe. The direction of the cheese is read with "
        f"{rounded(there.mean)} and {rounded(lost.mean)}.",
        claims=[
            above(
                "In training, the cells that it will step on are read off its ticks.",
                "none", "balanced accuracy", seen, READABLE, told=Estimate.amount,
            ),
            above(
                "Where the cheese is anywhere, the same probe still reads them.",
                "none", "balanced accuracy", moved, READABLE, told=Estimate.amount,
            ),
            above(
                "Where a level distinguishes the goals, its map has the corner at the first step, "
                "rather than the cheese.",
                "none", "probability at the corner minus at the cheese", corner,
                told=Estimate.amount,
            ),
            below(
                "There, the direction of the cheese is no longer read off its last layer.",
                "split-maze: 0.85 in training, 0.07 in the test",
                "balanced accuracy", lost, LOST, told=Estimate.amount,
            ),
        ],
        plots=[*outcomes.outcome_plots(work, tables), outcomes.curve_plot(work)],
        tables=[Table("readings", "What probes fitted in training read", table(rows)), *tables],
        settings=outcomes.settings(work.plan)
        | {
            "probes": "fitted in 7 of 10 levels of training, read in the other 3, and in the test; "
            "one for all cells, which sees the channels at a cell alone; the "
            "mouse plays on, and remembers; chance is 0.5, and 0.25 for directions",
        },
    )  # fmt: skip


def readings(work: Work, seed: int, run: Path) -> pl.DataFrame:
    """Return what probes read of an agent: seed, what, where, score."""
    agent, _ = open_run(run)
    kept = {}
    for where, test in work.plan.tests.items():
        variant = test.variant_for(work.plan.config)
        _, states = visit(agent, variant, levels_of(work.plan, test))
        layers = capture(agent, variant, states, [SEEN, TICK, LAST], episodes=True).values
        cells = {name: at_cells(agent, variant, layers[name]) for name in (SEEN, TICK)}
        kept[where] = states, cells, layers[LAST], ahead(states, int(variant.records()[0]["world"]))
    states, cells, _, truth = kept[TRAIN]
    learn = probes.split(states["level"], 0)
    found = {}
    for what, name in ((BEFORE, SEEN), (AFTER, TICK)):
        probe = fit(cells[name][learn], truth[learn], states["level"][learn])
        for where, (s, c, _, t) in kept.items():
            some = ~learn if where == TRAIN else slice(None)
            found[what, where] = probe.score(c[name][some], t[some], s["level"][some]).mean
    apart = work.episodes.filter("distinguishing", test=TEST)["level"].unique().to_numpy()
    states, cells, *_ = kept[TEST]
    first = (states["time"] == 0) & np.isin(states["level"], apart)
    maps = probe.map(cells[TICK][first])
    found[FIRST, TEST] = np.mean(at(maps, states[first], "corner") - at(maps, states[first]))
    for what, goal in ((CHEESE, "cheese"), (CORNER, "corner")):
        for where, (s, _, last, _) in kept.items():
            more = [] if where == TRAIN else [(s, last)]
            parts = [(kept[TRAIN][0], kept[TRAIN][2]), *more]
            y, x = np.concatenate([direction(a, goal) for a, _ in parts]), [b for _, b in parts]
            mask = learn if where == TRAIN else np.arange(len(y)) < len(learn)
            known = y >= 0
            found[what, where] = probes.fit(np.concatenate(x)[known], y[known], mask[known], 0)
    return pl.DataFrame(
        [
            {"seed": seed, "what": what, "where": where, "score": float(score)}
            for (what, where), score in found.items()
        ]
    )


def at(maps: np.ndarray, states: np.ndarray, goal: str = "cheese") -> np.ndarray:
    """Return the values of maps [N, H, W] at a goal's cell in states [N]."""
    x, y = (states[axis] + offset(states, goal, k) for k, axis in enumerate("xy"))
    return maps[np.arange(len(maps)), y.astype(int), x.astype(int)]


def of(rows: pl.DataFrame, what: str, where: str) -> Estimate:
    """Return the mean over agents of a reading, with its interval."""
    scores = rows.filter(what=what, where=where).sort("seed")["score"].to_numpy()
    return estimate_mean(scores[:, None], rate=False)


def table(rows: pl.DataFrame) -> pl.DataFrame:
    """Return the means over agents of all readings, beside the published ones."""
    return pl.DataFrame(
        [
            {
                "what": what, "where": where, "mean": one.mean, "low": one.low, "high": one.high,
                "agents": one.agents, "published": PUBLISHED.get((what, where)),
            }
            for what, where in rows.select("what", "where").unique(maintain_order=True).rows()
            for one in [of(rows, what, where)]
        ],
        schema_overrides={"published": pl.Float64},
    )  # fmt: skip


EXPERIMENT = Experiment(
    title="Plans in mazes",
    reproduces="split-maze's reading of the direction of the cheese, with another network",
    question="Can the way that a mouse will take be read off its ticks, cell by cell, and does it "
    "lead to the corner where the cheese is elsewhere?",
    sizes={
        "smoke": Plan(
            agents={
                MOUSE: replace(
                    PRESETS["small"],
                    variant="corner-small",
                    validation="anywhere-small",
                    network="drc-1-2",
                    steps=150_000,
                    num_envs=64,
                    num_steps=32,
                    minibatches=4,
                    learning_rate=1e-3,
                )
            },
            seeds=3,
            first_seed=10,
            tests=tests_of("maze", "corner-small"),
            levels=1000,
            differences="worlds of 7 cells, seen as symbols; a DRC of one layer and two ticks",
        )
    },
    find=find,
    needs={"sklearn": "insight"},
)
