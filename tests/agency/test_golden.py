"""The agency measure against values that others computed, exact where they can be."""

import json
from fractions import Fraction

import numpy as np
import pytest

from astray.agency import devices
from astray.agency.gridworld import World
from astray.agency.measure import (
    CALIBRATED,
    OTHER,
    PAPER,
    TRUE,
    Episode,
    Options,
    measure,
    measure_named,
)
from astray.agency.online import measure_online
from helpers.cases import REFERENCE

GOLDEN = json.loads((REFERENCE / "agency_golden.json").read_text())
CASES = {case["name"]: case for case in GOLDEN["cases"]}
GOALS = {"S+true": "accessible and true", "S": "accessible"}
NOISE = {"replace": "any action", "other": "other actions"}
CLOSE = dict(rel=0, abs=1e-9)
every_case = pytest.mark.parametrize("case", CASES.values(), ids=CASES)


def cell(world, pair):
    """Row, from the top, and column as x and y."""
    return pair[1], len(world.free) - 1 - pair[0]


def walked(world, steps):
    return world.trajectory([(cell(world, pair), action) for pair, action in steps])


def episode_of(case):
    world = World.parse(case["grid"])
    return Episode(world, walked(world, case["trajectory"]), cell(world, case["g_true"]))


def named(world, goal):
    """A goal as the golden values call it."""
    return goal if isinstance(goal, str) else f"cell{(len(world.free) - 1 - goal[1], goal[0])}"


def log_goal(episode, goal, options=PAPER):
    """log p(trajectory | goal cell)."""
    evidence = measure(episode, options)
    return evidence.log_goals[evidence.goals.index(goal)]


@every_case
def test_mixtures_and_posteriors_are_the_golden_ones(case):
    episode = episode_of(case)
    for result in case["results"]:
        o = result["options"]
        options = Options(
            goals=GOALS[o["goal_set"]],
            noise=NOISE[o["eps_model"]],
            at_goal=o["at_goal"],
            observations=(o["obs"],),
            first=o["t0"],
        )
        evidence = measure(episode, options)
        assert len(evidence.goals) == result["n_goals"]
        assert -evidence.log_agent == pytest.approx(result["neg_log_p_agt"], **CLOSE)
        assert -evidence.log_device == pytest.approx(result["neg_log_p_dev"], **CLOSE)
        assert evidence.agent == pytest.approx(result["posterior_agt"], **CLOSE)
        goals = [named(episode.world, goal) for goal in evidence.goals]
        posterior = dict(zip(goals, evidence.posterior, strict=True))
        for goal, probability in result["top_goals"]:
            assert posterior[TRUE if goal == "g_true" else goal] == pytest.approx(
                probability, **CLOSE
            )


@every_case
def test_the_calibrated_measure_is_the_golden_one(case):
    evidence, golden = measure(episode_of(case), CALIBRATED), case["tool_legal_beta12_mix_noise"]
    assert -evidence.log_agent == pytest.approx(golden["neg_log_p_agt"], **CLOSE)
    assert -evidence.log_device == pytest.approx(golden["neg_log_p_dev"], **CLOSE)
    assert evidence.agent == pytest.approx(golden["posterior_agt"], **CLOSE)
    there = golden["per_class"] | {"noise": golden["neg_log_noise"]}
    assert {k: -v for k, v in evidence.log_devices.items()} == pytest.approx(there, **CLOSE)


@every_case
def test_fractions_tables_and_single_goals_are_exact(case):
    episode = episode_of(case)
    exact = float(Fraction(case["p_agt_given_g_true_exact"]))
    assert np.exp(log_goal(episode, episode.true)) == pytest.approx(exact, rel=1e-12)
    exact = float(Fraction(case["p_dev_type_exact"]))
    assert np.exp(measure(episode, PAPER).log_device) == pytest.approx(exact, rel=1e-12)
    seen = devices.see(episode.world, episode.trajectory, episode.world.number(episode.true))
    rows = sorted(devices.table_of(seen).tolist())
    assert rows == sorted(case["device_table_type"].values())


@every_case
def test_the_online_posterior_and_the_switching_prior_are_the_golden_ones(case):
    growth = measure_online(episode_of(case), PAPER)
    assert growth.agent == pytest.approx(case["online_posterior"], **CLOSE)
    switching = measure_online(episode_of(case), PAPER, switch="1/(t+1)")
    golden = case["neg_log_p_agt_switch_1_over_t_plus_1"]
    assert -switching.log_agent[-1] == pytest.approx(golden, **CLOSE)


def test_pooled_trajectories_are_the_golden_ones():
    golden = GOLDEN["multi"][0]
    world = World.parse(golden["grid"])
    episodes = [
        Episode(world, walked(world, steps), cell(world, true))
        for steps, true in zip(golden["trajectories"], golden["g_true"], strict=True)
    ]
    evidence = measure(episodes, PAPER)
    assert -evidence.log_agent == pytest.approx(golden["pooled_neg_log_p_agt"], **CLOSE)
    assert -evidence.log_device == pytest.approx(golden["pooled_neg_log_p_dev"], **CLOSE)
    for (goal, chance), (name, expected) in zip(
        evidence.likeliest(3), golden["pooled_top_goals"], strict=True
    ):
        assert named(world, goal) == name and chance == pytest.approx(expected, **CLOSE)
    factors = [measure(episode, PAPER).log_factor for episode in episodes]
    assert np.mean(factors) == pytest.approx(golden["mean_log_bf"], **CLOSE)


@pytest.mark.parametrize(
    "options, key",
    [(PAPER, "shared_eps_log_evidence"), (CALIBRATED, "shared_eps_log_evidence_legal_beta12")],
)
def test_named_goals_in_worlds_of_several_shapes_are_the_golden_ones(options, key):
    golden, episodes, goals = GOLDEN["named"], [], []
    for level in golden["levels"]:
        world = World.parse(level["grid"])
        episodes.append(Episode(world, walked(world, level["trajectory"])))
        goals.append({n: [cell(world, one) for one in of] for n, of in level["goals"].items()})
    evidence = measure_named(episodes, goals, options)
    found = dict(zip(evidence.goals, evidence.log_goals, strict=True))
    found["free"] = found.pop(OTHER)
    assert found == pytest.approx(golden[key], **CLOSE)


def test_one_trajectory_pooled_is_that_trajectory():
    episode = episode_of(CASES["maze5_detour"])
    assert measure([episode]).log_goals == pytest.approx(measure(episode).log_goals)
