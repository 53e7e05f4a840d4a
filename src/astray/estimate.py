"""A mean with its interval and what it is of, and its words: one type for all that is measured."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, ClassVar, Self


@dataclass(frozen=True)
class Estimate:
    """A mean and its 95 % interval; NaN where there was nothing to take the mean of."""

    mean: float
    low: float
    high: float
    agents: int  # that were averaged
    levels: int  # that each was played on; of a measure without levels, its episodes
    rows: int  # values in all; more than agents x levels where a level gives several states
    unit: ClassVar[str] = "levels"

    @classmethod
    def of(cls, row: dict[str, Any]) -> Self:
        """The estimate in a row of `group_means`, where null stands for NaN."""
        ends = (math.nan if row[name] is None else row[name] for name in ("mean", "low", "high"))
        return cls(*ends, agents=row["agents"], levels=row["levels"], rows=row["rows"])

    @classmethod
    def nothing(cls) -> Self:
        """The estimate of no values."""
        return cls(math.nan, math.nan, math.nan, agents=0, levels=0, rows=0)

    def percent(self) -> str:
        """A share and its interval, in words."""
        mean, low, high = (f"{100 * x:.1f}" for x in (self.mean, self.low, self.high))
        return f"{mean}\u00a0% ({self._interval(low, high)})" if self.rows else "none of none"

    def amount(self, digits: int = 3) -> str:
        """A number and its interval, in words, to so many digits."""
        mean, low, high = (f"{x:.{digits}g}" for x in (self.mean, self.low, self.high))
        return f"{mean} ({self._interval(low, high)})" if self.rows else "nothing to measure"

    def change(self) -> str:
        """A difference and its interval, in words, with their signs."""
        mean, low, high = (f"{x:+.2f}" for x in (self.mean, self.low, self.high))
        return f"{mean} ({self._interval(low, high)})" if self.rows else "nothing to compare"

    def counted(self) -> str:
        """What the mean is of."""
        agents = "1 agent" if self.agents == 1 else f"{self.agents} agents"
        several = self.rows > self.agents * self.levels
        told = f"{agents}, {self.levels:,} {self.unit}"
        return told + (f", n = {self.rows:,}" if several else "")

    def _interval(self, low: str, high: str) -> str:
        return f"95\u00a0% interval {low} to {high}; {self.counted()}"
