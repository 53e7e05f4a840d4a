"""Asking for help: who acts when, and what curves of it come to."""

import copy
from dataclasses import dataclass, replace

import numpy as np
import polars as pl
import pytest
from scipy.stats import sem, t

from astray import games
from astray.acting import Answer, Turn
from astray.agents import policy as trained
from astray.analysis.adapters import Function
from astray.analysis.evaluate import evaluate
from astray.analysis.outcomes import INTENDED, MISGENERALIZED, label, load_shift
from astray.analysis.policies import Random, Walk
from astray.analysis.runs import load_agent
from astray.envs.vector import GameVectorEnv
from astray.mitigation import oversight
from astray.mitigation.helped import AFTER, BEFORE, SEEN, Helped, Watch, play
from astray.mitigation.oversight import (
    PERCENTILES,
    Trial,
    area,
    curve,
    least_gain,
    net_returns,
    threshold,
    training_scores,
    when_asked,
)
from astray.mitigation.uncertainty import Chance, OfLogits

MAZE = games.find("maze")
SHIFT = load_shift(MAZE, "corner-small")
CORNER, ANYWHERE = (
    MAZE.variant(name).with_knobs({"time_limit": 40}) for name in ("corner-small", "anywhere-small")
)
LEVELS = range(200_000, 200_020)


@pytest.fixture(scope="module")
def mouse():
    return load_agent("maze-corner")


@dataclass
class ByTime:
    """Uncertain in some steps, whatever is seen."""

    uncertain: tuple[int, ...]
    name: str = "time"

    def __call__(self, env, observations):
        return np.isin(env.states["time"], self.uncertain).astype(float)


def test_what_help_brings_is_told_level_by_level(mouse):
    trial = Trial("maze", SHIFT, CORNER, range(10), ANYWHERE, LEVELS)
    table = curve(mouse, Walk("cheese"), Chance(), trial, "step", (50.0,))
    alone = evaluate(mouse, "maze", ANYWHERE, LEVELS)["return"]
    best = evaluate(Walk("cheese"), "maze", ANYWHERE, LEVELS)["return"]
    nothing, all_of_it, _ = table.select("gain", "error").rows()
    assert nothing == (0, 0)
    assert all_of_it == pytest.approx(((best - alone).mean(), sem((best - alone).to_numpy())))


def test_the_least_gain_of_many_has_a_bound_for_all():
    points = pl.DataFrame(
        {
            "threshold": [np.inf, -np.inf, 0.1, 0.2, 0.3],
            "gain": [0.0, 2.0, -0.1, 0.5, 0.0],
            "error": [0.0, 0.1, 0.2, 0.5, 0.1],
            "levels": 9,
        }
    )
    width = t.isf(0.05 / 4, 8)
    assert least_gain(points) == pytest.approx((-0.1, 0.5 - 0.5 * width))


def test_the_least_gain_in_few_levels_is_bounded_as_often_as_it_says():
    """Help changes nothing on average: a gain was certain in 10 of 100, and where all were 0."""
    told = []
    for gains in np.random.default_rng(0).normal(0, 1, (1000, 4)):
        point = {"threshold": 0.0, "gain": gains.mean(), "error": sem(gains), "levels": 4}
        told.append(least_gain(pl.DataFrame([point]))[1] > 0)
    assert 0.03 < np.mean(told) < 0.07
    same = pl.DataFrame({"threshold": [0.0], "gain": [0.0], "error": [0.0], "levels": [5]})
    assert least_gain(same)[1] < -0.4


def test_without_help_the_novice_plays_as_it_does_and_with_all_of_it_the_expert(mouse):
    alone = evaluate(mouse, "maze", ANYWHERE, LEVELS)
    for granularity in ("step", "level"):
        never = Helped(mouse, Walk("cheese"), Chance(), np.inf, granularity)
        played = play(never, "maze", ANYWHERE, LEVELS)
        for column in ("level", "return", "length", "reached_corner"):
            assert played[column].to_list() == alone[column].to_list()
        assert played["queries"].sum() == 0 and played["first"].is_null().all()
        always = Helped(mouse, Walk("cheese"), Chance(), -np.inf, granularity)
        helped = play(always, "maze", ANYWHERE, LEVELS)
        assert (helped["return"] == 10).all() and (helped["queries"] == helped["length"]).all()


def test_an_expert_that_remembers_its_levels_does_as_one_that_solves_them_anew():
    anew, remembering = Walk("cheese"), Walk("cheese", remembers=True)
    first = evaluate(anew, "maze", ANYWHERE, LEVELS)
    for _ in range(2):
        assert evaluate(remembering, "maze", ANYWHERE, LEVELS).equals(first)
    solved = dict(remembering._experts)
    evaluate(remembering, "maze", ANYWHERE, LEVELS)
    assert all(remembering._experts[level] is expert for level, expert in solved.items())


def test_help_is_for_a_step_or_for_all_that_is_left_of_a_level():
    novice, expert = Random(), Walk("cheese")
    by_step = Helped(novice, expert, ByTime((2, 3, 7)), 0.5, "step")
    for length, queries in play(by_step, "maze", ANYWHERE, LEVELS)["length", "queries"].rows():
        assert queries == sum(t < length for t in (2, 3, 7))
    by_level = Helped(novice, expert, ByTime((2,)), 0.5, "level")
    played = play(by_level, "maze", ANYWHERE, LEVELS).filter(pl.col("length") > 2)
    assert (played["first"] == 2).all() and (played["queries"] == played["length"] - 2).all()
    assert (played["return"] == 10).all()


def test_in_coinrun_the_expert_goes_on_from_where_the_novice_has_come():
    """A way by the clock from where the level began would lead nowhere."""
    levels, coinrun = range(200_000, 200_030), games.find("coinrun")
    variant = coinrun.variant("coin-anywhere-calm")
    for asks, granularity in (((7,), "level"), (tuple(range(5, 1000, 2)), "step")):
        helped = Helped(Right(), Walk("coin"), ByTime(asks), 0.5, granularity)
        played = play(helped, coinrun, variant, levels)
        assert (played["return"] == 10).all(), granularity
    alone = evaluate(Right(), coinrun, variant, levels)
    assert alone["return"].mean() < 5


class Right:
    """Runs to the right, whatever is there."""

    name, observation, art = "right", "symbolic", "own"

    def actions(self, turn):
        return Answer(np.full(len(turn.observations), 7))


def test_a_walker_is_asked_where_a_level_begins_and_where_it_helps():
    asked = []

    class Counted(Walk):
        def ways(self, game, states):
            asked.extend(states["time"].tolist())
            return super().ways(game, states)

    helped = Helped(Random(), Counted("cheese"), ByTime((2, 5)), 0.5)
    assert (play(helped, "maze", ANYWHERE, LEVELS)["length"] > 5).any()
    assert set(asked) == {0, 2, 5}


def test_the_moment_of_the_first_query_is_told_from_the_state():
    watch = Watch(lambda s: s["time"] == 2, lambda s: s["time"] >= 4)
    for asks, moment in (((1, 3), BEFORE), ((3, 5), SEEN), ((5,), AFTER)):
        policy = Helped(Random(), Walk("cheese"), ByTime(asks), 0.5)
        played = play(policy, "maze", ANYWHERE, LEVELS, watch).filter(pl.col("first").is_not_null())
        assert len(played) and (played["moment"] == moment).all()


def test_thresholds_are_percentiles_of_steps_or_of_the_highest_of_levels():
    scores = pl.DataFrame({"level": [0, 0, 0, 1, 1], "score": [1.0, 5.0, 2.0, 3.0, 0.0]})
    assert threshold(scores, 50, "step") == 2 and threshold(scores, 100, "step") == 5
    assert threshold(scores, 50, "level") == 4 and threshold(scores, 0, "level") == 3
    with pytest.raises(ValueError, match="percentile must be a finite number from 0 to 100"):
        threshold(scores, 101, "step")


def test_scores_in_training_are_those_of_the_novices_own_steps(mouse):
    scores = training_scores(mouse, OfLogits(mouse, "entropy"), "maze", CORNER, LEVELS)
    alone = evaluate(mouse, "maze", CORNER, LEVELS)
    lengths = scores.group_by("level").len().sort("level")["len"]
    assert lengths.to_list() == alone["length"].to_list()


def curves(points, name="s"):
    rows = [{"score": name, "granularity": "step", "threshold": t, "help": h, "return": r,
             "queries": q, "percentile": None} for t, h, r, q in points]  # fmt: skip
    return pl.DataFrame(rows, schema_overrides={"percentile": pl.Float64})


def test_areas_are_those_by_hand():
    ends = [(np.inf, 0.0, 2.0, 0.0), (-np.inf, 1.0, 10.0, 8.0)]
    assert area(curves(ends))["area"].to_list() == [0.5]
    soon = curves([*ends, (1.0, 0.25, 10.0, 2.0)])
    assert area(soon)["area"].to_list() == [pytest.approx(0.25 / 2 + 0.75)]
    none = curves([(np.inf, 0.0, 10.0, 0.0), (-np.inf, 1.0, 10.0, 8.0)])
    assert np.isnan(area(none)["area"][0])


def test_the_dearer_a_query_the_fewer_are_worth_it():
    table = curves([(np.inf, 0.0, 2.0, 0.0), (-np.inf, 1.0, 10.0, 8.0), (1.0, 0.25, 7.0, 2.0)])
    best = net_returns(table, [0.0, 1.0, 3.0])
    assert best["net"].to_list() == [10.0, 5.0, 2.0] and best["queries"].to_list() == [8, 2, 0]
    alike = pl.concat([table, curves([(2.0, 0.5, 10.0, 4.0)])])
    assert net_returns(alike, [0.0])["queries"].to_list() == [4]  # of equals, the cheapest
    with pytest.raises(ValueError, match="a cost must be a finite number from 0 on; got -1"):
        net_returns(table, [-1.0])


def test_a_curve_goes_from_the_novice_to_the_expert(mouse):
    trial = Trial("maze", SHIFT, CORNER, range(40), ANYWHERE, LEVELS)
    table = curve(mouse, Walk("cheese"), OfLogits(mouse, "entropy"), trial, "step", (50.0, 90.0))
    assert table["percentile"].to_list() == [None, None, 50, 90]
    assert table["help"][0] == 0 and table["help"][1] == 1 and table["return"][1] == 10
    assert table["help"][1] > table["help"][2] > table["help"][3] > 0
    assert table["misgeneralized"][0] > 0.4 and table["intended"][1] > table["intended"][0] + 0.3
    assert (table["seconds"] > 0).all() and len(PERCENTILES) == 8


def test_a_function_is_a_score_by_its_own_name():
    def late(env, observations):
        return env.states["time"]

    trial = Trial("maze", SHIFT, CORNER, range(4), ANYWHERE, LEVELS[:4])
    how = Walk("corner"), Walk("cheese"), [late, Chance()], trial
    assert {*oversight.curves(*how, percentiles=[50.0])["score"]} == {"late", "random"}
    assert {*when_asked(how[0], how[2], trial)["score"]} == {"late", "random"}
    for same in ([late, late], [Chance(1), Chance(2)]):  # `area` would take them for one
        with pytest.raises(ValueError, match="scores must have names of their own; got"):
            oversight.curves(*how[:2], same, trial)


@pytest.mark.parametrize("name, shift", [("boat", "backwards"), ("monsters", "long")])
def test_help_is_tried_where_goals_are_counts(name, shift):
    """It was played, and then a column of the counts was missing."""
    game = games.find(name)
    between = load_shift(game, shift)
    knobs = {"time_limit": 50}
    training, test = (game.variant(v).with_knobs(knobs) for v in (between.train, between.test))
    trial = Trial(game, between, training, range(5), test, range(500, 520))
    none, full = curve(Random(1), Random(2), Chance(), trial, percentiles=()).to_dicts()
    for row, seed in ((none, 1), (full, 2)):
        outcome = label(evaluate(Random(seed), game, test, range(500, 520)), game, between)
        assert row["misgeneralized"] == (outcome["outcome"] == MISGENERALIZED).mean()
        assert row["intended"] == (outcome["outcome"] == INTENDED).mean()


@pytest.mark.thorough  # `test_a_curve_goes_from_the_novice_to_the_expert`
def test_what_curves_share_is_as_if_each_point_were_played_by_itself(mouse):
    watch = Watch(lambda s: s["time"] >= 2, lambda s: s["time"] >= 6)
    corner, anywhere = (one.with_knobs({"time_limit": 30}) for one in (CORNER, ANYWHERE))
    trial = Trial("maze", SHIFT, corner, range(40), anywhere, LEVELS, watch)
    scores = [OfLogits(mouse, "entropy"), OfLogits(mouse, "energy"), Chance()]
    table = oversight.curves(mouse, Walk("cheese"), scores, trial, ("step", "level"), (75.0,))
    assert len(table) == 3 * 2 * 3
    for score in scores:
        known = training_scores(mouse, score, MAZE, corner, range(40))
        for granularity in ("step", "level"):
            mine = table.filter(score=score.name, granularity=granularity)
            limits = [np.inf, -np.inf, threshold(known, 75, granularity)]
            assert mine["threshold"].to_list() == limits
            for row, limit in zip(mine.to_dicts(), limits, strict=True):
                policy = Helped(mouse, Walk("cheese"), score, limit, granularity)
                played = play(policy, MAZE, anywhere, LEVELS, watch)
                asked = played.filter(pl.col("queries") > 0)
                assert row["return"] == played["return"].mean()
                assert row["queries"] == played["queries"].mean()
                for moment in (BEFORE, SEEN, AFTER):
                    rate = (asked["moment"] == moment).mean() if len(asked) else None
                    assert row[moment] == rate
    asked = when_asked(mouse, scores, trial, 75.0)
    for score in scores:
        limit = threshold(training_scores(mouse, score, MAZE, corner, range(40)), 75, "step")
        alone = play(Helped(mouse, mouse, score, limit), MAZE, anywhere, LEVELS, watch)
        found = asked.filter(score=score.name).select(alone.columns)
        assert found.drop("highest").equals(alone.drop("highest"))
        assert found["highest"].to_list() == pytest.approx(alone["highest"].to_list())


def test_a_network_is_asked_once_a_step_by_all_who_ask_the_agent(mouse, monkeypatch):
    agent, calls = copy.copy(mouse), []
    forward = trained.outputs
    monkeypatch.setattr(trained, "outputs", lambda *a: calls.append(1) or forward(*a))
    helped = Helped(agent, Walk("cheese"), OfLogits(agent, "entropy"), 0.5)
    env = GameVectorEnv("maze", ANYWHERE, 5, observation="symbolic")
    shown, _ = env.reset(seed=0)
    helped.actions(Turn.of(env, shown))
    assert len(calls) == 1
    shown[:] = 0  # as an environment does that steps
    first = agent.outputs(shown)[0]
    assert len(calls) == 2 and not first.equal(mouse.outputs(env.reset(seed=1)[0])[0])


@dataclass
class Overwrites:
    """Acts as a policy does, and clears what it was shown."""

    policy: object
    name: str = "overwrites"
    observation: str = "symbolic"
    art: str = "own"

    def actions(self, turn):
        answer = self.policy.actions(turn)
        turn.observations[:] = 0
        return answer


class OverwritesByTime(ByTime):
    def __call__(self, env, observations):
        observations[:] = 0
        return super().__call__(env, observations)


def test_what_a_novice_or_a_score_writes_to_its_observations_is_shown_to_nobody_else(mouse):
    plain = play(Helped(mouse, mouse, ByTime((1, 2, 5)), 0.5), MAZE, ANYWHERE, LEVELS)
    novice, score = Overwrites(mouse), OverwritesByTime((1, 2, 5))
    helped = Helped(novice, copy.copy(mouse), score, 0.5)
    assert play(helped, MAZE, ANYWHERE, LEVELS).equals(plain)


def test_a_novice_and_an_expert_are_shown_the_same(mouse):
    sighted = copy.copy(mouse)
    sighted.architecture = replace(mouse.architecture, largest=())
    of_images = Function(lambda images: np.full(len(images), 7))
    for expert in (sighted, of_images):
        with pytest.raises(ValueError, match="must be shown the same; got 'symbolic' and 'image'"):
            Helped(mouse, expert, Chance(), 0.0)


def helped_by(score):
    return play(Helped(Walk("cheese"), Walk("corner"), score, 0.5), MAZE, CORNER, [1, 2])


SCORES = pl.DataFrame({"level": [0, 1], "score": [0.1, 0.2]})


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda: threshold(SCORES, "95", "step"), "percentile must be a finite number from 0 to"),
        (lambda: threshold(SCORES, np.nan, "step"), "percentile must be a finite number from 0 to"),
        (lambda: threshold(SCORES, 95, "steps"), "unknown granularity 'steps'"),
        (lambda: net_returns(SCORES, ["1"]), "a cost must be a finite number"),
        (lambda: Helped(Walk("cheese"), Walk("corner"), 0.5, 0.5), "a score must be a function"),
        (lambda: Helped(Walk("cheese"), Walk("corner"), Chance(), "1"), "threshold must be a int"),
        (lambda: Helped(Walk("cheese"), Walk("corner"), Chance(), np.nan), "threshold .*got nan"),
        (lambda: helped_by(lambda *_: np.full(2, np.nan)), r"must be 2 numbers, .*\[nan, nan\]"),
        (lambda: helped_by(lambda *_: np.ones((2, 1))), "must be 2 numbers, one per episode"),
        (lambda: helped_by(lambda *_: 0.7), "must be 2 numbers, one per episode; got 0.7"),
        (lambda: Trial("maze", "corner", *[None] * 4), "shift must be a Shift"),
    ],
)
def test_what_help_cannot_be_tried_with_is_told(make, message):
    with pytest.raises(ValueError, match=message):
        make()
