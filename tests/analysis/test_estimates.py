"""Intervals of groups of steps, that come in episodes."""

import numpy as np
import polars as pl
import pytest

from astray.analysis.estimates import bootstrap, group_means


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


def naive(rows, per, resamples=1000):
    """The interval, from bags of all rows of the agents drawn in the levels drawn."""
    random, means = np.random.default_rng(1), []
    agents, levels = (rows[name].unique().sort().to_list() for name in ("agent", "level"))
    episodes = {
        (a, lv): rows.filter(agent=a, level=lv).select("value", per).to_numpy().sum(0)
        for a in agents
        for lv in levels
    }
    for _ in range(resamples):
        some, where = random.choice(agents, len(agents)), random.choice(levels, len(levels))
        value, weight = sum(episodes[a, lv] for a in some for lv in where)
        means.append(value / weight)
    return np.quantile(means, [0.025, 0.975])


@pytest.mark.parametrize("per", [None, "size"])
def test_group_means_resample_episodes_whole(per):
    rows = steps().with_columns(one=1.0)
    found = group_means(rows, "value", ["late"], per=per)
    assert found["late"].to_list() == [False, True]
    for row in found.to_dicts():
        group = rows.filter(late=row["late"])
        mean = group["value"].sum() / (group[per].sum() if per else len(group))
        low, high = naive(group, per or "one")
        assert row["mean"] == pytest.approx(mean)
        assert (row["low"], row["high"]) == pytest.approx((low, high), abs=0.1 * (high - low))
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
    assert (a["mean"], a["rows"]) == (2, 2) and (a["low"], a["high"]) == (1, 3)
    assert (b["mean"], b["low"], b["high"]) == (None, None, None)


def test_equal_weights_change_nothing():
    values = np.random.default_rng(0).random((3, 30))
    assert bootstrap(values, np.ones((3, 30))) == bootstrap(values)


def test_columns_that_are_missing_are_named():
    with pytest.raises(ValueError, match=r"no column colour, worth; there are: \['agent'"):
        group_means(steps(), "worth", ["colour"])


def test_no_rows_have_no_means():
    rows = pl.DataFrame(
        {"level": [1], "what": ["a"], "value": [None]}, schema_overrides={"value": float}
    )
    with pytest.raises(ValueError, match="no row of 1 has a value of 'value'"):
        group_means(rows, "value", ["what"])
