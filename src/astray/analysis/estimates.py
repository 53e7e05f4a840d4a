"""Intervals. The unit of analysis is the agent: agents are resampled first, then levels."""

from __future__ import annotations

import functools
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
import polars as pl

from astray.bounds import of_kind
from astray.estimate import Estimate

RESAMPLES = 10_000
LARGEST_KEPT = 20_000_000  # counts that are drawn once, a byte each
QUARTILES = 4  # with fewer agents there is nothing to trim


def over_agents(values: np.ndarray, *, seed: int = 0) -> np.ndarray:
    """The middle of `values` [agents, points] at each point and its 95 % interval, [3, points].

    The middle is the interquartile mean, which a stray agent does not pull (Agarwal et al.,
    NeurIPS 2021), or of fewer than 4 agents the mean; the interval is its percentiles over
    resamples of agents. One agent has no interval: NaN.
    """
    from scipy.stats import trim_mean  # here, as it takes a second to import

    of_kind("values", values, np.ndarray)
    if values.ndim != 2 or not values.size:
        raise ValueError(
            f"values must be [agents, points], at least one of each; got {values.shape}"
        )
    agents, points = values.shape
    cut = 0.25 if agents >= QUARTILES else 0.0
    middle = trim_mean(values, cut, axis=0)
    if agents == 1:
        return np.stack([middle, *np.full((2, points), np.nan)])
    drawn = np.random.default_rng(seed).integers(agents, size=(RESAMPLES, agents))
    ends = [np.quantile(trim_mean(v[drawn], cut, axis=1), [0.025, 0.975]) for v in values.T]
    return np.column_stack([middle, np.array(ends).reshape(points, 2)]).T


def bootstrap(values: np.ndarray, weights: np.ndarray | None = None, *, seed: int = 0) -> Estimate:
    """The mean of `values` [agents, levels] and its 95 % interval.

    A resample draws agents with replacement, then levels with replacement, the same for all of
    them since they share what is hard about a level; the interval is the percentiles of its
    means. One agent alone speaks for itself: then only levels are resampled.

    weights  [agents, levels], not below 0: each value is a sum over so much, and the mean is the
             sum of values over that of weights; resamples without weight do not count, and
             where there is no weight at all, all is NaN
    """
    values = np.atleast_2d(np.asarray(values, float))
    if values.ndim != 2 or not values.size:
        raise ValueError(
            f"values must be [agents, levels], at least one of each; got {values.shape}"
        )
    agents, levels = values.shape
    sums, weight = np.empty(RESAMPLES), np.full(RESAMPLES, float(agents * levels))
    if weights is not None:
        weights = np.atleast_2d(np.asarray(weights, float))
        if weights.shape != values.shape or not (weights >= 0).all():
            raise ValueError(f"weights must be {values.shape} numbers, none below 0; got {weights}")
    done = 0
    for drawn in _resamples(agents, levels, seed):
        part = slice(done, done := done + len(drawn[0]))
        by_agent, by_level = (counts.astype(float) for counts in drawn)
        sums[part] = _sums(values, by_agent, by_level)
        if weights is not None:
            weight[part] = _sums(weights, by_agent, by_level)
    if not weight.any():
        return Estimate(np.nan, np.nan, np.nan, agents, levels, values.size)
    low, high = np.quantile(sums[weight > 0] / weight[weight > 0], [0.025, 0.975])
    mean = values.mean() if weights is None else values.sum() / weights.sum()
    return Estimate(float(mean), float(low), float(high), agents, levels, values.size)


def _resamples(agents: int, levels: int, seed: int) -> Iterable[tuple[np.ndarray, np.ndarray]]:
    """How often resamples draw each agent and each level, [R, agents] and [R, levels], in parts.

    A report has many means over as many agents and levels: what they share is drawn once.
    """
    if RESAMPLES * levels <= LARGEST_KEPT:
        return _kept_resamples(agents, levels, seed)
    return _drawn_resamples(agents, levels, seed)


@functools.lru_cache(maxsize=4)
def _kept_resamples(agents: int, levels: int, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    return list(_drawn_resamples(agents, levels, seed))


def _drawn_resamples(
    agents: int, levels: int, seed: int
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    rng = np.random.default_rng(seed)
    by_agent = rng.multinomial(agents, np.full(agents, 1 / agents), RESAMPLES)
    for part in np.array_split(by_agent, max(1, RESAMPLES * levels // 4_000_000)):
        by_level = rng.multinomial(levels, np.full(levels, 1 / levels), len(part))
        yield part.astype(np.int32), by_level.astype(np.min_scalar_type(by_level.max()))


def _sums(values: np.ndarray, by_agent: np.ndarray, by_level: np.ndarray) -> np.ndarray:
    """The sum of `values` [agents, levels] in resamples that draw each so often, [R]."""
    return np.einsum("ra,al,rl->r", by_agent, values, by_level, optimize=True)


def mean_of(rows: pl.DataFrame, value: str | pl.Expr) -> Estimate:
    """The mean of a column or expression over all of `rows`, as `group_means`; of none, NaN."""
    value = pl.col(value) if isinstance(value, str) else value
    named = rows.with_columns(all=pl.lit(0), value=value.cast(pl.Float64))
    if named["value"].drop_nulls().is_empty():
        return Estimate.nothing()
    return Estimate.of(group_means(named, "value", ["all"]).row(0, named=True))


def group_means(
    rows: pl.DataFrame, value: str, by: Sequence[str], *, per: str | None = None, seed: int = 0
) -> pl.DataFrame:
    """The mean of the column `value` in each group of `rows`, with 95 % intervals.

    The steps of an episode are alike, so it is not rows that are resampled but, as in
    `bootstrap`, agents (column "agent"; without it all rows are of one) and levels.

    by   columns; rows that have all of them in common are a group
    per  a column, not below 0: the mean is then the sum of `value` over that of it

    Columns: those of `by`, mean, low, high (null where the sum of `per` is 0), agents, levels,
    rows. Rows where `value` is null do not count.
    """
    missing = {value, "level", *by, *([per] if per else [])} - set(rows.columns)
    if missing:
        raise ValueError(f"no column {', '.join(sorted(missing))}; there are: {rows.columns}")
    agent = [name for name in ("agent",) if name in rows.columns]
    known, found = rows.drop_nulls(value), []
    if known.is_empty():
        raise ValueError(f"no row of {len(rows)} has a value of {value!r}")
    for key, group in known.group_by(by):
        codes = [np.unique(group[name], return_inverse=True)[1] for name in (*agent, "level")]
        cell = (codes[0] if agent else np.zeros(len(group), int), codes[-1])
        totals = np.zeros([int(code.max()) + 1 for code in cell])
        weights = totals.copy()
        np.add.at(totals, cell, group[value].cast(pl.Float64).to_numpy())
        np.add.at(weights, cell, group[per].to_numpy() if per else 1.0)
        estimate = bootstrap(totals, weights, seed=seed)
        found.append(dict(zip(by, key, strict=True)) | vars(estimate) | {"rows": len(group)})
    return pl.DataFrame(found).sort(by).with_columns(pl.col("mean", "low", "high").fill_nan(None))
