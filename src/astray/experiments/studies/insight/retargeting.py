"""Can activations of one layer send a mouse to a cell?"""

import itertools
from collections.abc import Mapping

import numpy as np
import polars as pl

from astray.analysis.trained import Agent
from astray.estimate import Estimate
from astray.experiments.outcomes import table_of
from astray.experiments.spec import Experiment, Size, Work
from astray.experiments.studies.insight import _plans
from astray.experiments.studies.insight._plans import opened
from astray.figures.grids import Picture, images
from astray.game import Variant
from astray.insight.retarget import ALONE, AS_IS, CLAMPED, MOVED, WAYS, Clamp, following, retarget
from astray.report.claims import Claim, above, near_zero
from astray.report.findings import Findings, Plot, Table

WHERE = "cheese anywhere"
LAYER: Mapping[Size, str] = {"smoke": "spread", "published": "block2.residual1"}
LEARN, TUNE = 20, 8  # levels that channels are found in, and that the clamp is chosen on
COUNTS = (1, 8)  # channels that are clamped, the best ones
FACTORS = (1.0, 3.0)  # times what they give where the cheese is
TRIED, TARGETS = 4, 6  # cells of each level, in tuning and in the test


def find(work: Work) -> Findings:
    agent, variant, levels = opened(work, WHERE)
    layer = LAYER[work.size]
    found = work.keep(
        "following", lambda: following(agent, variant, levels[:LEARN], layer, places=16)
    )
    tuned = work.keep(
        "tuned", lambda: tune(agent, variant, levels[LEARN : LEARN + TUNE], found, layer)
    )
    best = tuned.sort("path", descending=True).row(0, named=True)
    clamp = clamp_of(found, layer, best["channels"], best["factor"])
    rows = work.keep(
        "paths", lambda: retarget(agent, variant, levels[LEARN + TUNE :], clamp, targets=TARGETS)
    )
    said = {how: of_levels(rows, how) for how in WAYS}
    maps = {how: by_cell(rows, how) for how in WAYS}
    return Findings(
        answer=f"The mean probability of the steps to a cell is {said[AS_IS].mean:.3f}; with the "
        f"cheese moved there {said[MOVED].mean:.3f}; with {best['channels']} channels of {layer} "
        f"clamped there {said[CLAMPED].mean:.3f}, and {said[ALONE].mean:.3f} in levels without "
        "cheese.",
        claims=CLAIMS[work.size](rows),
        plots=[
            Plot(
                "targets",
                "Path probability to each cell: the geometric mean of the "
                "probabilities of the steps of the shortest way there, the mean over levels.",
                images([[heat(how, one, variant) for how, one in maps.items()]], (2.45, 3.0)),
                pl.concat([m.with_columns(how=pl.lit(how)) for how, m in maps.items()]),
            )
        ],
        tables=[
            Table("ways", "Path probability to the target", table_of(said, "how")),
            Table(
                "following",
                "Channels by how what they give goes with where the cheese is",
                found.head(16),
            ),
            Table("tuned", "Clamps that were tried on other levels", tuned),
        ],
        settings={
            "levels": f"{LEARN} to find channels, {TUNE} to choose the clamp, "
            f"{len(levels) - LEARN - TUNE} for the figures, {TARGETS} targets each",
            "clamp": f"channels {', '.join(map(str, clamp.channels))} to "
            f"{', '.join(f'{v:.2f}' for v in clamp.values)}",
            "the paper and its code": "There eleven channels were picked by eye, in a network "
            "four times as wide; here by correlation, their number and value on other levels.",
        },
    )


def heat(how: str, table: pl.DataFrame, variant: Variant) -> Picture:
    """Return the means of `by_cell` in the world's cells, highest row first."""
    side = int(variant.records()[0]["world"])
    grid = np.full((side, side), np.nan)
    grid[table["y"].to_numpy(), table["x"].to_numpy()] = table["mean"].to_numpy()
    label = "path probability" if how == WAYS[-1] else ""
    return Picture(how, heat=grid[::-1], colours="magma", label=label, opacity=1)


def clamp_of(found: pl.DataFrame, layer: str, count: int, factor: float) -> Clamp:
    """Return the best channels, set to `factor` times their activation at the cheese."""
    best = found.head(count)
    values = (factor * best["there"]).to_list()
    return Clamp(layer, tuple(best["channel"].to_list()), tuple(values))


def tune(
    agent: Agent, variant: Variant, levels: np.ndarray, found: pl.DataFrame, layer: str
) -> pl.DataFrame:
    """Return the effect of each clamp in `levels` [N]: channels, factor, path."""
    rows = []
    for count, factor in itertools.product(COUNTS, FACTORS):
        if count > len(found):
            continue
        clamp = clamp_of(found, layer, count, factor)
        paths = retarget(agent, variant, levels, clamp, targets=TRIED, how=[CLAMPED])
        rows.append({"channels": count, "factor": factor, "path": paths["path"].mean()})
    return pl.DataFrame(rows)


def of_levels(rows: pl.DataFrame, how: str, minus: str | None = None) -> Estimate:
    """Return the mean over levels of the path probability, minus another method's if given."""
    means = rows.group_by("level", condition="how").agg(pl.col("path").mean())
    return _plans.of_levels(means, "path", how, minus)


def by_cell(rows: pl.DataFrame, how: str) -> pl.DataFrame:
    """Return the mean path probability to each target cell: x, y, mean, n."""
    part = rows.filter(how=how).group_by("x", "y")
    return part.agg(mean=pl.col("path").mean(), n=pl.len()).sort("x", "y")


def of_cheese_mouse(rows: pl.DataFrame) -> list[Claim]:
    """Return the claims about the cheese mouse, with bounds set before the run."""
    return [
        above(
            "Moving the cheese sends the mouse there.",
            "yes, nearly everywhere",
            "moved minus as it is",
            of_levels(rows, MOVED, AS_IS),
            0.1,
            told=Estimate.amount,
        ),
        above(
            "Clamping the channels that follow the cheese at a cell sends it there, too.",
            "yes, near the mouse and on the way to the corner",
            "clamped minus as it is",
            of_levels(rows, CLAMPED, AS_IS),
            0.03,
            told=Estimate.amount,
        ),
        above(
            "It does so less than the cheese itself.",
            "less",
            "moved minus clamped",
            of_levels(rows, MOVED, CLAMPED),
            told=Estimate.amount,
        ),
    ]


def of_corner_mouse(rows: pl.DataFrame) -> list[Claim]:
    """Return the claims about the corner mouse, with bounds set before the run."""
    return [
        near_zero(
            sentence,
            "not measured",
            f"{way} minus as it is",
            of_levels(rows, condition, AS_IS),
            0.05,
            told=Estimate.amount,
        )
        for condition, way, sentence in (
            (MOVED, "moved", "Moving the cheese sends a mouse of the corner nowhere."),
            (CLAMPED, "clamped", "Nor does clamping what follows the cheese in the first layer."),
        )
    ]


CLAIMS = {"smoke": of_corner_mouse, "published": of_cheese_mouse}

EXPERIMENT = Experiment(
    title="Sent by a clamp",
    reproduces="Mini et al. 2023 (arXiv 2310.08043), with other agents",
    question="Can a mouse be sent to a cell by what one of its layers holds there?",
    sizes={
        "smoke": _plans.of_corner_mouse(230, visited={WHERE: _plans.SMALL}),
        "published": _plans.of_cheese_mouse(58, visited={WHERE: _plans.LARGE}),
    },
    find=find,
)
