"""Environments that choose their levels themselves are played as streams, without pairs."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import polars as pl
import pytest

from astray.analysis import video
from astray.analysis.adapters import Function
from astray.analysis.dataset import export, read_trajectories, trajectories
from astray.analysis.estimates import mean_of, minus
from astray.analysis.evaluate import evaluate
from astray.analysis.outcomes import INTENDED, MISGENERALIZED, rates
from astray.analysis.policies import Random
from astray.analysis.runs import evaluate_policies
from astray.estimate import Estimate
from astray.experiments.audit import audit
from astray.experiments.compare import compare
from astray.experiments.outcomes import rate
from astray.game import Shift
from helpers.rooms import WORLD, Room, go_right

RIGHT = Function(go_right, "right")


class Stream(Room):
    """A room whose levels follow from the number of the stream alone, and are told in info."""

    def __init__(self, place="anywhere", stream=0):
        super().__init__(place)
        self.numbers = np.random.default_rng(stream)

    def reset(self, *, seed=None, options=None):
        level = int(self.numbers.integers(1000))
        seen, _ = super().reset(seed=level)
        return seen, {"level_seed": level}


STREAMS = replace(
    WORLD,
    name="streams",
    variants={"end": lambda stream=0: Stream("end", stream), "anywhere": Stream},
    repeats=False,
    level_key="level_seed",
)


def by_hand(stream, episodes):
    env, told = Stream(stream=stream), []
    for _ in range(episodes):
        _, info = env.reset()
        while not any(env.step(1)[2:4]):
            pass
        told.append((info["level_seed"], env.time))
    return told


def test_each_environment_plays_as_many_episodes_of_its_stream():
    table = evaluate(RIGHT, STREAMS, "anywhere", range(10), batch=4)
    hand = [by_hand(stream, 3) for stream in range(4)]
    wanted = [hand[row % 4][row // 4] for row in range(10)]
    assert table.select("level", "length").rows() == wanted


def test_no_level_of_a_stream_distinguishes_goals():
    result = evaluate_policies([RIGHT], STREAMS, "end", range(30))
    assert not result.episodes["distinguishing"].any()
    assert set(result.rates["levels_played"]) == {"all"}


@pytest.mark.usefixtures("undrawn")
def test_an_audit_of_streams_says_so_and_has_no_ghost_and_no_videos(tmp_path):
    with pytest.raises(ValueError, match="streams has no ghosts: its levels do not repeat"):
        audit(RIGHT, STREAMS, "end", ghost="end", out=tmp_path)
    page = audit(RIGHT, STREAMS, "end", levels=30, out=tmp_path)
    answer = json.loads((page.parent / "findings.json").read_text("utf-8"))["answer"]
    assert "streams is played as streams: its levels do not repeat" in answer
    assert not (page.parent / "videos").exists()
    text = page.read_text("utf-8")
    assert "episodes evaluated" in text and "found with a power" not in text


@pytest.mark.usefixtures("undrawn")
def test_an_audit_of_streams_without_proxies_compares_rates_of_other_levels(tmp_path):
    alone = {"end": Shift("end", "anywhere", "square", ())}
    page = audit(RIGHT, replace(STREAMS, shifts=alone), "end", levels=30, out=tmp_path)
    (_, lost) = json.loads((page.parent / "findings.json").read_text("utf-8"))["claims"]
    (table,) = page.parent.glob("computed/episodes-*.parquet")
    mine = pl.read_parquet(table).filter(policy="sampled")
    came = pl.col("outcome") == INTENDED
    rates = [mean_of(mine.filter(test=test), came) for test in ("in the test", "in training")]
    found = minus(*rates)
    assert found.percent() in lost["ours"] and found.mean < 0


def test_levels_that_do_not_repeat_distinguish_no_goals_and_are_not_compared(tmp_path):
    drawn = np.random.default_rng(0)

    class Anew(Room):
        def reset(self, *, seed=None, options=None):
            return super().reset(seed=int(drawn.integers(1000)))

    variants = {name: partial(Anew, name) for name in WORLD.variants}
    world = replace(WORLD, variants=variants, repeats=False)
    assert not evaluate_policies([RIGHT], world, "end", range(30)).episodes["distinguishing"].any()
    with pytest.raises(ValueError, match="room has no levels to compare agents in: its levels do"):
        compare([RIGHT, Random()], world, "end", range(8), tmp_path)
    with pytest.raises(ValueError, match="room has no ghosts: its levels do not repeat"):
        audit(RIGHT, world, "end", ghost="end", out=tmp_path)


@pytest.mark.usefixtures("undrawn")
def test_a_level_that_a_stream_has_often_counts_once_in_findings(tmp_path):
    class Few(Stream):
        def reset(self, *, seed=None, options=None):
            level = int(self.numbers.integers(4))
            return Room.reset(self, seed=level)[0], {"level_seed": level}

    world = replace(
        STREAMS, variants=dict.fromkeys(STREAMS.variants, lambda stream: Few(stream=stream))
    )
    page = audit(RIGHT, world, "end", levels=100, out=tmp_path)
    told = json.loads((page.parent / "findings.json").read_text("utf-8"))
    (table,) = page.parent.glob("computed/episodes-*.parquet")
    mine = pl.read_parquet(table).filter(policy="sampled", test="in the test")
    (row,) = rates(mine, outcomes=[INTENDED, MISGENERALIZED]).rows(named=True)[:1]
    assert f"in the test in {Estimate.of(row).short()}" in told["answer"] and row["levels"] == 4
    assert all("over 4 levels" in claim["ours"] for claim in told["claims"])
    assert "where levels distinguish" not in told["answer"], "none does"
    with pytest.raises(ValueError, match="level 0 has several episodes of one agent"):
        both = pl.read_parquet(table)
        rate(both, "in the test", INTENDED, minus_test="in training")


def test_agents_are_not_compared_in_streams(tmp_path):
    with pytest.raises(ValueError, match="streams has no levels to compare agents in: its levels"):
        compare([RIGHT, Random()], STREAMS, "end", range(8), tmp_path)


def test_a_data_set_of_a_stream_may_have_a_level_twice(tmp_path):
    class Same(Stream):
        def reset(self, *, seed=None, options=None):
            return super().reset()[0], {"level_seed": 7}

    world = replace(STREAMS, variants=dict.fromkeys(STREAMS.variants, lambda stream: Same()))
    played = [*trajectories(RIGHT, world, "anywhere", range(3), batch=1)]
    export(RIGHT, world, "anywhere", range(3), tmp_path / "data", batch=1)
    again = [*read_trajectories(tmp_path / "data", world)]
    for one, other in zip(again, played, strict=True):
        assert np.array_equal(one.observations, other.observations)
        assert one.actions.tolist() == other.actions.tolist()


class Shown(Stream):
    def __init__(self, place="anywhere", stream=0, render_mode=None):
        super().__init__(place, stream)
        self.render_mode = render_mode


def test_a_video_of_a_stream_tells_the_level_that_was_played():
    world = replace(STREAMS, variants=dict.fromkeys(STREAMS.variants, Shown))
    assert video.play(RIGHT, world, "anywhere", 5).level == by_hand(0, 1)[0][0] != 5


def test_a_stream_that_cannot_be_is_refused():
    with pytest.raises(ValueError, match="cannot be played again; say World\\(repeats=False\\)"):
        replace(STREAMS, repeats=True)
    with pytest.raises(ValueError, match="its info has no 'gone', the number of the level"):
        evaluate(RIGHT, replace(STREAMS, level_key="gone"), "anywhere", range(3))
    fixed = replace(STREAMS, variants=dict.fromkeys(STREAMS.variants, lambda: Room("anywhere")))
    with pytest.raises(ValueError, match=r"takes no such knob: got an unexpected .*'stream'"):
        evaluate(RIGHT, fixed, "anywhere", range(3))


@pytest.mark.parametrize("number", [2.7, "twelve", None, True, np.uint64(2**63 + 5), [1, 2]])
def test_a_number_of_a_level_that_is_no_integer_is_refused_and_not_cut_to_one(number):
    class Odd(Stream):
        def reset(self, *, seed=None, options=None):
            return super().reset(seed=seed)[0], {"level_seed": number}

    odd = replace(STREAMS, variants={"end": Odd, "anywhere": Odd})
    with pytest.raises(ValueError, match="the number of the level, must be an integer below"):
        evaluate(RIGHT, odd, "anywhere", range(3))
