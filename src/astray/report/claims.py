"""Claims: sentences with a bound that was stated before anything was measured.

There are four kinds: a result is `above` a bound, `below` one, `within` two, or `near_zero`, which
stands for "no effect". A claim is supported if the whole 95 % interval satisfies it, so fewer
data make it harder to support. Claims of one page are `corrected` for their number.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

from astray.analysis.estimates import CONFIDENCE, quantile
from astray.estimate import Estimate

ALPHA = (1 - CONFIDENCE) / 2  # each end of an interval is a test of one side


@dataclass(frozen=True)
class Claim:
    """A tested claim."""

    sentence: str
    paper: str  # what the paper says of it; empty if nothing
    ours: str  # what was measured, its interval, and when the claim is supported
    supported: bool
    why: str = ""  # where it not supported: what else was measured of the reason
    chance: float | None = None  # of measuring as much where the bound is just the truth: p; None:
    # there is no test


def above(
    sentence: str, paper: str, measured: str, estimate: Estimate, bound: float = 0.0, **how: Any
) -> Claim:
    """Test the claim that a result is above `bound`; arguments as in `within`."""
    return within(sentence, paper, measured, estimate, (bound, math.inf), **how)


def below(
    sentence: str, paper: str, measured: str, estimate: Estimate, bound: float = 0.0, **how: Any
) -> Claim:
    """Test the claim that a result is below `bound`; arguments as in `within`."""
    return within(sentence, paper, measured, estimate, (-math.inf, bound), **how)


def within(
    sentence: str,
    paper: str,
    measured: str,
    estimate: Estimate,
    bounds: tuple[float, float],
    *,
    told: Callable[[Estimate], str] = Estimate.percent,
    why: str = "",
) -> Claim:
    """Test the claim that a result is between two bounds.

    Args:
        paper: The paper's statement about it.
        measured: Description of the result.
        bounds: Lower and upper bound of the whole interval.
        told: Method that formats the estimate; `Estimate.percent` formats bounds too.
        why: Further evidence about the reason, shown if the claim is not supported.
    """
    low, high = bounds
    ours = f"{measured}: {told(estimate)}; supported if {_rule(low, high, told)}"
    supported = bool(low < estimate.low and estimate.high < high)
    chance = max(_chance(estimate, low, 1), _chance(estimate, high, -1))
    return Claim(sentence, paper, ours, supported, why, chance)


def near_zero(
    sentence: str, paper: str, measured: str, estimate: Estimate, margin: float, **how: Any
) -> Claim:
    """Test the claim that there is no effect beyond `margin`; arguments as in `within`.

    It is an equivalence test (two one-sided tests). An interval that contains 0 shows nothing,
    since fewer data make that more likely.
    """
    return within(sentence, paper, measured, estimate, (-margin, margin), **how)


def every(sentence: str, paper: str, parts: Sequence[Claim], why: str = "") -> Claim:
    """Test the claim that all `parts` are supported; their own sentences are not shown.

    Each part is tested at the full level, because all are true by chance no more often than one.
    """
    chances = [part.chance for part in parts if part.chance is not None]
    return Claim(
        sentence,
        paper,
        "; ".join(part.ours for part in parts),
        bool(parts) and all(part.supported for part in parts),
        why,
        max(chances, default=1.0),
    )


def corrected(claims: Sequence[Claim]) -> list[Claim]:
    """Return the claims of one page with Holm's correction (1979) for their number.

    The smallest of N p-values must pass as one of N tests, the next as one of N - 1, and so on.
    After the first failure no claim is supported. Claims without a test stay unchanged.
    """
    tested = [k for k, claim in enumerate(claims) if claim.chance is not None]
    found, passing = list(claims), holm([claims[k].chance or 0.0 for k in tested])
    for k, passes in zip(tested, passing, strict=True):
        told = f"{claims[k].ours}; p = {claims[k].chance:.2g}"
        if len(tested) > 1 and claims[k].supported and not passes:
            told += f", which is not enough among {len(tested)} claims"
        found[k] = replace(claims[k], ours=told, supported=claims[k].supported and passes)
    return found


def holm(chances: Sequence[float]) -> list[bool]:
    """Return for each of N one-sided p-values whether it passes with Holm's correction (1979)."""
    passing = [False] * len(chances)
    for rank, k in enumerate(sorted(range(len(chances)), key=chances.__getitem__)):
        if chances[k] * (len(chances) - rank) >= ALPHA:
            break
        passing[k] = True
    return passing


def nonzero(estimate: Estimate) -> float:
    """Return the one-sided p-value of an effect in the direction that was measured.

    The direction is not stated before, so that both ends of the 95 % interval are at risk: `ALPHA`
    is half of it.
    """
    return min(_chance(estimate, 0.0, 1), _chance(estimate, 0.0, -1))


def rounded(rate: float) -> str:
    """Format a rate without its interval, for a sentence."""
    return "none" if math.isnan(rate) else f"{100 * rate:.0f}\u00a0%"


def _rule(low: float, high: float, told: Callable[[Estimate], str]) -> str:
    least, most = (
        f"{100 * bound:g}\u00a0%" if told is Estimate.percent else f"{bound:g}"
        for bound in (low, high)
    )
    if math.isinf(low) or math.isinf(high):
        return f"above {least}" if math.isinf(high) else f"below {most}"
    return f"all of it is within {most} of 0" if low == -high else f"between {least} and {most}"


def _chance(estimate: Estimate, bound: float, sign: int) -> float:
    """Return the one-sided p-value of a result if its bound is exactly true."""
    from scipy.special import stdtr  # here, as it takes a second to import

    if math.isinf(bound) or math.isnan(estimate.mean):
        return 0.0 if math.isinf(bound) else 1.0
    freedom = estimate.freedom or max(1, estimate.levels - 1)
    side = estimate.mean - estimate.low if sign > 0 else estimate.high - estimate.mean
    away = sign * (estimate.mean - bound)
    if side <= 0:
        return 0.0 if away > 0 else 1.0
    return float(stdtr(freedom, -away / side * quantile(freedom)))
