"""Intervals: what they are made of, and of groups of steps, that come in episodes."""

import functools
import itertools

import numpy as np
import polars as pl
import pytest
from scipy import stats

from astray.analysis.estimates import (
    detectable,
    estimate_difference,
    estimate_mean,
    estimate_paired,
    group_means,
    group_rates,
    mean_of,
    over_agents,
)
from astray.analysis.outcomes import FAILED, INTENDED, rates


def steps(seed=0, agents=4, levels=15):
    """Episodes of different lengths, whose steps are alike."""
    random, rows = np.random.default_rng(seed), []
    for agent in range(agents):
        for level in range(levels):
            level_value, length = random.normal(agent, 1), random.integers(1, 9)
            for step in range(length):
                value = level_value + random.normal(0, 0.1)
                rows.append((agent, level, step > 3, value, step + 1.0))
    return pl.DataFrame(rows, ["agent", "level", "late", "value", "size"], orient="row")


@pytest.mark.parametrize("per", [None, "size"])
def test_group_means_have_the_interval_of_whole_episodes(per):
    rows = steps().with_columns(one=1.0)
    found = group_means(rows, "value", ["late"], per=per)
    assert found["late"].to_list() == [False, True]
    for row in found.to_dicts():
        group = rows.filter(late=row["late"])
        episodes = group.group_by("agent", "level").agg(pl.col("value", per or "one").sum())
        episodes = episodes.sort("agent", "level")
        dense = episodes.pivot("level", index="agent").fill_null(0).sort("agent")
        value, weight = (
            dense.select(f"^{name}_.*$").to_numpy() for name in ("value", per or "one")
        )
        whole = estimate_mean(value, weight, rate=False)
        assert row["mean"] == pytest.approx(group["value"].sum() / group[per or "one"].sum())
        assert (row["low"], row["high"]) == pytest.approx((whole.low, whole.high))
        told = (row["agents"], row["levels"], row["rows"])
        assert told == (4, group["level"].n_unique(), len(group))


def test_steps_of_an_episode_that_are_alike_do_not_narrow_the_interval():
    rows = steps(agents=1, levels=40)
    more = pl.concat([rows] * 20)
    one, many = (group_means(r, "value", ["agent"]).row(0, named=True) for r in (rows, more))
    assert (many["low"], many["high"]) == pytest.approx((one["low"], one["high"]))
    assert many["rows"] == 20 * one["rows"]


def test_without_a_column_agent_all_is_of_one():
    rows = steps(agents=1)
    assert group_means(rows.drop("agent"), "value", ["late"]).equals(
        group_means(rows, "value", ["late"])
    )


def test_what_has_no_value_or_no_weight_is_left_out():
    rows = pl.DataFrame(
        {"level": [1, 2, 3, 4], "part": ["a", "a", "a", "b"], "value": [1.0, 3.0, None, 0.0],
         "area": [1.0, 1.0, 1.0, 0.0]}
    )  # fmt: skip
    a, b = group_means(rows, "value", ["part"], per="area").to_dicts()
    assert (a["mean"], a["rows"]) == (2, 2) and a["low"] < 1 and a["high"] > 3
    assert (b["mean"], b["low"], b["high"]) == (None, None, None)


@pytest.mark.parametrize("weights", [[2, 3, 0], [5, 0, 0], [2, 0, 3]])
def test_what_a_level_without_weight_sums_up_to_counts(weights):
    rows = pl.DataFrame({"level": [1, 2, 3], "value": [1.0, 2.0, 4.0], "area": weights})
    (whole,) = group_means(rows.with_columns(part=1), "value", ["part"], per="area").to_dicts()
    assert whole["mean"] == pytest.approx(7 / 5)
    assert whole["low"] < 7 / 5 < whole["high"] and whole["levels"] == 3


def test_equal_weights_change_nothing():
    values = np.random.default_rng(0).random((3, 30))
    assert estimate_mean(values, np.ones((3, 30))) == estimate_mean(values)


def test_with_one_agent_the_interval_of_a_rate_is_wilsons():
    for succeeded in (0, 1, 120, 399, 400):
        found = estimate_mean(np.arange(400) < succeeded)
        exact = stats.binomtest(succeeded, 400).proportion_ci(method="wilson")
        assert found.mean == succeeded / 400
        assert (found.low, found.high) == pytest.approx((exact.low, exact.high), abs=1e-12)


def test_what_is_never_less_is_no_rate():
    """Differences of pairs that are all 0 or 1 are not bounded by 0: others might be -1."""
    one, other = np.arange(1000) < 1, np.zeros(1000, bool)
    assert estimate_mean(one).low > 0 > estimate_paired(one, other).low


def test_of_one_agent_a_mean_has_students_interval_over_levels():
    values = np.random.default_rng(0).normal(5, 2, 12)
    exact = stats.t.interval(0.95, 11, values.mean(), values.std(ddof=1) / 12**0.5)
    found = estimate_mean(values)
    assert (found.low, found.high) == pytest.approx(exact)


def test_where_levels_are_alike_the_interval_is_students_over_agents():
    """Hold for means, and nearly for a fraction near the middle, at any level of confidence."""
    means = np.array([0.5, 0.52, 0.55])
    found = estimate_mean(np.tile(means[:, None], (1, 5000)))
    exact = stats.t.interval(0.95, 2, means.mean(), means.std(ddof=1) / 3**0.5)
    assert (found.low, found.high) == pytest.approx(exact, abs=1e-9)
    assert over_agents(means[:, None])[1:, 0] == pytest.approx(exact)
    random = np.random.default_rng(0)
    rate = estimate_mean(random.permuted(np.arange(5000) < 5000 * means[:, None], axis=1))
    assert (rate.low, rate.high) == pytest.approx(exact, abs=0.01)


def test_levels_that_all_agents_find_hard_widen_the_interval():
    shared = np.tile(np.arange(100) < 50, (5, 1))
    apart = np.random.default_rng(0).permuted(shared, axis=1)
    assert estimate_mean(shared).low < 0.45 < estimate_mean(apart).low


def test_no_interval_is_without_width():
    alike = np.ones((3, 10), bool)
    for values in (alike, alike[0], ~alike, ~alike[:1, :1], np.full((2, 9), 10.0)):
        found = estimate_mean(values)
        assert found.low < found.high
    difference = estimate_difference(alike, alike)
    assert -1 <= difference.low < 0 < difference.high <= 1
    paired = estimate_paired(alike, alike[:1])
    assert -1 <= paired.low < 0 < paired.high <= 1
    apart = estimate_paired(np.array([[True, True], [False, False]]), np.zeros((2, 2), bool))
    assert -1 <= apart.low < -0.98 and 0.98 < apart.high <= 1
    for agents, most in ((1, 0.03), (8, 0.01), (2, 0.1)):
        level = estimate_paired(*np.ones((2, agents, 100), bool))
        assert 0 < level.high < most and level.low == pytest.approx(-level.high)


@pytest.mark.parametrize("succeeds", [False, True])
def test_an_interval_holds_its_own_mean_where_all_episodes_are_alike(succeeds):
    for agents, levels in itertools.product(range(1, 6), range(1, 60)):
        found = estimate_mean(np.full((agents, levels), succeeds))
        assert 0 <= found.low <= found.mean == succeeds <= found.high <= 1, (agents, levels)


def test_a_difference_of_kinds_does_not_depend_on_the_order_of_seeds():
    random = np.random.default_rng(0)
    one, other = random.random((2, 3, 40)) < [[[0.7]], [[0.4]]]
    assert estimate_difference(one, other) == estimate_difference(one, other[::-1])


def test_a_difference_of_kinds_is_welchs():
    one, other = np.array([[5.0], [6.0], [8.0]]), np.array([[1.0], [1.5], [1.2], [0.9]])
    found = estimate_difference(one, other)
    errors = [kind.var(ddof=1) / len(kind) for kind in (one, other)]
    freedom = sum(errors) ** 2 / (errors[0] ** 2 / 2 + errors[1] ** 2 / 3)
    half = stats.t.ppf(0.975, freedom) * sum(errors) ** 0.5
    middle = one.mean() - other.mean()
    assert (found.low, found.high) == pytest.approx((middle - half, middle + half))


def test_what_is_hard_for_both_kinds_cancels_in_their_difference():
    random = np.random.default_rng(0)
    hard = random.random(400) < 0.5  # no agent gets these
    few, many = ((random.random((8, 400)) < p) & ~hard for p in (0.2, 0.8))
    found = estimate_difference(many, few)
    assert found.mean == pytest.approx(many.mean() - few.mean())
    assert 0.28 < found.low < 0.3 < found.high < 0.4
    others = estimate_difference(many, few[:, random.permutation(400)])
    assert found.high - found.low < 0.9 * (others.high - others.low)


def test_of_other_levels_each_kind_has_its_own_spread():
    random = np.random.default_rng(0)
    one, other = random.random(400) < 0.9, random.random(600) < 0.5
    found = estimate_difference(one, other, same_levels=False)
    p, q = one.mean(), other.mean()
    wide = 1.96 * np.sqrt(p * (1 - p) / 400 + q * (1 - q) / 600)
    assert found.mean == pytest.approx(p - q)
    assert (found.low, found.high) == pytest.approx((p - q - wide, p - q + wide), abs=0.005)
    with pytest.raises(ValueError, match="levels must be the same; got 400 and 600"):
        estimate_difference(one, other)


def test_agents_that_always_and_never_succeed_differ_by_newcombes_interval():
    found = estimate_difference(np.ones(40, bool), np.zeros(58, bool), same_levels=False)
    square = stats.norm.ppf(0.975) ** 2
    ends = square / (40 + square), square / (58 + square)  # Wilson's, from 1 and from 0
    assert (found.low, found.high) == pytest.approx((1 - np.hypot(*ends), 1))


def test_agents_of_other_kinds_tell_how_much_agents_differ():
    """Two agents tell next to nothing of it; sixteen kinds of two do."""
    random = np.random.default_rng(0)
    kinds = list(random.normal(5, 1, (16, 2, 1)))
    alone, pooled = (estimate_difference(kinds[0], kinds[1], pool=p) for p in ((), kinds))
    assert pooled.freedom == 16
    spread = np.sqrt(np.mean([kind.var(ddof=1) for kind in kinds]))
    own = max(spread, *(kind.std(ddof=1) for kind in kinds[:2]))
    assert pooled.high - pooled.mean <= stats.t.ppf(0.975, 16) * own * 2**0.5
    assert pooled.high - pooled.low < alone.high - alone.low


@pytest.mark.parametrize("rate", [False, True])
def test_a_pooled_difference_is_the_same_from_either_side_also_of_a_single_agent(rate):
    values = np.random.default_rng(0).normal(size=(4, 30)) + np.arange(4)[:, None] / 5
    kinds = [kind > 0.3 if rate else kind for kind in (values[:1], values[1:])]
    ours, theirs = (estimate_difference(*pair, pool=kinds) for pair in (kinds, kinds[::-1]))
    assert (ours.low, ours.high) == pytest.approx((-theirs.high, -theirs.low))
    assert ours.freedom == theirs.freedom
    if not rate:  # Student's quantile of the three: nothing tells how the single one varies
        spread = stats.t.ppf(0.975, 2) * kinds[1].mean(1).std(ddof=1) / 3**0.5
        assert ours.high - ours.mean >= spread


@pytest.mark.parametrize("pool", [np.ones((2, 3, 4)), iter([np.ones((3, 4))]), 5, ["x"]])
def test_a_pool_is_a_list_of_kinds_for_a_mean_and_a_difference_alike(pool):
    values = np.eye(3, 4)
    for estimate in (estimate_mean, functools.partial(estimate_difference, values)):
        with pytest.raises(ValueError, match="pool must be "):
            estimate(values, pool=pool)


@pytest.mark.parametrize("single", [np.ones(9), np.ones((1, 9))])
def test_a_pool_of_single_agents_says_nothing_of_their_spread(single):
    values = np.random.default_rng(0).normal(size=(3, 9))
    assert estimate_mean(values, pool=[single]) == estimate_mean(values)
    assert estimate_mean(values, pool=[single, values]) == estimate_mean(values)


def test_one_agent_alone_has_no_interval_over_agents():
    assert np.isnan(over_agents(np.ones((1, 2)))).tolist() == [[False] * 2, [True] * 2, [True] * 2]


@pytest.mark.parametrize("value", [0.0, 0.1, 10.0])
def test_agents_that_are_all_equal_have_no_interval_without_width(value):
    """As where the last episodes of each training all reach the goal."""
    alike, apart = over_agents(np.array([[value, 1.0], [value, 2.0], [value, 4.0]])).T
    assert alike[0] == pytest.approx(value) and np.isnan(alike[1:]).all()
    assert apart[1] < apart[0] < apart[2]


def test_columns_that_are_missing_are_named():
    with pytest.raises(ValueError, match=r"no column colour, worth; there are: \['agent'"):
        group_means(steps(), "worth", ["colour"])


def test_rates_of_groups_refuse_a_misspelt_value():
    rows = pl.DataFrame({"level": [1, 2], "fate": ["died", "late"], "all": [0, 0]})
    assert group_rates(rows, "fate", ["died", "late", "won"], ["all"])["mean"].to_list() == [
        0.5, 0.5, 0,
    ]  # fmt: skip
    with pytest.raises(ValueError, match="unknown fate 'dyed' of these rows; there are: died, la"):
        group_rates(rows, "fate", ["dyed", "late"], ["all"])


def test_no_rows_have_no_means():
    rows = pl.DataFrame(
        {"level": [1], "what": ["a"], "value": [None]}, schema_overrides={"value": float}
    )
    with pytest.raises(ValueError, match="no row of 1 has a value of 'value'"):
        group_means(rows, "value", ["what"])


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: estimate_mean(np.ma.masked_array([[1, 9]], [[0, 1]])), "numbers .*got masked"),
        (lambda: estimate_mean([np.ma.masked_array([1, 9], [0, 1])]), "numbers .*got .masked"),
        (lambda: estimate_mean(np.array([["1", "2"]])), "values must be numbers"),
        (lambda: estimate_mean(np.ones((1, 2)), np.array([[1, np.inf]])), "weights must be"),
        (lambda: estimate_mean(np.array([[2.0, 3.0]]), rate=True), "from 0 to 1; .* is 2.5"),
        (lambda: estimate_paired(np.ones((3, 5)), np.ones((3, 1))), r"got \(3, 5\) and \(3, 1\)"),
        (lambda: estimate_paired(np.ones((3, 5)), np.ones((2, 5))), r"got \(3, 5\) and \(2, 5\)"),
    ],
)
def test_what_would_be_taken_for_other_numbers_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()


def test_rates_of_tables_do_not_depend_on_the_order_of_their_rows():
    random = np.random.default_rng(0)
    rows = [
        ("p", variant, seed, level, INTENDED if random.random() < often else FAILED)
        for seed in range(3)
        for variant, often in (("one", 0.9), ("other", 0.1))
        for level in range(40)
    ]
    episodes = pl.DataFrame(rows, ["policy", "variant", "seed", "level", "outcome"], orient="row")
    told = rates(episodes, ["policy"])
    for seed in range(3):
        assert rates(episodes.sample(fraction=1, shuffle=True, seed=seed), ["policy"]).equals(told)
    reached = episodes.select("seed", "level", reached=pl.col("outcome") == INTENDED, all=1)
    both = group_means(reached.rename({"seed": "agent"}), "reached", ["all"])
    assert told.row(0)[2:5] == both.row(0)[1:4]  # a level counts once, also where it is met twice
    kind = reached.with_columns(agent=pl.lit("p"), run=pl.format("p/seed-{}", "seed"))
    for same in (reached, kind):  # as episodes of `evaluate_runs`, and of a study
        assert group_means(same, "reached", ["all"]).equals(both)
    apart = episodes.filter(pl.col("level") + 3 * pl.col("seed") < 40)  # fewer, of others
    assert rates(apart, ["policy"])["mean"][0] == (apart["outcome"] == INTENDED).mean()
    assert rates(apart.drop("seed"), ["policy"])["agents"][0] == 1
    of_game = [*told["outcome"], "burnt"]  # which none of the episodes is
    assert rates(episodes, ["policy"], of_game)["mean"].to_list() == [*told["mean"], 0]
    with pytest.raises(ValueError, match="each episode must have an outcome; 6 of 240 have none"):
        rates(episodes.with_columns(pl.when(pl.col("level") > 0).then("outcome").alias("outcome")))


@pytest.mark.parametrize("agents, kinds", [(3, 1), (8, 1), (2, 2), (5, 2), (3, 4), (1, 2), (2, 8)])
def test_what_is_detectable_is_found_in_four_of_five_runs(agents, kinds):
    """By the intervals themselves: of kinds that share their spread they found 67 to 75 of 100."""
    random, levels, spread = np.random.default_rng(1), 200, 0.04 * (agents > 1)
    effect, found = detectable(agents, levels, spread, kinds=kinds), []
    middle = np.array([effect, -effect, *[0] * kinds][:kinds]) / 2 + 0.5
    for chance in random.normal(middle, spread, (800, agents, kinds)).swapaxes(1, 2):
        one, *others = pool = list(random.random((kinds, agents, levels)) < chance[:, :, None])
        bound = 0.0 if others else 0.5 - effect / 2
        measured = estimate_difference(one, others[0], pool=pool) if others else estimate_mean(one)
        found.append(measured.low > bound)
    assert 0.76 <= np.mean(found) <= 0.85


def test_what_is_not_finite_has_no_interval():
    """A rate had one from 0 to 1, and a NaN in the pool left out the spread of all kinds."""
    plain = np.array([[True, False, True], [True, True, True]])
    for wrong in (np.nan, np.inf, -np.inf):
        spoilt = plain.astype(float)
        spoilt[0, 1] = wrong
        for found in (
            estimate_mean(spoilt, rate=True),
            estimate_mean(spoilt[:1]),
            estimate_mean(plain, pool=[spoilt]),
            estimate_difference(spoilt, plain),
            estimate_difference(plain, plain, pool=[spoilt]),
            estimate_paired(plain, spoilt),
        ):
            assert np.isnan([found.mean, found.low, found.high]).all(), (wrong, found)
            assert found.rows == plain[: found.agents].size


@pytest.mark.parametrize("value", [0.1, 1 / 3, -0.01, 123.4])
def test_equal_values_in_unequally_many_rows_have_a_width(value):
    """Their sums are rounded, so that deviations are not quite 0."""
    counts = np.random.default_rng(0).integers(1, 20, 24)
    rows = pl.DataFrame(
        {"agent": k % 3, "level": k // 3, "value": value} for k in np.arange(24).repeat(counts)
    )
    found = mean_of(rows, "value")
    assert found.mean == pytest.approx(value)
    assert found.high - found.low > 0.1


def test_rows_of_rates_are_the_episodes_that_were_played():
    """Two agents that played other levels have as many episodes, not each in all levels."""
    table = {"policy": "p", "variant": "v", "seed": [0, 0, 1], "level": [1, 2, 3]}
    episodes = pl.DataFrame(table | {"outcome": [INTENDED, FAILED, FAILED]})
    found = rates(episodes, outcomes=[INTENDED, FAILED])
    assert found["rows"].to_list() == [3, 3] and found["levels"].to_list() == [3, 3]


def test_rows_without_a_level_are_refused():
    rows = pl.DataFrame({"level": [1, None, 2], "value": [1.0, 2.0, 3.0], "kind": "a"})
    with pytest.raises(ValueError, match="each row must have a level; 1 of 3 have none"):
        group_means(rows, "value", ["kind"])
