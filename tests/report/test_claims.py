"""Claims can fail: each kind, and each among others."""

import numpy as np
import pytest
from scipy import stats

from astray.analysis.estimates import estimate_mean
from astray.estimate import Estimate
from astray.report.claims import above, below, corrected, every, near_zero, nonzero, within

WORDS = ("It does.", "yes", "measured")


def found(mean, half, freedom=9.0):
    return Estimate(mean, mean - half, mean + half, 10, 100, 1000, freedom)


@pytest.mark.parametrize(
    "kind, bounds, supported",
    [
        (above, [(0.3, 0.1, 0.19), (0.3, 0.1, -1)], [(0.3, 0.1, 0.21)]),
        (below, [(0.3, 0.1, 0.41)], [(0.3, 0.1, 0.39)]),
        (near_zero, [(0.01, 0.05, 0.1), (-0.04, 0.05, 0.1)], [(0.01, 0.05, 0.04), (0.0, 0.2, 0.1)]),
        (within, [(0.3, 0.1, (0.1, 0.5))], [(0.3, 0.1, (0.25, 0.5)), (0.3, 0.1, (0.1, 0.35))]),
    ],
)
def test_a_claim_is_supported_where_all_of_its_interval_does(kind, bounds, supported):
    for supported_so, cases in ((True, bounds), (False, supported)):
        for mean, half, bound in cases:
            claim = kind(*WORDS, found(mean, half), bound)
            assert claim.supported is supported_so
            assert (claim.chance < 0.025) is supported_so


def test_no_effect_is_not_shown_by_measuring_little():
    """An interval around 0 is near it only if it is short."""
    random = np.random.default_rng(0)
    few, many = (estimate_mean(random.normal(0, 1, count)) for count in (8, 40_000))
    assert few.low < 0 < few.high
    assert not near_zero(*WORDS, few, 0.1).supported and near_zero(*WORDS, many, 0.1).supported


def test_of_nothing_nothing_holds():
    for claim in (above, below, near_zero):
        told = claim(*WORDS, Estimate.nothing(), 0.5)
        assert not told.supported and told.chance == 1


def test_the_chance_is_that_of_students_test():
    values = np.random.default_rng(0).normal(0.4, 1, 20)
    error = values.std(ddof=1) / 20**0.5
    for kind, bound, sign in ((above, 0.1, 1), (below, 0.7, -1)):
        exact = stats.t.sf(sign * (values.mean() - bound) / error, 19)
        assert kind(*WORDS, estimate_mean(values), bound).chance == pytest.approx(exact)


def test_among_many_claims_each_must_be_surer():
    """Holm's rule, by hand: 0.025 over 3, over 2, over 1; the first that fails ends it."""
    chances = (0.004, 0.02, 0.011)
    claims = [
        above(*WORDS, found(0.3, 0.3 * stats.t.ppf(0.975, 9) / stats.t.isf(p, 9))) for p in chances
    ]
    assert [claim.chance for claim in claims] == pytest.approx(chances)
    assert all(claim.supported for claim in claims)
    assert [claim.supported for claim in corrected(claims)] == [True, True, True]
    lonely = [claims[1], claims[1], claims[0]]  # 0.02 is more than a half of 0.025
    supported = corrected(lonely)
    assert [claim.supported for claim in supported] == [False, False, True]
    assert "not enough among 3 claims" in supported[0].ours and "p = 0.004" in supported[2].ours
    assert corrected([claims[1]])[0].supported


def test_the_chance_of_an_effect_is_that_of_its_direction():
    assert nonzero(found(-0.3, 0.1)) == above(*WORDS, found(0.3, 0.1)).chance
    assert nonzero(found(0.0, 0.0)) == 1


def test_by_chance_no_more_than_one_page_in_forty_has_a_supported_claim():
    random = np.random.default_rng(0)
    pages, wrong = 400, np.zeros(2)
    for _ in range(pages):
        claims = [above(*WORDS, estimate_mean(random.normal(0, 1, (5, 1)))) for _ in range(6)]
        wrong += any(c.supported for c in claims), any(c.supported for c in corrected(claims))
    assert wrong[0] / pages > 0.1 and wrong[1] / pages < 0.04


def test_parts_hold_together_or_not_at_all():
    good, bad = above(*WORDS, found(0.3, 0.1)), above(*WORDS, found(0.05, 0.1))
    both = every("All do.", "", [good, bad])
    assert not both.supported and both.chance == bad.chance
    assert good.ours in both.ours and bad.ours in both.ours
    assert every("All do.", "", [good, good]).supported and not every("All do.", "", []).supported
