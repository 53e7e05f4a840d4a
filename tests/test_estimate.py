"""An estimate's words say its mean, its interval and what it is of."""

import math

import numpy as np
import polars as pl

from astray.analysis.estimates import estimate_mean, mean_of
from astray.estimate import Estimate


def test_words_say_what_was_averaged():
    rate = Estimate(0.974, 0.9641, 0.983, agents=1, levels=1000, rows=1000)
    assert rate.percent() == (
        "97.4\u00a0% (95\u00a0% interval 96.4 to 98.3, over 1,000 levels, of this agent alone)"
    )
    assert (rate.short(), rate.short(2)) == ("97.4 % (96.4 to 98.3)", "0.97 (0.96 to 0.98)")
    states = Estimate(-0.5, -1.0, 0.25, agents=2, levels=30, rows=90)
    assert states.change() == (
        "-0.50 (95\u00a0% interval -1.00 to +0.25, over 2 agents and 30 levels, n = 90)"
    )
    assert Estimate(0.5, 0.1, 0.9, 1, 1, 1).over() == "1 level, of this agent alone"
    assert Estimate(1234.5, 1.0, 2.0, 1, 2, 2).amount(2).startswith("1.2e+03 (")


def test_what_rounds_to_zero_has_no_sign_of_its_own():
    near = Estimate(-1e-4, -2e-4, -0.0, agents=1, levels=10, rows=10)
    assert near.percent().startswith("0.0\u00a0% (95\u00a0% interval 0.0 to 0.0,")
    assert near.change().startswith("+0.00 (95\u00a0% interval +0.00 to +0.00,")
    assert (near.short(), near.short(2)) == ("0.0 % (0.0 to 0.0)", "-0.0001 (-0.0002 to 0)")


def test_of_nothing_nothing_is_said():
    assert math.isnan(Estimate.nothing().mean)
    assert not any(c.isdigit() for c in Estimate.nothing().percent())


def test_the_mean_of_a_column_is_that_of_the_same_matrix():
    values = np.random.default_rng(1).random((3, 20))
    rows = pl.DataFrame([{"agent": a, "level": k, "x": v} for (a, k), v in np.ndenumerate(values)])
    whole, column = estimate_mean(values), mean_of(rows, 2 * pl.col("x"))
    assert np.allclose(
        [column.mean, column.low, column.high], [2 * whole.mean, 2 * whole.low, 2 * whole.high]
    )
    assert (column.agents, column.levels, column.rows) == (3, 20, 60)
    assert mean_of(rows.clear(), "x").rows == 0
