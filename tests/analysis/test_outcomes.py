"""Ends that are no goals, goals that are counts, and what did not happen by the end."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

from astray import games, testing
from astray.analysis.adapters import Function
from astray.analysis.dataset import export, read_trajectories
from astray.analysis.estimates import group_means
from astray.analysis.evaluate import evaluate
from astray.analysis.outcomes import (
    FAILED,
    INTENDED,
    MISGENERALIZED,
    REACHED_NEITHER,
    amounts,
    label,
    load_shift,
    matrix,
    outcomes_of,
    rates,
)
from astray.analysis.replay import replay
from astray.analysis.runs import evaluate_policies
from astray.experiments import spec
from astray.experiments.outcomes import AGENTS, outcome_plots, outcome_tables, rate
from astray.experiments.spec import Plan, Work
from astray.figures import charts
from astray.game import More, Shift
from astray.games.maze import GAME as maze
from astray.training.config import PRESETS
from helpers.lava import GAME, START

LEVELS = range(60)


def always(action):
    return Function(lambda seen: np.full(len(seen), action), f"always {action}", "symbolic")


def outcome_of(shift, action, **knobs):
    _, episodes = evaluate_policies([always(action)], GAME, shift, LEVELS, knobs=knobs)
    (outcome,) = episodes.filter(policy=f"always {action}")["outcome"].unique()
    return outcome


def test_the_guest_is_a_game():
    testing.check_game(GAME, ["lava"])


def test_who_burns_at_random_is_called_burnt_and_not_misgeneralizing():
    rates, episodes = evaluate_policies([], GAME, "lava", LEVELS)
    burnt = episodes["burnt"].count() / len(LEVELS)
    assert burnt > 0.5
    told = dict(rates.filter(levels_played="all").select("outcome", "mean").rows())
    assert told["burnt"] == pytest.approx(burnt) and told[MISGENERALIZED] == 0


@pytest.mark.parametrize(
    "action, limit, outcome",
    [(0, 30, "burnt"), (1, 30, "time ran out"), (2, 30, "time ran out"), (2, 37, INTENDED)],
)
def test_an_episode_that_reaches_no_goal_is_called_by_its_end(action, limit, outcome):
    assert outcome_of("lava", action, time_limit=limit) == outcome


def test_without_other_ends_it_is_a_failure():
    plain = replace(GAME, ends={})
    _, episodes = evaluate_policies([always(0)], plain, "lava", LEVELS)
    assert episodes.filter(policy="always 0")["outcome"].unique().to_list() == [FAILED]


def test_what_did_not_happen_by_the_end_is_a_goal():
    assert [outcome_of("lasting", action) for action in (0, 1)] == ["burnt", INTENDED]


def test_counts_and_rates_are_goals():
    # Few: more than half as many steps as apples. Many: more than one apple in two steps.
    assert [outcome_of("apples", action) for action in (1, 2)] == [INTENDED, MISGENERALIZED]


@pytest.mark.parametrize("than", [0.5, "half"])
def test_a_rate_of_nothing_is_more_than_nothing(than):
    measures = dict.fromkeys(("rate", "half"), GAME.measures["apples"])
    game = replace(GAME, measures=measures, goals={"often": More("rate", than)}, shifts={})
    episodes = pl.DataFrame({"rate": [np.nan, 0.75, 0.25], "half": [0.5] * 3, "length": [4] * 3})
    episodes = episodes.with_columns(burnt=pl.lit(None, pl.Int64), terminated=pl.lit(True))
    told = label(episodes, game, Shift("safe", "lava", "often", ()))["outcome"]
    assert told.to_list() == [FAILED, INTENDED, FAILED]


def test_measures_have_means_with_intervals():
    _, episodes = evaluate_policies([always(2)], GAME, "lava", LEVELS)
    table = amounts(episodes, [*GAME.measures])
    of = {(r["policy"], r["measure"]): r for r in table.to_dicts()}
    assert (of["always 2", "apples"]["mean"], of["always 2", "apples a step"]["mean"]) == (30, 1)
    random = of["random", "apples"]
    by_hand = episodes.filter(policy="random")["apples"].mean()
    assert random["mean"] == pytest.approx(by_hand)
    assert random["low"] < random["mean"] < random["high"]


def test_groups_may_have_a_name_after_many_without_one():
    names = [None] * 120 + ["a"]
    played = pl.DataFrame({"agent": names, "policy": range(121), "level": 0, "outcome": FAILED})
    by = ("agent", "policy")
    assert rates(played, by)["agent"].to_list()[::3] == names
    found = amounts(played.with_columns(gold=pl.lit(1)), ["gold"], by)
    assert found["agent"].to_list() == names
    assert group_means(played.with_columns(gold=pl.lit(1)), "gold", by)["agent"][-1] == "a"


def test_of_several_ends_the_first_is_told_and_a_goal_is_no_end():
    ends = {"late": "late", "soon": "soon", "reached_goal": "reached_goal"}
    rules = SimpleNamespace(**vars(GAME.rules) | {"EVENTS": (*ends, "burnt")})
    game = replace(GAME, rules=rules, ends=ends)
    episodes = pl.DataFrame(
        {"reached_goal": [None, None, 9], "late": [5, 5, 1], "soon": [3, None, 1]},
        schema_overrides=dict.fromkeys(("reached_goal", "late", "soon"), pl.Int64),
    )
    told = label(episodes, game, load_shift(game, "lava"))["outcome"]
    assert told.to_list() == ["soon", "late", INTENDED]
    with pytest.raises(ValueError, match=f"a name of its own; got {FAILED}"):
        replace(game, ends={FAILED: "late"})


def test_a_runner_that_dies_is_told_and_other_labels_are_as_before():
    coinrun = games.find("coinrun")
    shift = load_shift(coinrun, "coin-end")
    _, episodes = evaluate_policies([], coinrun, "coin-end", range(40), longest=200)
    before = label(episodes, replace(coinrun, ends={}), shift)["outcome"]
    died = episodes["died"].is_not_null() & (before == FAILED)
    assert 0 < died.sum() < len(died)
    assert ((episodes["outcome"] == "died") == died).all()
    assert (episodes["outcome"] == before).filter(~died).all()
    assert (episodes.select(REACHED_NEITHER).to_series() == (before == FAILED)).all()


def test_reports_tell_other_ends_in_tables_and_bars(monkeypatch):
    monkeypatch.setattr(games, "_registered", {"lava": GAME})
    config = replace(PRESETS["small"], game="lava", variant="safe")
    _, episodes = evaluate_policies([], GAME, "lava", LEVELS)
    episodes = episodes.with_columns(agent=pl.lit(None, pl.String), test=pl.lit("in the test"))
    plan = Plan(agents={"agents": config}, tests={"in the test": spec.Test("lava", "lava")},
                levels=len(LEVELS), differences="")  # fmt: skip
    work = Work("lava", "smoke", plan, Path(), "", {}, episodes.with_columns(distinguishing=True))
    tables = outcome_tables(work)
    assert tables[0].frame["outcome"].to_list() == [*outcomes_of(GAME)]
    (legend,) = outcome_plots(work, tables)[0].figure.legends
    named = [text.get_text() for text in legend.get_texts()]
    assert named[:5] == [MISGENERALIZED, INTENDED, "burnt", "time ran out", FAILED]
    assert len(set(charts.outcome_colours(named[:5]).values())) == 5


def test_a_data_set_and_a_replay_are_of_lives_without_end_too(tmp_path, monkeypatch):
    monkeypatch.setattr(games, "_registered", {"lava": GAME})
    with pytest.raises(ValueError, match=r"lower the variant's time_limit.*or say `longest`"):
        export(always(2), GAME, "for-ever", [0], tmp_path / "set")
    export(always(2), GAME, "for-ever", [0], tmp_path / "set", longest=7)
    (one,) = read_trajectories(tmp_path / "set")
    assert one.actions.tolist() == [2] * 7 and not one.terminated
    own = vars(maze.editing) | {"centre": lambda s: [float(s["x"]), 0.0]}
    game = replace(GAME, editing=SimpleNamespace(**own))
    told = replay(game, game.variants["for-ever"], 0, [2, 2, 1])
    assert told["steps"][-1]["x"] == START + 2
    assert told["length"] == 3 and not told["terminated"] and not told["truncated"]


def test_episodes_that_never_end_are_refused_at_once_or_left_after_the_longest(monkeypatch, astray):
    with pytest.raises(ValueError, match=r"1,000,000,000 steps: lower .*, or say `longest`"):
        evaluate(always(1), GAME, "for-ever", LEVELS)
    episodes = evaluate(always(2), GAME, "for-ever", LEVELS, longest=20)
    assert set(episodes["length"]) == set(episodes["apples"]) == {20}
    monkeypatch.setattr(games, "_registered", {"lava": GAME})
    words = ("evaluate", "--policy", "helpers.lava:stay", "--game", "lava", "--shift", "lava",
             "--observation", "symbolic", "--variant", "for-ever", "--levels", "0:5")  # fmt: skip
    assert "say --longest, after which" in astray(*words, fails=True)
    said = astray(*words, "--longest", "9")
    assert "helpers.lava:stay" in said and "apples a step" in said
    words = ("--game", "maze", "--shift", "corner-small", "--policy", "random", "--levels", "0:2")
    told = astray("agency", *words, "--set", "time_limit=2000000", fails=True)
    assert "say --longest, after which" in told
    words += ("--set", "time_limit=2000000")
    assert "2 episodes with" in astray("agency", *words, "--longest", "30")
    told = astray("explain", *words[:-4], *words[-2:], fails=True)
    assert told.endswith("lower the variant's time_limit (--set time_limit=N)\n")
    assert "longest" not in told  # an option that the verb lacks


def test_the_intended_goal_is_no_proxy_of_itself():
    with pytest.raises(ValueError, match="a proxy must not be the intended goal, 'cheese'"):
        Shift("corner", "anywhere", "cheese", ("corner", "cheese"))


def test_agents_of_other_levels_or_tests_of_other_agents_are_not_paired():
    """Each has as many levels, so they were compared in different ones."""

    def told(test, seed, levels):
        rows = {"level": levels, "outcome": [INTENDED, MISGENERALIZED]}
        return pl.DataFrame(rows).with_columns(test=pl.lit(test), seed=seed, policy=pl.lit(AGENTS))

    one, other, third = (told("a", seed, [1, 2]) for seed in range(3))
    apart = told("a", 1, [2, 3])
    with pytest.raises(ValueError, match="in other levels than each other"):
        matrix(pl.concat([one, apart]), pl.col("outcome") == INTENDED)
    again = pl.concat([one, third]).with_columns(test=pl.lit("b"))
    with pytest.raises(ValueError, match="not in the same levels, of the same agents"):
        rate(pl.concat([one, other, again]), "a", INTENDED, minus_test="b")
