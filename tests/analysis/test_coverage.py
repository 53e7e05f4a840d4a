"""95 % intervals hold what they are of in some 95 of 100 experiments, however few the agents."""

import itertools

import numpy as np
import polars as pl
import pytest
from scipy.special import expit
from scipy.stats import binom, multinomial, norm

from astray.analysis.estimates import estimate_difference, estimate_mean, estimate_paired
from astray.experiments.outcomes import AGENTS, rate
from astray.outcome import FAILED, INTENDED, MISGENERALIZED
from helpers.thorough import thorough

LEVELS, TIMES = 150, 400
MANY = 800  # times, where coverage is near its bound
SMALL, LARGE, HUGE = 0.05, 0.65, 1.5  # standard deviations between agents, in logits; at 60 % the
# second is 15 points, at 95 % it is 3
HARD = 1.5  # of levels, likewise
HALF, NEARLY_ALL = 0.4, 3.2  # middle logits


def play(random, agents, middle, spread, hard, shared):
    """Whether episodes succeed, [times, agents, levels], and the chance of each agent's."""
    agent = random.normal(0, spread, (TIMES, agents, 1))
    level = random.normal(0, hard, (TIMES, 1 if shared else agents, LEVELS))
    success = random.random((TIMES, agents, LEVELS)) < expit(middle + agent + level)
    return success, agent[:, :, 0]


def expected(middle, spread):
    """The mean success of what is normal around `middle`, by Gauss and Hermite."""
    x, weight = np.polynomial.hermite_e.hermegauss(80)
    return expit(np.asarray(middle)[..., None] + spread * x) @ weight / weight.sum()


def covered(agents, middle, spread, hard, shared, **options):
    random = np.random.default_rng([agents, int(100 * middle), int(100 * spread), shared])
    success, agent = play(random, agents, middle, spread, hard, shared)
    truth = np.full(TIMES, expected(middle, np.hypot(spread, hard)))
    if agents == 1:  # alone it speaks for itself
        truth = expected(middle + agent[:, 0], hard)
    found = [estimate_mean(one, **options) for one in success]
    assert all(0 <= one.low < one.high <= 1 for one in found)
    return np.mean([one.low <= true <= one.high for one, true in zip(found, truth, strict=True)])


@pytest.mark.parametrize("agents", [1, 2, *thorough(3, 5, 8, 10)])
def test_intervals_hold_the_truth_as_often_as_they_say(agents):
    for middle, spread, shared in itertools.product((HALF, NEARLY_ALL), (SMALL, LARGE), (1, 0)):
        held = covered(agents, middle, spread, HARD if shared else 0.0, shared)
        assert 0.92 <= held <= 0.99, (middle, spread, shared, held)


@pytest.mark.parametrize("agents, told", [(10, 0.64), *thorough((5, 0.43), (30, 0.92))])
def test_a_rare_agent_that_often_fails_is_missed_by_few(agents, told):
    """Nine of ten never fail, one in half of its episodes: as often as docs/evaluation.md says.

    No interval that is made of what they do can know of it.
    """
    random = np.random.default_rng(agents)
    chance = np.where(random.random((TIMES, agents, 1)) < 0.1, 0.5, 1.0)
    success = random.random((TIMES, agents, LEVELS)) < chance
    held = np.mean([one.low <= 0.95 <= one.high for one in map(estimate_mean, success)])
    assert abs(held - told) < 0.06


@pytest.mark.parametrize("agents, told", [(2, 0.60), *thorough((3, 0.75), (4, 0.87), (5, 0.94))])
def test_agents_of_two_kinds_are_missed_where_all_are_of_one(agents, told):
    """Half succeed in 95 of 100 episodes, half in 5: as often as docs/evaluation.md says."""
    random = np.random.default_rng(agents)
    chance = np.where(random.random((TIMES, agents, 1)) < 0.5, 0.95, 0.05)
    success = random.random((TIMES, agents, LEVELS)) < chance
    held = np.mean([one.low <= 0.5 <= one.high for one in map(estimate_mean, success)])
    assert abs(held - told) < 0.05


@pytest.mark.parametrize("agents", [5, *thorough(10)])
def test_agents_that_differ_widely_are_covered_less_often(agents):
    """As docs/evaluation.md says; the rarest of them fail most."""
    assert abs(covered(agents, NEARLY_ALL, HUGE, 0.0, 0) - 0.87) < 0.04


@pytest.mark.parametrize(
    "agents, levels, middle, spread", [(1, 100, 3.5, SMALL), *thorough((8, 60, 4.5, LARGE))]
)
def test_the_difference_of_two_outcomes_is_covered_where_nearly_all_have_one(
    agents, levels, middle, spread
):
    """Half of the other episodes have the other outcome, or a tenth; Student's t held 86 and 89."""
    random, share = np.random.default_rng(agents), 0.5 if agents == 1 else 0.1
    at, seed = np.divmod(np.arange(levels * agents), agents)
    rows = pl.DataFrame({"level": at, "seed": seed}).with_columns(
        test=pl.lit("test"), policy=pl.lit(AGENTS)
    )
    names, held = np.array([MISGENERALIZED, INTENDED, FAILED]), []
    for _ in range(MANY):
        chance = expit(middle + random.normal(0, spread, agents))
        drawn = random.random((levels, agents))
        which = 0 + (drawn > chance) + (drawn > chance + (1 - chance) * share)
        found = rate(
            rows.with_columns(outcome=names[which].ravel()), "test", MISGENERALIZED, minus=INTENDED
        )
        truth = chance[0] if agents == 1 else expected(middle, spread)
        held.append(found.low <= truth - (1 - truth) * share <= found.high)
    assert 0.92 <= np.mean(held) <= 0.99


@pytest.mark.parametrize("levels", [20, *thorough(60, 100)])
def test_paired_rates_of_one_agent_are_covered_wherever_they_are(levels):
    """By the multinomial distribution, without chance; Student's t held 86 of 100."""
    counts = [(more, less) for more in range(levels + 1) for less in range(levels + 1 - more)]
    kinds, chances = (0, 0.01, 0.02, 0.05, 0.1, 0.3, 0.5, 0.7, 0.9, 0.95, 0.98), []
    at, found = np.arange(levels), []
    for more, less in counts:
        found.append(estimate_paired(at < more, (at >= more) & (at < more + less)))
    low, high = (np.array([getattr(one, end) for one in found]) for end in ("low", "high"))
    of_counts = np.column_stack([counts, levels - np.sum(counts, 1)])
    for more, less in ((p, q) for p in kinds for q in kinds if q < p and p + q <= 1):
        holds = (low <= more - less + 1e-9) & (more - less <= high + 1e-9)
        given = multinomial.pmf(of_counts, levels, [more, less, max(0.0, 1 - more - less)])
        chances.append(given[holds].sum())
    assert min(chances) >= 0.93 and np.mean(chances) <= 0.985


@pytest.mark.parametrize("how", [*thorough("both alike", "one or the other"), "by level"])
def test_paired_rates_of_several_agents_are_covered_where_nearly_all_differ(how):
    """And where few do; Student's t held 85 of 100."""
    for agents, levels, (one, other) in itertools.product(
        (2, 8), (10, 30), ((0.99, 0.01), (0.95, 0.05), (0.05, 0.01))
    ):
        random = np.random.default_rng([agents, levels, int(100 * one)])
        drawn = random.normal(0, 1, (2, TIMES, agents, levels))
        if how == "by level":
            drawn = (drawn + random.normal(0, 1, (1, TIMES, 1, levels))) / 2**0.5
        else:
            drawn[1] = drawn[0] if how == "both alike" else -drawn[0]
        apart = random.normal(0, 0.25, (2, TIMES, agents, 1))
        limits = norm.ppf([one, other])
        both = drawn + apart < limits[:, None, None, None]
        truth = np.subtract(*norm.cdf(limits / np.hypot(1, 0.25)))
        found = [estimate_paired(*pair) for pair in both.swapaxes(0, 1)]
        held = np.mean([each.low <= truth <= each.high for each in found])
        assert held >= 0.91, (agents, levels, one, other, held)


def test_rare_failures_are_covered_too():
    """Of 99.3 %: a failure in 143 episodes, so that counts are few."""
    for agents in (1, 2, 5):
        assert 0.9 <= covered(agents, 5.0, SMALL, 0.0, 0) <= 0.995


@pytest.mark.parametrize(
    "counts",
    [(1000, 30), *thorough([1000, 100, 100, 100, 100], [500, 200, 100], [1000, 1000, 1000, 10])],
)
def test_intervals_hold_the_truth_where_one_agent_has_most_of_the_episodes(counts):
    """Its mean is nearly that of all: as if agents hardly differed (54 to 90 of 100 held it)."""
    agents, random = len(counts), np.random.default_rng(counts)
    weights = np.array(
        [[(count + LEVELS - 1 - at) // LEVELS for at in range(LEVELS)] for count in counts]
    )
    for middle, spread in itertools.product((HALF, NEARLY_ALL), (SMALL, LARGE)):
        chance = expit(middle + random.normal(0, spread, (MANY, agents, 1)))
        sums = random.binomial(weights, np.broadcast_to(chance, (MANY, *weights.shape)))
        truth = expected(middle, spread)
        found = [estimate_mean(one, weights, rate=True) for one in sums]
        held = np.mean([one.low <= truth <= one.high for one in found])
        assert held >= 0.92, (middle, spread, held)


@pytest.mark.parametrize("agents, levels", [(1, 5), *thorough((1, 20), (4, 10))])
def test_intervals_hold_the_truth_where_some_levels_have_most_of_the_steps(agents, levels):
    """Or the weight: as if levels hardly differed (7 to 89 of 100 held it)."""
    random = np.random.default_rng([agents, levels])
    most, few = np.r_[300, np.full(levels - 1, 5)], np.arange(levels) < 3
    for weights in (random.geometric(0.05, (MANY, 1, levels)), most, 50 * few, 20):
        weights = np.broadcast_to(weights, (MANY, agents, levels))
        hard = random.normal(0, 1, (MANY, 1, levels)) + random.normal(0, 0.2, weights.shape)
        chance = random.beta(2, 2, (MANY, 1, levels))
        for sums, truth in ((hard * weights, 0), (random.binomial(weights, chance), 0.5)):
            both = zip(sums, weights, strict=True)
            found = [estimate_mean(one, each, rate=truth > 0) for one, each in both]
            assert np.mean([one.low <= truth <= one.high for one in found]) >= 0.92, truth


def test_an_agent_without_weight_says_nothing():
    random = np.random.default_rng(3)
    weights = random.integers(1, 9, (4, 20))
    values = random.binomial(weights, 0.7)
    more = [np.pad(each, (0, 1)) for each in (values, weights)]  # nor a level
    assert estimate_mean(*more, rate=True) == estimate_mean(values, weights, rate=True)


def test_of_one_agent_few_episodes_cover_rates_in_the_middle_and_less_often_near_the_ends():
    """By the binomial distribution, without chance: as docs/evaluation.md says."""
    rates = np.linspace(0.001, 0.999, 999)
    inner = (rates >= 0.1) & (rates <= 0.9)
    held = []
    for episodes in range(5, 21):
        counts = np.arange(episodes + 1)
        found = [estimate_mean((np.arange(episodes) < count)[None]) for count in counts]
        low, high = (np.array([getattr(one, end) for one in found]) for end in ("low", "high"))
        holds = (low <= rates[:, None]) & (rates[:, None] <= high)
        held.append((binom.pmf(counts, episodes, rates[:, None]) * holds).sum(1))
    middle, ends = np.array(held)[:, inner], np.array(held)[:, ~inner]
    assert round(middle.min(), 2) == 0.89 and round(middle.max(), 2) == 0.99
    assert round(ends.min(), 2) == 0.83


@pytest.mark.parametrize("agents", [2, *thorough(3, 5, 8)])
def test_differences_of_kinds_hold_the_truth_as_often_as_they_say(agents):
    for middle, spread, pooled in itertools.product((HALF, 2.5), (SMALL, LARGE), (False, True)):
        random = np.random.default_rng([agents, int(10 * middle), int(100 * spread)])
        level = random.normal(0, HARD, (MANY, 1, 1, LEVELS))
        agent = random.normal(0, spread, (MANY, 4, agents, 1))
        kind = np.array([HALF, middle, 1.0, 1.5])[:, None, None]
        success = random.random((MANY, 4, agents, LEVELS)) < expit(kind + agent + level)
        both = expected(np.array([HALF, middle]), np.hypot(spread, HARD))
        truth = both[0] - both[1]
        found = [
            estimate_difference(one[0], one[1], pool=list(one) if pooled else ())
            for one in success[::2]
        ]
        held = np.mean([one.low <= truth <= one.high for one in found])
        # Welch's degrees of freedom for two and two are told by the data, from 1 to 2: rather wide.
        most = 0.99 if agents > 2 or pooled else 0.997
        assert 0.92 <= held <= most, (middle, spread, pooled, held)


@pytest.mark.parametrize("agents", [2, *thorough(3, 5)])
def test_agents_that_differ_more_than_those_of_other_kinds_are_covered_less_often(agents):
    """As docs/evaluation.md says: a pool says how much they differ if all kinds differ alike."""
    random = np.random.default_rng([agents, 5])
    spread = np.array([1.2, *[SMALL] * 4])[:, None, None]
    chance = expit(HALF + random.normal(0, 1, (TIMES, 5, agents, 1)) * spread)
    kinds = random.random((TIMES, 5, agents, LEVELS)) < chance
    found, truth = [estimate_mean(one[0], pool=[*one]) for one in kinds], expected(HALF, 1.2)
    assert 0.78 <= np.mean([one.low <= truth <= one.high for one in found]) <= 0.92


@pytest.mark.parametrize("agents", [5, *thorough(8)])
def test_kinds_that_nearly_all_succeed_and_differ_widely_are_told_apart_too_often(agents):
    """As for a single kind, a rare agent that often fails is hardly ever among few."""
    random = np.random.default_rng([agents, 5])
    level = random.normal(0, HARD, (TIMES, 1, 1, LEVELS))
    agent = random.normal(0, HUGE, (TIMES, 2, agents, 1))
    success = random.random((TIMES, 2, agents, LEVELS)) < expit(5 + agent + level)
    found = [estimate_difference(*both) for both in success]
    assert 0.89 <= np.mean([one.low <= 0 <= one.high for one in found]) <= 0.95


@pytest.mark.parametrize("others, spread", [(5, 0.3), *thorough((9, 0.3), (9, LARGE), (20, LARGE))])
def test_two_agents_against_many_are_told_apart_too_often(others, spread):
    """As docs/evaluation.md says: Welch's freedom is too much where the two happen to be alike."""
    random = np.random.default_rng(others)
    level = random.normal(0, 1, (MANY, 1, LEVELS))
    kinds = [
        random.random((MANY, count, LEVELS))
        < expit(0.5 + level + random.normal(0, wide, (MANY, count, 1)))
        for count, wide in ((2, LARGE), (others, spread))
    ]
    truth = expected(0.5, np.hypot(LARGE, 1)) - expected(0.5, np.hypot(spread, 1))
    found = [estimate_difference(*both) for both in zip(*kinds, strict=True)]
    assert 0.85 <= np.mean([one.low <= truth <= one.high for one in found]) <= 0.92


@pytest.mark.parametrize("agents", [1, 8])
def test_means_with_a_long_tail_need_more_than_ten_levels(agents):
    random = np.random.default_rng(agents)
    for levels, least, most in ((5, 0.87, 0.93), (10, 0.87, 0.94), (100, 0.92, 0.97)):
        values = random.exponential(1, (TIMES, 1, levels)) + random.normal(
            0, 0.3, (TIMES, agents, levels)
        )
        held = np.mean([(one := estimate_mean(x)).low <= 1 <= one.high for x in values])
        assert least <= held <= most, (levels, held)


def test_nine_of_ten_is_not_enough():
    """An interval of another level than 95 % is noticed: the mean of all cells above is at it."""
    held = [covered(agents, HALF, LARGE, 0.0, 0) for agents in (2, 3, 5, 8, 10)]
    assert 0.94 <= np.mean(held) <= 0.965


@pytest.mark.parametrize(
    "agents, levels, least, most", [(8, 100, 0.87, 0.95), *thorough((10, 300, 0.66, 0.77))]
)
def test_levels_too_rare_for_a_test_are_missed_by_all_agents(agents, levels, least, most):
    """One of 200, in which all fail: as docs/evaluation.md says, no interval can know of it."""
    hard = np.random.default_rng(levels).random((TIMES, 1, levels)) < 0.005
    found = [estimate_mean(np.repeat(~one, agents, 0)) for one in hard]
    assert least <= np.mean([one.low <= 0.995 <= one.high for one in found]) <= most


@pytest.mark.parametrize("levels", [2, 5, *thorough(3, 12)])
def test_few_levels_that_differ_are_covered_with_many_agents_too(levels):
    random = np.random.default_rng(levels)
    hard, agent = (
        random.normal(0, 1, (2, MANY, 1, levels)),
        random.normal(0, 0.1, (2, MANY, 8, 1)),
    )
    one, other = hard + agent + random.normal(0, 0.5, (2, MANY, 8, levels))
    means = [estimate_mean(values) for values in one]
    apart = [estimate_difference(*both, same_levels=False) for both in zip(one, other, strict=True)]
    for found in (means, apart):
        assert np.mean([one.low <= 0 <= one.high for one in found]) >= (
            0.9 if levels == 2 else 0.92
        )
