"""Claims: sentences with a bound that was stated before anything was measured."""

from __future__ import annotations

import math
from dataclasses import dataclass

from astray.estimate import Estimate


@dataclass(frozen=True)
class Claim:
    """A claim that was tested."""

    sentence: str
    paper: str  # what the paper says of it
    ours: str  # what was measured, its interval, and when the claim holds
    held: bool
    why: str = ""  # where it did not hold: what else was measured of the reason


def holds_above(
    sentence: str, paper: str, measured: str, estimate: Estimate, bound: float, why: str = ""
) -> Claim:
    """A claim that holds where the whole interval of a share is above `bound`.

    measured  what the share is of, in words
    """
    ours = f"{measured}: {estimate.percent()}; holds above {100 * bound:g}\u00a0%"
    return Claim(sentence, paper, ours, estimate.low > bound, why)


def is_more(sentence: str, paper: str, measured: str, difference: Estimate) -> Claim:
    """A claim that holds where the whole interval of a difference is above 0."""
    ours = f"{measured}: {difference.change()}; holds above 0"
    return Claim(sentence, paper, ours, difference.low > 0)


def holds_within(
    sentence: str, paper: str, measured: str, estimate: Estimate, bounds: tuple[float, float]
) -> Claim:
    """A claim that holds where the whole interval is between two bounds, one of them maybe inf."""
    low, high = bounds
    if math.isinf(high):
        rule = f"above {low:g}"
    else:
        rule = f"below {high:g}" if math.isinf(low) else f"between {low:g} and {high:g}"
    ours = f"{measured}: {estimate.amount()}; holds where the interval is {rule}"
    return Claim(sentence, paper, ours, low < estimate.low and estimate.high < high)


def rounded(share: float) -> str:
    """A share without its interval, for a sentence."""
    return "none" if math.isnan(share) else f"{100 * share:.0f}\u00a0%"
