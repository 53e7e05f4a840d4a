"""What the studies of CoinRun count, by hand."""

from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

from astray.analysis.outcomes import FAILED, INTENDED, MISGENERALIZED
from astray.experiments.run import run_folder
from astray.experiments.studies.coinrun import (
    attribution,
    coin_diversity,
    critic_value,
    permeable_wall,
)


@pytest.mark.parametrize("size", ["smoke", "hour", "paper"])
def test_studies_of_coinrun_share_the_agents_without_random_coins(size, tmp_path):
    folders = {
        run_folder(tmp_path, study.EXPERIMENT.sizes[size].config)
        for study in (coin_diversity, critic_value, permeable_wall)
    }
    assert len(folders) == 1


def test_who_gets_to_the_end_before_an_invisible_coin_has_missed_it():
    blind = pl.DataFrame(
        {
            "seed": 0,
            "level": range(5),
            "reached_end": [9, 9, 9, None, None],
            "took_invisible": [None, 5, 9, 5, None],
        }
    )
    assert coin_diversity.missed_invisible(blind).tolist() == [[1, 0, 0, 0, 0]]


def test_both_ways_of_counting_failures():
    """Level 2 is out where the agent without random coins touches the invisible coin by chance."""
    outcomes = [INTENDED, MISGENERALIZED, MISGENERALIZED, FAILED]
    every = [
        pl.DataFrame(
            {
                "policy": policy,
                "test": test,
                "agent": agent,
                "seed": seed,
                "level": range(4),
                "outcome": outcomes,
            }
        )
        for test in coin_diversity.TESTS
        for policy, agent, seed in (("sampled", "few", 0), ("walk to end", None, None))
    ]
    trained = pl.DataFrame(
        {
            "agent": "few",
            "seed": 0,
            "level": range(4),
            "outcome": outcomes,
            "took_coin": [3, None, 5, None],
        }
    )
    blind = pl.concat(
        [
            pl.DataFrame(
                {
                    "test": test,
                    "seed": 0,
                    "level": range(4),
                    "reached_end": [9, 9, 9, None],
                    "took_invisible": [None, None, 4, None],
                }
            )
            for test in coin_diversity.TESTS
        ]
    )
    config = SimpleNamespace(knobs={"random_coin": 0.02})
    work = SimpleNamespace(
        plan=SimpleNamespace(agents={"few": config}),
        episodes=pl.concat(every, how="diagonal_relaxed"),
    )
    table = coin_diversity.curves(work, trained, blind).filter(test="coin on a ledge")
    means = {(r["levels_counted"], r["what"]): r["mean"] for r in table.to_dicts()}
    assert table["random_coins"].to_list()[:2] == [2, 2]
    assert means[coin_diversity.ALL, MISGENERALIZED] == 0.5
    assert means[coin_diversity.MISSED, MISGENERALIZED] == pytest.approx(1 / 3)
    assert means[coin_diversity.ALL, FAILED] == 0.25
    assert means[coin_diversity.MISSED, FAILED] == 0.5  # all without the coin
    assert means[coin_diversity.ALL, coin_diversity.BASE] == 0.5
    assert means[coin_diversity.MISSED, coin_diversity.BASE] == pytest.approx(2 / 3)
    assert means[coin_diversity.ALL, coin_diversity.WALK] == 0.5


def test_fates_at_the_wall():
    table = permeable_wall.at_wall(
        pl.DataFrame(
            {"test": "", "policy": "sampled", "seed": 0, "level": range(5),
             "touched_wall": [None, 5, 5, 5, 5], "passed_wall": [None, 9, None, None, None],
             "died": [3, 12, 8, None, None], "to_wall": [5.0, -20, -3, -3, 0]},
        )
    )  # fmt: skip
    there = [
        permeable_wall.THROUGH,
        permeable_wall.DIED,
        permeable_wall.INSIDE,
        permeable_wall.BEFORE,
    ]
    assert table["fate"].to_list() == there


def test_the_peak_is_the_first_highest_value_of_each_episode():
    table = pl.DataFrame({"agent": 0, "level": [1, 1, 1, 2], "step": [0, 1, 2, 0],
                          "value": [1.0, 5, 5, 2]})  # fmt: skip
    assert permeable_wall.peak(table).select("level", "step").rows() == [(1, 1), (2, 0)]


def test_the_peak_is_pictured_among_evenly_spaced_steps():
    data = pl.DataFrame({"value": np.eye(1, 51, 23)[0]})
    assert permeable_wall.moments(data) == [0, 10, 23, 30, 40, 50]


def test_values_rise_within_an_agent_and_level():
    table = pl.DataFrame(
        {"agent": [0, 0, 0, 0, 1], "level": [1, 1, 1, 2, 1],
         "stage": ["beginning", "beginning", "end", "end", "beginning"],
         "value": [1.0, 3, 7, 9, 100]},
    )  # fmt: skip
    assert critic_value.rises(table)["rise"].to_list() == [5]


def attributed(wall, coin, network):
    """Fractions of a map on the wall and the coin, over their areas, in 60 levels."""
    random, rows = np.random.default_rng(len(network)), []
    for test in attribution.TESTS:
        for agent in range(4):
            for level in range(60):
                for part, area, times in (("end wall", 0.2, wall), ("coin", 0.002, coin)):
                    rate = area * times * random.lognormal(0, 0.2)
                    rows.append((agent, test, level, 0, "gradient", part, rate, area, network))
    names = ["agent", "test", "level", "step", "method", "part", "attribution", "area", "network"]
    return pl.DataFrame(rows, names, orient="row")


@pytest.mark.parametrize(
    "wall, coin, supported",
    [
        (1.0, 1.2, (False, False)),  # as networks that were never trained: all places are alike
        (1.5, 4.4, (False, True)),  # most on the wall, and for their size on the coin
        (2.1, 0.7, (True, True)),
    ],
)
def test_the_wall_is_not_highlighted_for_being_large(wall, coin, supported):
    untrained = attributed(1.0, 1.2, "never trained")
    told = attribution.claims(attributed(wall, coin, "trained"), untrained)
    assert tuple(claim.supported for claim in told) == supported
    assert not any(claim.supported for claim in attribution.claims(untrained, untrained))
