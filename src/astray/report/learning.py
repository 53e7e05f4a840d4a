"""Learning curves: metrics during training, over seeds."""

from collections.abc import Mapping

import numpy as np
import polars as pl
from matplotlib.figure import Figure

from astray.analysis.estimates import over_agents
from astray.figures import charts
from astray.figures.axes import names_of


def learning_curves(
    data: pl.DataFrame, series: Mapping[str, str], label: str, published: pl.DataFrame | None = None
) -> Figure:
    """Draw metrics during training: a thin line for each seed, a thick one for the mean.

    The band is the mean's 95 % interval, Student's t over seeds. Agents of several names have axes
    of their own.

    Args:
        data: Columns seed, steps, those of `series`, and agent if there are several names; nulls
            are skipped.
        series: Column -> its label.
        published: Curves of others, drawn dashed: columns agent, series (name), steps and mean.
    """
    agents = names_of(data, "agent") if "agent" in data else [""]
    kinds = {"steps": pl.Float64, "mean": pl.Float64, "seed": pl.Int64, "series": pl.String}
    parts = [pl.DataFrame(schema=kinds)]  # as there may be no value
    for agent in agents:
        for column, name in series.items():
            mine = data.filter(pl.col("agent") == agent) if agent else data
            value = pl.col(column).cast(pl.Float64).fill_nan(None)
            values = mine.select("seed", steps=pl.col("steps") / 1e6, mean=value).drop_nulls("mean")
            one = pl.concat([_over_seeds(values), values], how="diagonal_relaxed")
            parts.append(one.with_columns(series=pl.lit(name), agent=pl.lit(agent)))
    others = [] if published is None else published["series"].unique(maintain_order=True).to_list()
    if published is not None and others:
        named = pl.col("agent") if len(agents) > 1 else pl.lit(agents[0])
        parts.append(published.with_columns(pl.col("steps") / 1e6, agent=named))
    return charts.curves(
        pl.concat(parts, how="diagonal_relaxed"), x="steps", line="series", each="seed",
        panel="agent" if len(agents) > 1 else None, columns=3, label=label,
        x_label="million environment steps" if len(agents) == 1 else "million steps",
        base=others,
    )  # fmt: skip


def _over_seeds(values: pl.DataFrame) -> pl.DataFrame:
    """Return the mean and its band at the steps where every seed has a value."""
    seeds = values["seed"].n_unique()
    every = values.group_by("steps").agg("mean").sort("steps")
    every = every.filter(pl.col("mean").list.len() == seeds)
    if seeds < 2 or every.is_empty():
        return every.with_columns(pl.col("mean").list.mean(), seed=pl.lit(None, pl.Int64))
    mean, low, high = over_agents(np.array(every["mean"].to_list()).T)
    band = {"mean": mean, "low": low, "high": high, "seed": [None] * len(every)}
    return pl.DataFrame({"steps": every["steps"]} | band, schema_overrides={"seed": pl.Int64})
