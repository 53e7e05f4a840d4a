"""Intervals. The unit of analysis is the agent: agents are resampled first, then levels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

RESAMPLES = 10_000


@dataclass(frozen=True)
class Estimate:
    """A mean and its bootstrap interval."""

    mean: float
    low: float
    high: float
    agents: int
    levels: int


def bootstrap(values: np.ndarray, *, seed: int = 0) -> Estimate:
    """The mean of `values` [agents, levels] and its 95 % interval.

    A resample draws agents with replacement, then levels with replacement, the same for all of
    them since they share what is hard about a level; the interval is the percentiles of its
    means. One agent alone speaks for itself: then only levels are resampled.
    """
    values = np.atleast_2d(np.asarray(values, float))
    agents, levels = values.shape
    rng = np.random.default_rng(seed)
    by_agent = rng.multinomial(agents, np.full(agents, 1 / agents), RESAMPLES).astype(float)
    means = np.empty(RESAMPLES)
    for part in np.array_split(np.arange(RESAMPLES), max(1, RESAMPLES * levels // 4_000_000)):
        by_level = rng.multinomial(levels, np.full(levels, 1 / levels), len(part)).astype(float)
        means[part] = np.einsum("ra,al,rl->r", by_agent[part], values, by_level, optimize=True)
    low, high = np.quantile(means / (agents * levels), [0.025, 0.975])
    return Estimate(float(values.mean()), float(low), float(high), agents, levels)
