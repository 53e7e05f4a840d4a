"""Training curves that others published, of the paper's program in the paper's worlds."""

import functools
import itertools
import tomllib
from importlib import resources
from typing import Any

import polars as pl

from astray.training.config import Config

LATER = 1.5  # times a training's steps: up to there a published curve is shown beside it


@functools.cache
def curves() -> dict[str, Any]:
    """Return the published curves as `curves.toml` has them: ends of bins, and curves."""
    text = resources.files("astray.published").joinpath("curves.toml").read_text("utf-8")
    return tomllib.loads(text)


def beside(config: Config, steps: int) -> pl.DataFrame:
    """Return the published curves of a training's world: series (name), steps, mean (return).

    Points are the middles of bins. The table is empty for worlds without a published curve, and
    for variants with changed knobs.

    Args:
        steps: Last step of the training's own curve, beyond which little is shown.
    """
    ends = [0, *curves()["ends"]]
    middles = [500_000 * (a + b) for a, b in itertools.pairwise(ends)]
    rows = [
        {"series": one["name"], "steps": middle, "mean": float(value)}
        for one in curves()["curves"]
        if (one["game"], one["variant"]) == (config.game, config.variant) and not config.knobs
        for middle, value in zip(middles, one["returns"], strict=True)
        if middle <= max(LATER * steps, middles[1])
    ]
    return pl.DataFrame(rows, schema={"series": pl.String, "steps": pl.Int64, "mean": pl.Float64})
