"""A mean with its interval and what it is of, and its words: one type for all that is measured."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from typing import Any, Self


@dataclass(frozen=True)
class Estimate:
    """A mean and its 95 % interval; NaN where there was nothing to take the mean of."""

    mean: float
    low: float
    high: float
    agents: int  # that were averaged
    levels: int  # that each was played on; of a measure without levels, its episodes
    rows: int  # values in all; more than agents x levels where a level gives several states
    freedom: float | None = None  # degrees of freedom of the interval; None: as many as levels, or
    # one fewer

    @classmethod
    def of(cls, row: dict[str, Any]) -> Self:
        """Return the estimate in a row of `group_means`, where null stands for NaN."""
        values: dict[str, Any] = {field.name: row[field.name] for field in fields(cls)}
        values |= {name: math.nan for name in ("mean", "low", "high") if row[name] is None}
        return cls(**values)

    @classmethod
    def nothing(cls) -> Self:
        """Return the estimate of no values."""
        return cls(math.nan, math.nan, math.nan, agents=0, levels=0, rows=0)

    def percent(self) -> str:
        """Return a share and its interval, in words."""
        mean, low, high = (f"{100 * x:.1f}" for x in (self.mean, self.low, self.high))
        return f"{mean}\u00a0% ({self._interval(low, high)})" if self.rows else "none of none"

    def short(self) -> str:
        """Return a rate and its interval in figures, for a table that names the interval's kind."""
        mean, low, high = (f"{100 * x:.1f}" for x in (self.mean, self.low, self.high))
        return f"{mean} % ({low} to {high})" if self.rows else "none of none"

    def amount(self, digits: int = 3) -> str:
        """Return a number and its interval, in words, to so many digits."""
        mean, low, high = (f"{x:.{digits}g}" for x in (self.mean, self.low, self.high))
        return f"{mean} ({self._interval(low, high)})" if self.rows else "nothing to measure"

    def change(self) -> str:
        """Return a difference and its interval, in words, with their signs."""
        mean, low, high = (f"{x:+.2f}" for x in (self.mean, self.low, self.high))
        return f"{mean} ({self._interval(low, high)})" if self.rows else "nothing to compare"

    def over(self) -> str:
        """Return what the interval is over, in words: what might have come out otherwise."""
        levels = f"{self.levels:,} levels"
        if self.agents == 1:
            told = f"{levels}, of this agent alone"
        else:
            told = f"{self.agents} agents" + (f" and {levels}" if self.levels > 1 else "")
        several = self.rows > self.agents * self.levels
        return told + (f", n = {self.rows:,}" if several else "")

    def _interval(self, low: str, high: str) -> str:
        return f"95\u00a0% interval {low} to {high}, over {self.over()}"
