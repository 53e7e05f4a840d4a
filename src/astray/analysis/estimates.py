"""Means with intervals over the sources of chance: agents first, then levels.

Values are [agents, levels]: agents of one training that differ in their seed, in the same levels.
Two things vary by chance: an agent differs from others in all levels, and a level is hard for all
agents. The interval is for the mean over all agents that the training could give, in all levels of
the variant. Its half-width has one part for each; their squares add up (Banerjee 1961):

    agents  Student's t with agents - 1 degrees of freedom, times the standard error of their means
    levels  Student's t (with several agents, from 30 levels on the normal quantile) times the
            levels' fraction of the standard error, from the variance component that an analysis of
            variance estimates

Where one agent, or level, has most of the weight, there are fewer degrees of freedom.

With one agent, the interval is for this agent alone, over levels. Rates have Wilson's interval for
the equivalent number of independent episodes, which stays within 0 and 1 and always has a width.
No random numbers are used. `tests/analysis/test_coverage.py` simulates the coverage.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl

from astray.estimate import Estimate
from astray.validation import MOST, bounded, finite, of_kind, one_of, shown

CONFIDENCE = 0.95
POWER = 0.8
ROUNDED = 1e-12  # relative deviation up to which values count as equal
AGENT = ("run", "checkpoint", "seed", "agent")  # columns of episodes that identify an agent


def quantile(freedom: float, below: float = (1 + CONFIDENCE) / 2) -> float:
    """Return a quantile of Student's t, or of the normal distribution if `freedom` is infinite."""
    if freedom != math.inf:
        finite("freedom", freedom, 0)
    finite("below", below, 0, 1)
    from scipy.special import ndtri, stdtrit  # takes a second to import

    return float(ndtri(below) if math.isinf(freedom) else stdtrit(freedom, below))


def over_agents(values: np.ndarray) -> np.ndarray:
    """Return the mean of `values` [agents, points] at each point with 95 % intervals, [3, points].

    The interval is Student's t over agents; it is NaN for one agent, and where all are equal.

    Raises:
        ValueError: If `values` are not of that shape.
    """
    of_kind("values", values, np.ndarray)
    if values.ndim != 2 or not values.size:
        raise ValueError(f"values must be [agents, points], not empty; got {values.shape}")
    agents, mean = len(values), values.mean(0)
    if agents == 1:
        return np.stack([mean, *np.full((2, len(mean)), np.nan)])
    half = quantile(agents - 1) * np.sqrt(values.var(0, ddof=1) / agents)
    half[half <= ROUNDED * abs(mean)] = np.nan
    return np.stack([mean, mean - half, mean + half])


def estimate_mean(
    values: np.ndarray,
    weights: np.ndarray | None = None,
    *,
    rate: bool | None = None,
    pool: Sequence[np.ndarray] = (),
    lowest: float = 0.0,
) -> Estimate:
    """Return the mean of `values` [agents, levels] with a 95 % interval; NaN if one is not finite.

    Args:
        weights: [agents, levels], not negative. Each value is then a sum over that weight, and the
            mean is the sum of values over the sum of weights, or NaN if all weights are 0.
        rate: Whether the mean is a rate of counts, from 0 to 1; None to decide by bool dtype.
        pool: [agents, levels] for every kind of agents in a study, including these. Their spread
            between agents is estimated jointly, because a few of each kind say little about it.
        lowest: Lowest possible rate: 0, or -1 for the difference of two.

    Raises:
        ValueError: If values or weights have another shape, a weight is negative, or a rate is
            not from 0 to 1.
    """
    rate = _is_rate(values) if rate is None else rate
    values = _numbers("values", values)
    weights = np.ones_like(values) if weights is None else _numbers("weights", weights)
    pool = _kinds(pool)
    if weights.shape != values.shape or not ((weights >= 0) & (weights < np.inf)).all():
        raise ValueError(f"weights must be {values.shape} numbers, none below 0; got {weights}")
    if rate:
        values = (values - lowest * weights) / (1 - lowest)
    total = float(weights.sum())
    if total:  # an agent or a level without weight and values says nothing
        told = (weights != 0) | (values != 0)
        there = np.ix_(told.any(1), told.any(0))
        values, weights = values[there], weights[there]
    agents, levels = values.shape
    if not total or not all(np.isfinite(one).all() for one in (values, *pool)):
        return Estimate(math.nan, math.nan, math.nan, agents, levels, values.size)
    mean = float(values.sum() / total)
    if rate and abs(mean - 0.5) > 0.5 + 1e-9:  # sums are rounded
        raise ValueError(f"a rate must be from 0 to 1; the mean of these values is {mean:g}")
    rest = (values - mean * weights) * (values.size / total)  # deviations in units of the mean
    of_trials = rate and not lowest and math.isclose(rest.var(), mean * (1 - mean), abs_tol=1e-9)
    among, apart = _among_levels(rest, weights.sum(0) / total)
    if agents == 1 and of_trials:
        among = float(rest.var()) / levels  # in units of p (1 - p), as Wilson's
    between, freedom = _between_agents(rest, pool, mean if rate else None, weights.sum(1) / total)
    of_levels = _of_levels(agents, apart, of_trials)
    one_trial = of_trials and levels == 1  # of each agent: the mean determines the variance
    widest = of_levels if agents == 1 or one_trial else quantile(freedom)
    square = max(widest**2 * between + of_levels**2 * among, float(rest.var()) / rest.size)
    part = float((weights**2).sum()) / total**2
    if rate and lowest:  # as if with two more, of 1 and -1 (Bonett and Price 2012)
        square += 2 * (widest * part) ** 2 * mean * (1 - mean)
    low, high = ends(mean, square, rate, widest**2 * part)
    if rate:
        mean, low, high = (lowest + (1 - lowest) * end for end in (mean, low, high))
    known = _satterthwaite([(between, freedom), (among, apart)])
    return Estimate(mean, low, high, agents, levels, values.size, known)


def estimate_difference(
    one: np.ndarray, other: np.ndarray, *, pool: Sequence[np.ndarray] = (), same_levels: bool = True
) -> Estimate:
    """Return the mean of `one` minus that of `other` with a 95 % interval; all [agents, levels].

    Agents of two kinds are not paired: a common seed means nothing. (For the same agents in the
    same levels see `estimate_paired`.) The interval is Welch's. For rates it combines both
    intervals (Newcombe 1998), so that it stays within -1 and 1.

    Args:
        pool: As for `estimate_mean`.
        same_levels: Whether a column is the same level in both, which cancels its difficulty.

    Raises:
        ValueError: If the levels should be the same but differ in number.
    """
    rate = _is_rate(one) and _is_rate(other)
    one, other = kinds = [_numbers("values", kind) for kind in (one, other)]
    pool, levels = _kinds(pool), [values.shape[1] for values in kinds]
    if same_levels and levels[0] != levels[1]:
        raise ValueError(f"levels must be the same; got {levels[0]} and {levels[1]}")
    if same_levels and len(one) == len(other) == 1:
        return estimate_paired(one > 0, other > 0) if rate else estimate_paired(one, other)
    agents, least = min(len(one), len(other)), min(levels)
    if not all(np.isfinite(values).all() for values in (one, other, *pool)):
        return Estimate(math.nan, math.nan, math.nan, agents, least, agents * least)
    means = [float(values.mean()) for values in kinds]
    rests = [values - mean for values, mean in zip(kinds, means, strict=True)]
    spreads = [
        _between_agents(rest, pool, mean if rate else None)
        for rest, mean in zip(rests, means, strict=True)
    ]
    alone = max(len(one), len(other)) == 1
    freedom = min(known for _, known in spreads) if pool or alone else _satterthwaite(spreads)
    wide, of_levels = quantile(freedom), [_of_levels(len(v), v.shape[1] - 1, rate) for v in kinds]
    if same_levels:
        noise = sum(_noise(rest) / rest.size for rest in rests)
        both = rests[0].mean(0) - rests[1].mean(0)
        common = max(0.0, float(both.var(ddof=1)) / len(both) - noise) if len(both) > 1 else 0.0
        among = [0.0, 0.0]
    else:
        common, among = 0.0, [_among_levels(rest)[0] for rest in rests]
    squares = [
        max(wide**2 * between + (t * t) * levels, float(rest.var()) / rest.size)
        for (between, _), levels, rest, t in zip(spreads, among, rests, of_levels, strict=True)
    ]
    (low, high), (its_low, its_high) = (
        ends(mean, square, rate, (t if len(rest) == 1 else wide) ** 2 / rest.size)
        for mean, square, rest, t in zip(means, squares, rests, of_levels, strict=True)
    )
    mean = means[0] - means[1]
    of_common = max(of_levels) * math.sqrt(common)
    below = math.hypot(means[0] - low, its_high - means[1], of_common)
    above = math.hypot(high - means[0], means[1] - its_low, of_common)
    if rate:
        below, above = min(below, 1 + mean), min(above, 1 - mean)
    between = (sum(variance for variance, _ in spreads), freedom)
    known = _satterthwaite([between, (common + sum(among), least - 1)])
    return Estimate(mean, mean - below, mean + above, agents, least, agents * least, known)


def estimate_paired(one: np.ndarray, other: np.ndarray) -> Estimate:
    """Return the mean of `one` minus `other` for the same agents, or pairs, in the same levels.

    Both are [agents, levels]; a single policy on one side is compared with every agent.

    Raises:
        ValueError: If their shapes differ.
    """
    rates = _is_rate(one) and _is_rate(other)
    one, other = (_numbers("values", kind) for kind in (one, other))
    if one.shape[1] != other.shape[1] or len({len(one), len(other)} - {1}) > 1:
        raise ValueError(
            f"both must be of the same agents, or one, in the same levels; got {one.shape} and "
            f"{other.shape}"
        )
    return estimate_mean(one - other, rate=rates, lowest=-1.0)


def minus(one: Estimate, other: Estimate) -> Estimate:
    """Return one mean minus another, independent one, with an interval from both.

    Each half-width is the root of the sum of the squared half-widths of the two intervals.
    """
    of_kind("one", one, Estimate)
    of_kind("other", other, Estimate)
    mean = one.mean - other.mean
    below = math.hypot(one.mean - one.low, other.high - other.mean)
    above = math.hypot(one.high - one.mean, other.mean - other.low)
    known = [part.freedom or max(1, part.levels - 1) for part in (one, other)]
    agents, levels = min(one.agents, other.agents), min(one.levels, other.levels)
    return Estimate(mean, mean - below, mean + above, agents, levels, agents * levels, min(known))


def detectable(
    agents: int, levels: int, spread: float, *, kinds: int = 1, rate: float = 0.5
) -> float:
    """Return the distance from its bound at which a rate is detected with 80 % power.

    Args:
        agents: Number of trained agents of each kind.
        levels: Number of test levels of each.
        spread: Standard deviation of their true rates.
        kinds: 1; with more, the result is for the difference of two whose `pool` has all kinds.
        rate: Rate near which they are.

    Raises:
        ValueError: If a number is of another kind, or out of its range.
    """
    for name, count in {"agents": agents, "levels": levels, "kinds": kinds}.items():
        bounded(name, count, 1, MOST)
    finite("spread", spread, 0)
    finite("rate", rate, 0, 1)
    from scipy.special import betainc, nctdtrinc  # takes a second to import

    variance = spread**2 + rate * (1 - rate) / levels
    error = math.sqrt(variance * min(2, kinds) / agents)
    freedom, wide = kinds * (agents - 1) if agents > 1 else levels - 1, 1.0
    if agents > 1 < kinds:  # `_between_agents` takes a kind's own variance where that is larger
        mine, other = (agents - 1) / 2, (kinds - 1) * (agents - 1) / 2  # of a beta distribution
        wide += betainc(mine, other, 1 / kinds) - betainc(mine + 1, other, 1 / kinds)
    return float(nctdtrinc(freedom, 1 - POWER, quantile(freedom) * wide**0.5)) * error


def _numbers(name: str, given: Any) -> np.ndarray:
    """Return `given` as reals [agents, levels]; text, masks and dates would be read as numbers."""
    array = np.asarray(given)
    if array.dtype.kind not in "biuf" or np.ma.is_masked(np.ma.array(given)):
        raise ValueError(f"{name} must be numbers [agents, levels]; got {shown(given)}")
    array = np.atleast_2d(array.astype(float))
    if array.ndim != 2 or not array.size:
        raise ValueError(
            f"{name} must be [agents, levels], at least one of each; got {array.shape}"
        )
    return array


def _kinds(pool: Any) -> list[np.ndarray]:
    """Return a pool's kinds as reals [agents, levels]; an array would be one, or several."""
    of_kind("pool", pool, list | tuple)
    return [_numbers("each kind in pool", kind) for kind in pool]


def _is_rate(values: np.ndarray) -> bool:
    return np.asarray(values).dtype == bool


def _of_levels(agents: int, freedom: float, of_trials: bool) -> float:
    """Return the quantile for the levels' part; of one agent's trials it is Wilson's."""
    is_normal = not freedom or (of_trials if agents == 1 else freedom >= 29)
    return quantile(math.inf if is_normal else freedom)


def _noise(rest: np.ndarray) -> float:
    """Return the variance that neither agents nor levels explain; 0 for one agent."""
    agents, levels = rest.shape
    if min(agents, levels) == 1:
        return 0.0
    left = rest - rest.mean(1, keepdims=True) - rest.mean(0) + rest.mean()
    return float((left**2).sum() / ((agents - 1) * (levels - 1)))


def _of_mean(parts: np.ndarray, fractions: np.ndarray | None) -> tuple[float, float]:
    """Return the variance of the mean of `parts` [N], and its degrees of freedom.

    Args:
        fractions: Each part's fraction of the weight; None if all are equal. The mean is close to
            that of a part with most of it, so the variance is the jackknife's, with degrees of
            freedom by Bell and McCaffrey (2002).
    """
    count = len(parts)
    freedom = count - 1.0
    if fractions is not None and np.ptp(fractions):
        parts = parts * (without := (1 - 1 / count) / (1 - fractions).clip(ROUNDED))
        scale = count * without * fractions
        # The variance is a quadratic form with the matrix diag(scale^2) + U S U'. Its traces are
        # found without the matrix, N x N, which would be large for many levels.
        u = np.stack([scale**2, fractions, scale - scale.sum() * fractions], 1)
        s = np.array([[0, -1, 0], [-1, (scale**2).sum(), 0], [0, 0, -1 / count]])
        inner = s @ u.T @ u
        trace = (scale**2).sum() + np.trace(inner)
        squares = (scale**4).sum() + np.trace(2 * s @ (u.T * scale**2) @ u + inner @ inner)
        freedom = float(trace**2 / squares) if fractions.max() < 0.99 else 1.0  # else rounding
    return float(parts.var(ddof=1)) / count, freedom


def _among_levels(rest: np.ndarray, fractions: np.ndarray | None = None) -> tuple[float, float]:
    """Return the levels' part in the variance of the mean of `rest` [agents, levels].

    With it come its degrees of freedom; for `fractions` see `_of_mean`.
    """
    if rest.shape[1] == 1:
        return 0.0, 0.0
    variance, freedom = _of_mean(rest.mean(0), fractions)
    return max(0.0, variance - _noise(rest) / rest.size), freedom


def _between_agents(
    rest: np.ndarray,
    pool: Sequence[np.ndarray],
    rate: float | None,
    fractions: np.ndarray | None = None,
) -> tuple[float, float]:
    """Return the variance of the mean over agents, and its degrees of freedom.

    If pooled, it is the kinds' common variance, or their own if that is larger. For rates it is a
    multiple of p (1 - p), since agents cannot differ much where nearly all succeed.

    Args:
        rate: The estimated rate; None if the mean is not a rate.
        fractions: Each agent's, for `_of_mean`.
    """

    def unit(rate: float | None, count: int) -> float:
        if rate is None:
            return 1.0
        rate = (rate * count + 1) / (count + 2)
        return rate * (1 - rate)

    if (agents := len(rest)) == 1:
        return 0.0, math.inf
    variance, freedom = _of_mean(rest.mean(1), fractions)
    if several := [kind for kind in pool if len(kind) > 1]:
        freedom = sum(len(kind) - 1 for kind in several)
        common = sum(
            (len(kind) - 1)
            * float(kind.mean(1).var(ddof=1))
            / unit(None if rate is None else float(kind.mean()), kind.size)
            for kind in several
        )
        variance = max(variance, common / freedom * unit(rate, rest.size) / agents)
    return variance, freedom


def ends(mean: float, square: float, rate: bool, least: float) -> tuple[float, float]:
    """Return the ends of an interval whose symmetrical half-width would be sqrt(`square`).

    Args:
        least: Squared quantile over the number of values, for a mean of equal values: a different
            value may still occur.
    """
    if not rate:
        half = math.sqrt(square)
        if half <= ROUNDED * abs(mean):
            half = least / (1 + least) * max(1.0, abs(mean))
        return mean - half, mean + half
    variance = mean * (1 - mean)
    ratio = square / variance if square and variance > 0 else least
    middle = (mean + ratio / 2) / (1 + ratio)
    half = math.sqrt(ratio * variance + ratio**2 / 4) / (1 + ratio)
    # Rounding would leave a mean of 1 above its own interval, which no figure can show.
    return max(0.0, min(mean, middle - half)), min(1.0, max(mean, middle + half))


def _satterthwaite(parts: Sequence[tuple[float, float]]) -> float:
    """Return the degrees of freedom of a sum of variances with their own."""
    whole = sum(variance for variance, _ in parts)
    squares = sum(variance**2 / freedom for variance, freedom in parts if freedom > 0)
    known = [freedom for _, freedom in parts if 0 < freedom < math.inf]
    return whole**2 / squares if squares else float(min(known, default=1.0))


def mean_of(
    rows: pl.DataFrame, value: str | pl.Expr, *, rate: bool = False, lowest: float = 0.0
) -> Estimate:
    """Return the mean of a column or expression over all of `rows`; NaN without rows.

    Args:
        rate: Whether it is a rate of numbers from `lowest` to 1; of booleans it always is.
        lowest: As for `estimate_mean`.
    """
    known = rows.with_columns(value=value).drop_nulls("value")
    if known.is_empty():
        return Estimate.nothing()
    return estimate_rows(known, "value", rate=rate, lowest=lowest)


def group_rates(
    rows: pl.DataFrame, column: str, values: Sequence[str], by: Sequence[str]
) -> pl.DataFrame:
    """Return the rate of each of `values` of a column, with it, as `group_means` of each.

    Raises:
        ValueError: If rows have other values and lack one of `values`, or as for `group_means`.
    """
    occurred = {*rows[column].drop_nulls()}
    for one in values if not occurred <= {*values} else ():
        one_of(column, one, sorted(occurred), of="these rows")
    found = [group_means(rows.with_columns(pl.col(column) == one), column, by) for one in values]
    named = zip(found, values, strict=True)
    return pl.concat([rates.with_columns(pl.lit(one).alias(column)) for rates, one in named])


def group_means(
    rows: pl.DataFrame, value: str, by: Sequence[str], *, per: str | None = None
) -> pl.DataFrame:
    """Return the mean of the column `value` in each group of `rows`, with 95 % intervals.

    Steps of one episode are correlated. As in `estimate_mean`, the independent units are therefore
    agents (columns of `AGENT`; one if all are missing) and levels. Rows with a null `value` are
    ignored.

    Args:
        by: Columns that define the groups.
        per: Column, not negative; the mean is then sum of `value` over sum of `per`.

    Returns:
        Columns of `by`, mean, low, high (null if the sum of `per` is 0), agents, levels, rows,
        freedom.

    Raises:
        ValueError: If a column is missing, `per` is negative, or an argument is of another kind.
    """
    of_kind("rows", rows, pl.DataFrame)
    of_kind("value", value, str)
    of_kind("by", by, list | tuple)
    missing = {value, "level", *by, *([per] if per else [])} - set(rows.columns)
    if missing:
        raise ValueError(f"no column {', '.join(sorted(missing))}; there are: {rows.columns}")
    known, found = rows.drop_nulls(value), []
    if known.is_empty():
        raise ValueError(f"no row of {len(rows)} has a value of {value!r}")
    for key, group in known.group_by(by):
        estimate = estimate_rows(group, value, per)
        found.append(dict(zip(by, key, strict=True)) | vars(estimate))
    table = pl.DataFrame(found, infer_schema_length=None).sort(by)
    return table.with_columns(pl.col("mean", "low", "high").fill_nan(None))


def estimate_rows(
    rows: pl.DataFrame,
    value: str,
    per: str | None = None,
    *,
    rate: bool = False,
    lowest: float = 0.0,
) -> Estimate:
    """Return the sum of `value` over that of `per` (1 if None), whichever levels each agent has.

    Raises:
        ValueError: If a row has no level.
    """
    if nulls := rows["level"].null_count():
        raise ValueError(f"each row must have a level; {nulls} of {len(rows)} have none")
    agent = [name for name in AGENT if name in rows.columns]
    numbers = rows.select(
        (pl.struct(agent).rank("dense") if agent else pl.lit(1)).alias("agent"),
        pl.col("level").rank("dense"),
    )
    cell = tuple(numbers.to_numpy().T.astype(np.int64) - 1)
    totals, weights = np.zeros((2, *(int(code.max()) + 1 for code in cell)))
    np.add.at(totals, cell, rows[value].cast(pl.Float64).to_numpy())
    np.add.at(weights, cell, rows[per].to_numpy() if per else 1.0)
    rate |= not per and rows[value].dtype == pl.Boolean
    found = estimate_mean(totals, weights, rate=rate, lowest=lowest)
    return replace(found, rows=len(rows))  # not of all agents in all levels
