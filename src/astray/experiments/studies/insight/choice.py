"""Which features of a maze predict that a mouse takes its cheese? A published claim, repeated."""

import numpy as np
import polars as pl

from astray.analysis.evaluate import evaluate
from astray.analysis.outcomes import FAILED, INTENDED, label, load_shift
from astray.analysis.trained import Agent
from astray.estimate import Estimate
from astray.experiments.spec import Experiment, Test, Work
from astray.experiments.studies.insight import _plans
from astray.experiments.studies.insight._plans import opened
from astray.figures import charts
from astray.game import Variant
from astray.insight.behaviour import Prediction, level_features, predict
from astray.report.claims import Claim, above, below
from astray.report.findings import Findings, Plot, Table

WHERE = "cheese anywhere"
ANY_SIZE = Test("anywhere-easy", "corner-easy", {"smallest": 7})  # cells a side, of 15
CHEESE = "cheese first"
NEAR_SQUARE, STRAIGHT_SQUARE, STRAIGHT_CORNER, SQUARE_CORNER = (
    "cheese to decision square, steps",
    "cheese to decision square, straight",
    "cheese to corner, straight",
    "decision square to 5 x 5 corner, straight",
)
PUBLISHED = {  # the four features of Mini et al., and their coefficients there
    NEAR_SQUARE: -1.15,
    STRAIGHT_SQUARE: -0.08,
    STRAIGHT_CORNER: -2.31,
    SQUARE_CORNER: 0.73,
}


def find(work: Work) -> Findings:
    agent, variant, levels = opened(work, WHERE)
    rows = work.keep("choices", lambda: choices(work, agent, variant, levels))
    told = rows.drop_nulls()
    features = [one for one in told.columns if one not in ("level", CHEESE)]
    names = [one for one in features if told[one].n_unique() > 1]
    every = predict(told, CHEESE, names)
    four = predict(told, CHEESE, [name for name in PUBLISHED if name in names])
    taken = told[CHEESE].to_numpy().mean()
    largest = every.features.rename({"coefficient": "mean"}).sort(-pl.col("mean").abs())
    coefficients = charts.points(
        largest,
        row="feature",
        at={"": 0},
        label="log odds of the cheese, a standard deviation more",
    )
    return Findings(
        answer=f"The ways to cheese and corner part in {every.levels:,} of {len(rows):,} episodes; "
        f"the cheese is reached first in {100 * taken:.1f}\u00a0% of these. All "
        f"{len(names)} distances tell which with an area under the curve of {every.auc.mean:.2f}, "
        f"the published four with {four.auc.mean:.2f}.",
        claims=[
            above(
                "Distances in the maze tell whether the cheese is taken.",
                "accuracy .904 to .848 without looking",
                "area under the curve, all distances",
                every.auc,
                0.6,
                told=Estimate.amount,
            ),
            above(
                "The published four tell it as well as all.",
                ".913 and .904",
                f"area under the curve, {four.auc.mean:.3f} of the four, minus that of all",
                four.better_than(every),
                -0.02,
                told=Estimate.amount,
            ),
            *(signed(four, name, value) for name, value in PUBLISHED.items() if name in names),
        ],
        plots=[
            Plot(
                "coefficients",
                "Log odds of taking the cheese for a standard deviation more of "
                "each distance, with 95\u00a0% intervals over levels; all distances together.",
                coefficients,
                every.features,
            )
        ],
        tables=[
            Table(
                "all",
                "All distances; vif: how many times the variance of a coefficient is that "
                "without the others; sign: fraction of subsets of distances with the same sign",
                every.features,
            ),
            Table("four", "The four of Mini et al.", four.features),
        ],
        settings={
            "episodes": f"{len(levels):,}, of levels that the agent never met; those that ended "
            "with neither do not count",
            "regression": "logistic, L1 penalty by five-fold cross-validation",
            "accuracy": f"all: {every.accuracy.amount()}, four: {four.accuracy.amount()}; saying "
            f"the commoner always: {every.always:.3f}",
        },
    )


def signed(found: Prediction, name: str, published: float) -> Claim:
    """Test whether a coefficient has the published sign, with 95 % confidence."""
    row = found.features.filter(feature=name).row(0, named=True)
    ours = Estimate(row["coefficient"], row["low"], row["high"], 1, found.levels, found.levels)
    less = published < 0
    sign = (
        f"; sign the same in {100 * (row['sign'] or 0):.0f}\u00a0% of subsets, vif {row['vif']:.1f}"
    )
    return (below if less else above)(
        f"{'Less' if less else 'More'} likely with more of: {name}.",
        f"{published:+z.2f} a standard deviation",
        f"coefficient{sign}",
        ours,
        told=Estimate.amount,
    )


def choices(work: Work, agent: Agent, variant: Variant, levels: np.ndarray) -> pl.DataFrame:
    """Return features of those `levels` [N] with a goal reached, and whether cheese was first."""
    test = work.plan.visited[WHERE]
    game = work.plan.game
    played = label(
        evaluate(agent, game, variant, levels, until=("reached_goal", "reached_corner")),
        game,
        load_shift(game, test.shift),
    )
    first = played.filter(pl.col("outcome") != FAILED).select(
        "level", (pl.col("outcome") == INTENDED).alias(CHEESE)
    )
    return level_features(game, variant, levels).join(first, on="level")


EXPERIMENT = Experiment(
    title="What predicts the choice",
    reproduces="Mini et al. 2023 (arXiv 2310.08043), its regression, with other agents",
    question="What about a maze tells whether a mouse takes its cheese or goes to the corner?",
    sizes={
        "smoke": _plans.of_corner_mouse(20_000, visited={WHERE: _plans.SMALL}),
        "published": _plans.of_cheese_mouse(1_000, visited={WHERE: ANY_SIZE}),
    },
    find=find,
    needs={"sklearn": "insight"},
)
