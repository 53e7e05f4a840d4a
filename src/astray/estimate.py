"""Means with confidence intervals, and how they are written."""

import math
from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any, Self

from astray.validation import counted


@dataclass(frozen=True)
class Estimate:
    """A mean with its 95 % confidence interval; all are NaN if there were no values.

    Examples:
        >>> astray.Estimate(0.96, 0.93, 0.97, agents=4, levels=1000, rows=4000).over()
        '4 agents and 1,000 levels'
    """

    mean: float
    low: float
    high: float
    agents: int  # number of agents
    levels: int  # number of levels per agent; without levels, of episodes
    rows: int  # number of values; more than agents x levels if a level has several states
    freedom: float | None = None  # degrees of freedom of the interval; None if they equal the
    # number of levels or one less

    @classmethod
    def of(cls, row: dict[str, Any]) -> Self:
        """Return the estimate in a row of `group_means`; null becomes NaN."""
        values: dict[str, Any] = {field.name: row[field.name] for field in fields(cls)}
        values |= {name: math.nan for name in ("mean", "low", "high") if row[name] is None}
        return cls(**values)

    @classmethod
    def nothing(cls) -> Self:
        """Return the estimate of an empty set of values."""
        return cls(math.nan, math.nan, math.nan, agents=0, levels=0, rows=0)

    def percent(self) -> str:
        """Format a fraction and its interval as percentages."""
        return self._told(lambda x: f"{100 * x:z.1f}", "none of none", "\u00a0%")

    def short(self, digits: int | None = None) -> str:
        """Return a rate and its interval in figures, for a table that names the interval's kind.

        Args:
            digits: Number of digits of an amount; None for a rate, in percent.
        """
        ends, unit = (self.mean, self.low, self.high), " %" if digits is None else ""
        mean, low, high = (f"{100 * x:z.1f}" if unit else f"{x:z.{digits}g}" for x in ends)
        return f"{mean}{unit} ({low} to {high})" if self.rows else "none of none"

    def amount(self, digits: int = 3) -> str:
        """Format a number and its interval with the given number of digits."""
        return self._told(lambda x: f"{x:z.{digits}g}", "nothing to measure")

    def change(self) -> str:
        """Format a difference and its interval with their signs."""
        return self._told(lambda x: f"{x:+z.2f}", "nothing to compare")

    def over(self) -> str:
        """Describe what the interval is over: agents, levels, or both."""
        levels = counted(self.levels, "level")
        both = f"{self.agents} agents" + (f" and {levels}" if self.levels > 1 else "")
        told = f"{levels}, of this agent alone" if self.agents == 1 else both
        several = self.rows > self.agents * self.levels
        return told + (f", n = {self.rows:,}" if several else "")

    def _told(self, written: Callable[[float], str], nothing: str, unit: str = "") -> str:
        mean, low, high = map(written, (self.mean, self.low, self.high))
        told = f"{mean}{unit} (95\u00a0% interval {low} to {high}, over {self.over()})"
        return told if self.rows else nothing
