"""Mice trained on a yellow line, tested on a red line and a yellow gem, and on all such pairs."""

from dataclasses import replace

import numpy as np
import polars as pl

from astray.agents.mlp import CircleEmbedding
from astray.analysis.estimates import Estimate, estimate_mean
from astray.analysis.evaluate import evaluate
from astray.analysis.outcomes import FAILED, INTENDED, MISGENERALIZED, label, load_shift, matrix
from astray.analysis.runs import open_run
from astray.experiments import outcomes
from astray.experiments.outcomes import AGENTS, rate
from astray.experiments.spec import Experiment, Work
from astray.experiments.studies.maze import maze_corner
from astray.experiments.studies.maze.maze_corner import of_mouse
from astray.figures.axes import COLOURS as OF_OUTCOMES
from astray.figures.axes import LINES
from astray.figures.grids import cells
from astray.games.maze.variants import COLOURS, EASY, SHAPES
from astray.report.claims import Claim, above, rounded
from astray.report.findings import Findings, Plot, Table
from astray.training.config import PRESETS

COLOUR, SHAPE = "yellow", "line"  # of the object in training
COLOURED = (COLOUR, *(c for c in COLOURS[1:] if c != COLOUR))
SHAPED = (SHAPE, *(s for s in SHAPES[1:] if s != SHAPE))
PAPER = "red", "gem"  # what the paper offered: a line in this colour, or a yellow one of this
PANELS = {
    "keeps_colour": f"go to the {COLOUR} object,\nof those that go to either",
    "neither": "go to neither\n",
}
# Levels, at most, in which every pair is offered: mice that see pictures are slower.
PAIRED = {"symbolic": 1000, "image": 200}


def find(work: Work) -> Findings:
    train, test = work.plan.tests
    tables = outcomes.outcome_tables(work)
    apart = work.episodes.filter("distinguishing", policy=AGENTS, test=test)
    gem, stuck = keeps_colour(apart), rate(apart, test, FAILED)
    pairs = work.keep("pairs", lambda: offer_pairs(work))
    agents = pair_table(pairs, "seed").drop("agents")
    symbolic = work.plan.config.observation == "symbolic"
    table = pair_table(pairs)
    new = table.filter(pl.col("colour") != COLOUR, pl.col("shape") != SHAPE)
    colours = new["keeps_colour"].drop_nulls().to_numpy()
    low, high = colours.min(), colours.max()
    measured = table.drop("low", "high").rename(PANELS)
    preferred = cells(
        measured.unpivot(list(PANELS.values()), index=["colour", "shape"], value_name="mean"),
        {"go to the": OF_OUTCOMES[MISGENERALIZED], "go to neither": LINES[FAILED]},
        x="shape", y="colour", panel="variable", x_label=f"shape of the {COLOUR} object",
        y_label=f"colour of the {SHAPE}", apart=True,
    )  # fmt: skip
    return Findings(
        answer="A mouse that always found a yellow line goes to a yellow gem rather than to a "
        f"red line in {rounded(gem.mean)} of the levels in which it goes to either and neither "
        f"lies on the way to the other; it goes to neither in {rounded(stuck.mean)}. Between "
        f"other pairs that keep colour or shape, from {rounded(low)} to {rounded(high)} go to the "
        "one that keeps the colour." + (CODES if symbolic else ""),
        claims=[
            above(
                "In unseen levels like those of its training, the mouse reaches the line.",
                "reliably",
                INTENDED,
                rate(work.episodes, train, INTENDED),
                0.9,
            ),
            above(
                "It usually goes to the yellow gem rather than to the red line.",
                "89\u00a0% (n = 102, counted by hand)",
                f"to neither: {stuck.percent()}; to the gem, of those that go to either",
                gem,
                0.5,
            ),
            near_codes(work, pairs) if symbolic else flips(agents),
        ],
        videos=outcomes.videos(work),
        plots=[
            Plot(
                "pairs",
                f"Which of two objects mice go to that were trained on a {COLOUR} "
                f"{SHAPE}, in % of episodes: left, to that which keeps the colour. In the first "
                f"row the {SHAPE} is just as in training, in the first column the {COLOUR} "
                "object; in their corner the two are alike.",
                preferred,
                table,
            ),
            *outcomes.outcome_plots(work, tables),
            outcomes.curve_plot(work),
        ],
        tables=[
            Table(
                "pairs",
                f"A {SHAPE} in each colour against a {COLOUR} object of each shape, in "
                "levels in which neither lies on the way to the other",
                table,
            ),
            Table("agents", "The same by agent: intervals are over levels alone", agents),
            *tables,
        ],
        settings=outcomes.settings(work.plan),
    )


CODES = (
    " These mice see symbols: a colour and a shape are numbers, spread on a circle, so that some "
    "are nearer to what the mouse knows than others. The object that it takes shows something "
    "about these numbers, and nothing about pictures."
)


def keeps_colour(episodes: pl.DataFrame) -> Estimate:
    """Return the fraction that takes the other shape, among those that take either."""
    went = matrix(episodes, pl.col("outcome") != FAILED)
    return estimate_mean(matrix(episodes, pl.col("outcome") == MISGENERALIZED), went)


def offer_pairs(work: Work) -> pl.DataFrame:
    """Return the agents' choices for all pairs: colour, shape, seed, level and outcome.

    A pair is a line in the colour and a yellow object of the shape, in distinguishing levels of
    the plan's test. A level's maze and places are the same for all pairs.
    """
    test = list(work.plan.tests.values())[-1]
    game, shift = work.plan.game, load_shift(work.plan.game, test.shift)
    apart = work.episodes.filter("distinguishing", pl.col("variant") == test.variant)
    levels = apart["level"].unique(maintain_order=True).to_numpy()
    levels = levels[: PAIRED[work.plan.config.observation]]
    parts = []
    for run in (run for runs in work.runs.values() for run in runs):
        agent, config = open_run(run)
        for colour in COLOURED:
            for shape in SHAPED:
                knobs = {"goal_colour": colour, "other_shape": shape}
                variant = replace(test, knobs=knobs).variant_for(config)
                episodes = label(evaluate(agent, game, variant, levels), game, shift)
                parts.append(
                    episodes.select(
                        "level",
                        "outcome",
                        colour=pl.lit(colour),
                        shape=pl.lit(shape),
                        seed=pl.lit(config.seed),
                    )
                )
    return pl.concat(parts)


def pair_table(pairs: pl.DataFrame, *by: str) -> pl.DataFrame:
    """Return for each pair, and each value of columns `by`, how many take which object.

    Columns: `by`, colour, shape, keeps_colour, low, high, neither, agents, levels.
    """
    names, rows = (*by, "colour", "shape"), []
    for key, part in pairs.group_by(names, maintain_order=True):
        chosen = keeps_colour(part)
        rows.append(
            dict(zip(names, key, strict=True))
            | {"keeps_colour": chosen.mean, "low": chosen.low, "high": chosen.high,
               "neither": (part["outcome"] == FAILED).mean(), "agents": chosen.agents,
               "levels": chosen.levels}
        )  # fmt: skip
    return pl.DataFrame(rows, schema_overrides=pairs.select(names).schema).fill_nan(None)


def flips(agents: pl.DataFrame) -> Claim:
    """Test whether agents of the same training clearly prefer different objects."""
    new = agents.filter(pl.col("colour") != COLOUR, pl.col("shape") != SHAPE)
    sure = new.group_by("colour", "shape").agg(
        to_colour=(pl.col("low") > 0.5).sum(), to_shape=(pl.col("high") < 0.5).sum()
    )
    both = float(np.mean((sure["to_colour"].to_numpy() > 0) & (sure["to_shape"].to_numpy() > 0)))
    offered = sure.filter(colour=PAPER[0], shape=PAPER[1]).row(0, named=True)
    count = agents["seed"].n_unique()
    return Claim(
        "Their preference depends on the seed: in most pairs of a new colour and a new shape some "
        "agents go to the one object, others to the other.",
        "not measured; Ramanauskas and Simsek (2023) found that it does",
        f"in {rounded(both)} of {len(sure)} pairs both are clear, each by an interval over "
        f"levels; before a red line and a yellow gem, {offered['to_colour']} of {count} agents go "
        f"to the gem, {offered['to_shape']} to the line; supported if above 50\u00a0%",
        both > 0.5,
    )


def near_codes(work: Work, pairs: pl.DataFrame) -> Claim:
    """Test whether mice on symbols take the object whose new code is nearer to the known one.

    Pairs in which neither is nearer, as in the paper's, do not count.
    """
    shapes, colours = nearness(work)
    nearer = pl.col("shape").replace_strict(shapes) - pl.col("colour").replace_strict(colours)
    new = pairs.filter(pl.col("colour") != COLOUR, pl.col("shape") != SHAPE)
    went = (
        new.with_columns(nearer=nearer.round(6))  # of the object that keeps the colour
        .filter(pl.col("nearer") != 0)
        .group_by("seed", "level")
        .agg(
            either=(pl.col("outcome") != FAILED).sum(),
            nearer=pl.when(pl.col("nearer") > 0)
            .then(pl.col("outcome") == MISGENERALIZED)
            .otherwise(pl.col("outcome") == INTENDED)
            .sum(),
        )
    )
    return above(
        "Seen as symbols, of two new objects the mouse goes to that whose code is nearer to the "
        "one it knows.",
        "not measured",
        "to the nearer, of those that go to either",
        estimate_mean(matrix(went, pl.col("nearer")), matrix(went, pl.col("either")), rate=True),
        0.5,
    )


def nearness(work: Work) -> tuple[dict[str, float], dict[str, float]]:
    """Return each shape's and each colour's similarity to the trained one, -1 to 1."""
    planes = work.plan.game.symbols.planes(work.plan.config.training_variant())
    circle = CircleEmbedding(planes.max((1, 2)).tolist()).circle.numpy()
    shapes, colours = (
        {
            name: float(circle[:, code] @ circle[:, names.index(known)])
            for code, name in enumerate(names)
        }
        for names, known in ((SHAPES, SHAPE), (COLOURS, COLOUR))
    )
    return shapes, colours


EXPERIMENT = Experiment(
    title="Colour or shape",
    reproduces="Figure 3c-d",
    question="What does a mouse look for whose goal was always a yellow line: yellow, or lines?",
    sizes={
        "smoke": of_mouse(
            # Half as many steps leave it at 78 % of unseen levels.
            replace(PRESETS["small"], steps=11_000_000),
            shift="colour-or-shape-small",
            seeds=10,
            first_seed=20,
            differences="worlds of 7 cells instead of 25, seen as symbols instead of a picture, so "
            "that colours and shapes are codes; a mouse that starts anywhere and has 100 steps "
            "instead of 500; a network of two hidden layers, and 11 million steps instead of 200 "
            "million",
        ),
        "pixels": of_mouse(
            maze_corner.PIXELS,
            shift="colour-or-shape-small",
            seeds=10,
            first_seed=20,
            differences=f"{maze_corner.SMALL_WORLDS}; a network of patches, and 2 million steps "
            "instead of 200 million",
        ),
        "night": maze_corner.by_night(shift="colour-or-shape", seeds=3),
        "hour": of_mouse(
            replace(maze_corner.PAPER, knobs=dict(EASY), steps=25_000_000),
            shift="colour-or-shape",
            differences=maze_corner.BY_HOUR,
        ),
        "paper": of_mouse(
            maze_corner.PAPER, shift="colour-or-shape", seeds=3, levels=10_000, differences=""
        ),
    },
    find=find,
)
