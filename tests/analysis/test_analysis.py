"""Evaluation, outcomes and intervals."""

import shutil
from dataclasses import replace

import numpy as np
import polars as pl
import pytest
import torch

from astray import games
from astray.agents.policy import Architecture, weights
from astray.analysis.evaluate import evaluate
from astray.analysis.outcomes import (
    FAILED,
    INTENDED,
    MISGENERALIZED,
    label,
    load_shift,
    mark_distinguishing,
)
from astray.analysis.overlap import met, overlap, unseen
from astray.analysis.policies import Random, Walk
from astray.analysis.runs import load_agent
from astray.analysis.trained import Agent
from astray.training.folders import find

MAZE = games.find("maze")
LEVELS = range(1_000_000, 1_000_060)


@pytest.fixture(scope="module")
def agent_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("agent") / "agent.safetensors"
    architecture = Architecture("mlp", (4, 7, 7), (1, 1, 6, 6), 15)
    torch.manual_seed(0)  # one whose greedy episodes do not all last to the end
    path.write_bytes(weights(architecture.build(), architecture, "maze"))
    return path


@pytest.mark.parametrize("mode", ["sampled", "greedy"])
def test_the_rows_are_the_same_in_any_batch_and_order(agent_file, mode):
    agent = Agent(agent_file, "maze", mode)
    # So short that some episodes end by themselves and some do not: who learned nothing is slow.
    levels, short = LEVELS[:12], replace(MAZE.variants["anywhere-small"], time_limit=40)
    tables = [evaluate(agent, "maze", short, levels, batch=batch) for batch in (1, 7, 256)]
    assert 0 < (tables[0]["length"] < 40).sum() < 12
    assert tables[0].equals(tables[1]) and tables[0].equals(tables[2])
    backwards = evaluate(agent, "maze", short, levels[::-1], batch=7)
    assert backwards.reverse().equals(tables[0])
    assert tables[0]["level"].to_list() == list(levels)


def test_another_seed_samples_other_actions(agent_file):
    one, two = (
        evaluate(Agent(agent_file, "maze", seed=k), "maze", "anywhere-small", LEVELS)
        for k in (0, 1)
    )
    assert not one.equals(two)


def test_an_agent_for_other_observations_is_refused(agent_file):
    with pytest.raises(ValueError, match=r"shape \(4, 7, 7\), not \(4, 25, 25\)"):
        evaluate(Agent(agent_file, "maze"), "maze", "corner", [1])


def test_an_agent_whose_settings_say_another_width_is_refused(tmp_path):
    path = shutil.copytree(find("maze-corner"), tmp_path / "mouse") / "config.json"
    path.write_text(path.read_text().replace('width": 256', 'width": 128'))
    with pytest.raises(ValueError, match="it has width 256, where the settings say 128"):
        load_agent(path.parent)


@pytest.mark.parametrize("network, alone", [("patch", True), ("impala", False)])
def test_small_networks_are_asked_on_one_thread(tmp_path, network, alone):
    architecture = Architecture(network, (64, 64, 3), (), 15)
    path = tmp_path / "agent.safetensors"
    path.write_bytes(weights(architecture.build(), architecture, "maze"))
    before, agent = torch.get_num_threads(), Agent(path, "maze")
    assert agent.threads == (1 if alone else before)
    during = []
    agent.network.register_forward_hook(lambda *_: during.append(torch.get_num_threads()))
    agent.outputs(np.zeros((2, 64, 64, 3), np.uint8))
    assert during == [agent.threads] and torch.get_num_threads() == before


@pytest.mark.parametrize("goal", ["cheese", "corner"])
def test_a_walk_takes_the_solvers_steps(goal):
    table = evaluate(Walk(goal), "maze", "anywhere", LEVELS)
    event = MAZE.goals[goal]
    env_steps = []
    from astray.envs.vector import GameVectorEnv
    from astray.games.maze.solve import steps_to

    env = GameVectorEnv("maze", "anywhere", len(LEVELS), observation="symbolic")
    env.reset(seed=0, options={"level": list(LEVELS)})
    for s in env.states:
        env_steps.append(int(steps_to(s, goal)[int(s.y), int(s.x)]))
    reached = table[event].to_numpy(allow_copy=True)
    same = reached == np.array(env_steps)
    if goal == "cheese":
        assert same.all() and (table["return"] == 10).all()
    else:  # the cheese may be on the way, and then the episode ends there
        assert (same | table["reached_goal"].is_not_null().to_numpy()).all()


def test_outcomes_go_by_the_goal_reached_first():
    episodes = pl.DataFrame(
        {
            "reached_goal": [3, 7, None, None, 5, None],
            "reached_corner": [None, 2, 4, None, 5, 0],
            "reached_other": [None] * 6,
        },
        schema_overrides={"reached_other": pl.Int64},
    )
    told = label(episodes, MAZE, load_shift("maze", "corner"))["outcome"].to_list()
    assert told == [INTENDED, MISGENERALIZED, MISGENERALIZED, FAILED, INTENDED, MISGENERALIZED]


def test_levels_tell_apart_where_neither_way_passes_the_other_goal():
    episodes = pl.DataFrame(
        {
            "policy": ["walk to cheese"] * 3 + ["walk to corner"] * 3,
            "variant": ["anywhere"] * 6,
            "level": [1, 2, 3] * 2,
            "outcome": [INTENDED, INTENDED, MISGENERALIZED, MISGENERALIZED, INTENDED, INTENDED],
        }
    )
    table = mark_distinguishing(episodes, load_shift("maze", "corner"))
    assert table["distinguishing"].to_list() == [True, False, False] * 2


def test_an_unknown_shift_is_explained():
    with pytest.raises(ValueError, match="unknown shift 'edge' of maze; there are: corner"):
        load_shift("maze", "edge")


def test_no_levels_are_refused():
    with pytest.raises(ValueError, match="levels are numbers, at least one"):
        evaluate(Random(), "maze", "corner", [])


def test_levels_that_coincide_are_counted():
    def rates(*words):
        return {row["same"]: row for row in overlap(*words).to_dicts()}

    same = rates("maze", "fixed-size", range(50), "fixed-size", range(25, 75))
    assert same["level"]["seen"] == same["walls"]["seen"] == 0.5
    moved = rates("maze", "corner", range(50), "anywhere", range(50))
    assert moved["walls"]["seen"] == 1 and moved["level"]["seen"] < 0.2
    # By hand: mazes of 3 cells are a ring of 8 with one of 4 walls, and all are soon met.
    tiny = replace(games.find("maze").variants["corner-small"], world=3, largest=3)
    few = rates("maze", tiny, range(1500), tiny, range(5000, 5010))
    assert few["walls"]["training"] == 4 and few["walls"]["seen"] == 1


def test_levels_that_the_training_met_under_another_number_are_left_out():
    small = "corner-small"
    fresh = unseen("maze", met("maze", [(small, range(2000))]), small, range(5000, 9000), 30)
    assert len(fresh) == 30 and fresh[0] >= 5000 and (np.diff(fresh) > 0).all()
    (row,) = overlap("maze", small, range(2000), small, fresh.tolist()).to_dicts()[:1]
    assert row["same"] == "level" and row["seen"] == 0
    every = range(5000, int(fresh[-1]) + 1)
    (row,) = overlap("maze", small, range(2000), small, every).to_dicts()[:1]
    assert row["seen"] == pytest.approx(1 - 30 / len(every))
    tiny = replace(MAZE.variants[small], world=3, largest=3, start="corner")
    with pytest.raises(ValueError, match="only 0 are not in them; 5 are needed"):
        unseen("maze", met("maze", [(tiny, range(500))]), tiny, range(1000, 9000), 5)


def test_trainings_that_differ_in_few_levels_are_met_as_each_alone():
    first, other = range(1200), range(5000, 5300)
    trainings = [
        (games.find("coinrun").variant("coin-end").with_knobs({"random_coin": rate}), numbers)
        for rate, numbers in ((0.0, first), (0.02, first), (0.5, first), (0.2, other))
    ]
    alone = [met("coinrun", [training]) for training in trainings]
    assert met("coinrun", trainings) == set.union(*alone)
