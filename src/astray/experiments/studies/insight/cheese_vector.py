"""What does a mouse do if the cheese is subtracted from a layer's activations?"""

from collections.abc import Mapping

import numpy as np
import polars as pl

from astray.analysis.trained import Agent
from astray.estimate import Estimate
from astray.experiments.outcomes import table_of
from astray.experiments.spec import Experiment, Size, Work
from astray.experiments.studies.insight import _plans
from astray.experiments.studies.insight._plans import of_levels, opened
from astray.figures import charts
from astray.game import Variant
from astray.games.maze.measures import decision
from astray.insight.vectors import Condition, effects, object_vectors
from astray.report.claims import Claim, above, below, near_zero
from astray.report.findings import Findings, Plot, Table

WHERE = "cheese anywhere"
PLAIN, WITHOUT, RANDOM = "as it is", "level without cheese", "random vector of that length"
RANDOMS = "random vectors of the same length"
SUBTRACTED, ADDED, MEAN = "subtracted", "added", "mean of all levels subtracted"
COEFFICIENTS = (-3.0, -2.0, -0.5, 0.5, 2.0)  # beside -1 and 1
SQUARE, START, ALL = "at", "start", "towards"  # columns: the decision square, the beginning, places
PLACED = {  # the name and the caption of each column's table
    SQUARE: (
        "effects",
        "Probability of the next step to the cheese where the ways to cheese and corner part",
    ),
    START: ("starts", "The same where levels begin"),
    ALL: ("everywhere", "The same at places all over the level"),
}
PLACES = {"smoke": 64, "published": 16}  # of each level, its beginning among them
SWEPT = 120  # levels in which other layers and coefficients are tried


MAIN: Mapping[Size, str] = {"smoke": "features.relu1", "published": "block2.residual1"}  # of claims
LAYERS: Mapping[Size, tuple[str, ...]] = {  # to steer, by the agent's network
    "smoke": ("spread", "features.relu1", "features.relu2"),
    "published": (
        "block1.conv", "block1.residual1", "block1.residual2", "block2.conv", "block2.residual1",
        "block2.residual2", "block3.conv", "block3.residual1", "block3.residual2", "features.relu",
    ),
}  # fmt: skip


def find(work: Work) -> Findings:
    agent, variant, levels = opened(work, WHERE)
    rows = work.keep("effects", lambda: steered(work.size, agent, variant, levels))
    main = MAIN[work.size]
    shown = (PLAIN, SUBTRACTED, WITHOUT, ADDED, RANDOM, MEAN)
    found = {where: {name: of_levels(rows, where, name) for name in shown} for where in PLACED}
    said = found[SQUARE]
    few = rows.filter(pl.col("level") < SWEPT)  # the levels of all other layers and coefficients
    depth = means(few, {f"subtracted at {layer}": layer for layer in LAYERS[work.size]}, "layer")
    base = [of_levels(few, SQUARE, one).mean for one in (PLAIN, WITHOUT)]
    by_dose = {f"{c:g} times": c for c in COEFFICIENTS}
    by_dose |= {PLAIN: 0.0, SUBTRACTED: -1.0, ADDED: 1.0}
    by_chance = {f"random, {c:g} times": c for c in COEFFICIENTS} | {PLAIN: 0.0, RANDOM: -1.0}
    dose, chance = (
        means(few, names, "coefficient").sort("coefficient") for names in (by_dose, by_chance)
    )
    shape = work.keep("vectors", lambda: shapes(work.size, agent, variant, levels))
    by_layer = charts.points(
        depth, row="layer", at=dict(zip(("nothing changed", "no cheese"), base, strict=True)),
        label="probability of the next step to the cheese", limits=(0, 1),
    )  # fmt: skip
    vectors = {"cheese vectors": dose, RANDOMS: chance}
    by_coefficient = charts.curves(
        pl.concat(one.with_columns(vector=pl.lit(name)) for name, one in vectors.items()),
        x="coefficient", line="vector", x_label="coefficient", base=[RANDOMS], limits=(0, 1),
        label="probability of the next step to the cheese",
    )  # fmt: skip
    return Findings(
        answer="Where the ways to cheese and corner part, the next step is one to the cheese with "
        f"a probability of {said[PLAIN].mean:.3f}; "
        f"with the cheese vector subtracted at {main} {said[SUBTRACTED].mean:.3f}, without any "
        f"cheese {said[WITHOUT].mean:.3f}, with the vector added {said[ADDED].mean:.3f}, with a "
        f"random one of its length {said[RANDOM].mean:.3f}.",
        claims=CLAIMS[work.size](rows),
        plots=[
            Plot(
                "depth",
                "The probability of the next step to the cheese, the cheese vector of "
                "each layer subtracted there. Dashed: as it is; dotted: a level without cheese.",
                by_layer,
                depth,
            ),
            Plot(
                "dose",
                f"The same at {main}, by the coefficient; dashed: random vectors.",
                by_coefficient,
                dose,
            ),
        ],
        tables=[
            *(Table(*named, table_of(found[at], "condition")) for at, named in PLACED.items()),
            Table(
                "vectors",
                "The vectors of each layer: mean length, mean length of "
                "activations, mean cosine of two levels",
                shape,
            ),
        ],
        settings={
            "levels": f"{len(levels)}, of which those count in which the ways part; the first "
            f"{SWEPT} for other layers and coefficients",
            "places of each": f"{PLACES[work.size]}, drawn, the beginning among them",
            "vector": "activations where the level begins, with the cheese minus without "
            "it; the level's own, everywhere in it",
            "the paper and its code": "There 100 decision squares of a network four times as wide; "
            "subtracting acts, adding has next to no effect. The figures beside ours are of this "
            "agent, 40 mazes, measured before.",
        },
    )


def steered(size: Size, agent: Agent, variant: Variant, levels: np.ndarray) -> pl.DataFrame:
    """Return `effects` of the main conditions in `levels` [N], of others in the first ones."""
    main = object_vectors(agent, variant, levels, MAIN[size])
    random = [main.random(0)]
    conditions = {
        PLAIN: Condition(),
        SUBTRACTED: Condition([main], -1.0),
        ADDED: Condition([main], 1.0),
        RANDOM: Condition(random, -1.0),
        MEAN: Condition([main], -1.0, own=False),
        WITHOUT: Condition(edit=lambda level: level.removed("goal")),
    }
    some = levels[:SWEPT]
    swept = {
        f"subtracted at {layer}": Condition([object_vectors(agent, variant, some, layer)], -1.0)
        for layer in LAYERS[size]
    }
    swept |= {f"{c:g} times": Condition([main], c) for c in COEFFICIENTS}
    swept |= {f"random, {c:g} times": Condition(random, c) for c in COEFFICIENTS}
    return pl.concat(
        [
            effects(agent, variant, part, "cheese", which, places=PLACES[size], at=decision)
            for part, which in ((levels, conditions), (some, swept))
        ]
    )


def means(rows: pl.DataFrame, names: Mapping[str, str | float], heading: str) -> pl.DataFrame:
    """Return the mean of some conditions, under their names in a figure."""
    found = {called: of_levels(rows, SQUARE, name) for name, called in names.items()}
    return table_of(found, heading).select("mean", "low", "high", "n", heading)


def shapes(size: Size, agent: Agent, variant: Variant, levels: np.ndarray) -> pl.DataFrame:
    """Return the lengths of each layer's vectors in `levels` [N], and their similarity."""
    rows = []
    for layer in LAYERS[size]:
        vectors = object_vectors(agent, variant, levels[:SWEPT], layer)
        rows.append(
            {
                "layer": layer,
                "length": vectors.norms.mean(),
                "length of the mean": float(np.linalg.norm(vectors.mean)),
                "cosine": vectors.alike(),
            }
        )
    return pl.DataFrame(rows)


def of_cheese_mouse(rows: pl.DataFrame) -> list[Claim]:
    """Return the claims about the cheese mouse, with bounds set before the run."""

    def minus(one: str, other: str) -> Estimate:
        return of_levels(rows, SQUARE, one, minus=other)

    amount = Estimate.amount
    return [
        below(
            "Subtracting the cheese vector turns the mouse from the cheese.",
            "0.844 to 0.479: -0.365 (40 mazes)",
            "change of the probability",
            minus(SUBTRACTED, PLAIN),
            -0.25,
            told=amount,
        ),
        near_zero(
            "It does what taking the cheese away does.",
            "0.479 and 0.497: -0.018",
            "subtracted minus without cheese; in a layer that sees little around each place it is "
            "nearly so by its making",
            minus(SUBTRACTED, WITHOUT),
            0.08,
            told=amount,
        ),
        near_zero(
            "A random vector of the same length does nearly nothing.",
            "0.844 to 0.843; of the paper's network: wrecks the policy",
            "change of the probability",
            minus(RANDOM, PLAIN),
            0.03,
            told=amount,
        ),
        above(
            "Adding it draws the mouse to the cheese.",
            "0.844 to 0.896: +0.052; of the paper's network: next to no effect",
            "change of the probability",
            minus(ADDED, PLAIN),
            told=amount,
        ),
    ]


def of_corner_mouse(rows: pl.DataFrame) -> list[Claim]:
    """Return the claims about the corner mouse, with bounds set before the run."""
    return [
        near_zero(
            sentence,
            "not measured",
            "change of the probability of the next step to the cheese",
            of_levels(rows, SQUARE, condition, minus=PLAIN),
            0.1,
            told=Estimate.amount,
        )
        for condition, sentence in (
            (
                WITHOUT,
                "A mouse of the corner hardly turns when the cheese is taken from the level.",
            ),
            (SUBTRACTED, "Nor when its cheese vector is subtracted."),
            (RANDOM, "Nor by a random vector of that length."),
        )
    ]


CLAIMS = {"smoke": of_corner_mouse, "published": of_cheese_mouse}

EXPERIMENT = Experiment(
    title="The cheese vector",
    reproduces="Mini et al. 2023 (arXiv 2310.08043), with other agents",
    question="Is what a mouse saw of the cheese a direction in one of its layers?",
    sizes={
        "smoke": _plans.of_corner_mouse(600, visited={WHERE: _plans.SMALL}),
        "published": _plans.of_cheese_mouse(300, visited={WHERE: _plans.LARGE}),
    },
    find=find,
)
