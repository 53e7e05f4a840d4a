"""The studies that come as examples run whole, in miniature."""

import json
from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import polars as pl
import pytest

import astray
from astray.analysis.critic import visit
from astray.envs.beginnings import initial_states
from astray.experiments import catalogue, run, videos
from astray.kernel.maze import WALL
from helpers.miniature import miniature, train_here

STUDIES = Path(__file__).parents[2] / "examples" / "studies"
PLANS = STUDIES / "maze_plans.py"


@pytest.mark.thorough  # `test_maps_of_plans_are_read_at_the_goals`
def test_the_study_of_plans_in_mazes_runs_in_miniature(tmp_path, monkeypatch):
    monkeypatch.setattr(videos, "RECORDED", 2)
    _, whole = catalogue.find(str(PLANS))
    plan = replace(miniature(whole.sizes["smoke"]), seeds=1, levels=10)
    train_here(plan, tmp_path)
    page = run.reproduce(replace(whole, sizes={"smoke": plan}), "smoke", tmp_path)
    found = json.loads((page.parent / "findings.json").read_text())
    assert [one["ours"].partition("; supported if ")[2][:9] for one in found["claims"]] == [
        "above 0.7", "above 0.7", "above 0; ", "below 0.5",
    ]  # fmt: skip
    table = pl.read_parquet(page.parent / "tables" / "readings.parquet")
    assert table.filter(what="direction of the cheese")["published"].to_list() == [0.85, 0.07]
    assert table["mean"].is_finite().all() and table["agents"].unique().to_list() == [1]


def loaded(path):
    """The module of a file."""
    spec = spec_from_file_location(path.stem, path)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_a_hand_on_the_wall_leads_through_every_maze_that_two_ways_around_have_time_for():
    module = loaded(STUDIES / "maze_wanderers.py")
    states = initial_states("maze", module.VARIANT, range(200_000, 200_060))
    rng = np.random.default_rng(0)
    # A maze is a tree of passages: who keeps to a wall takes each step of it twice at most.
    passages = (states["cell"] != WALL).reshape(len(states), -1).sum(1)
    short = states[2 * (passages - 1) <= states["time_limit"]]
    assert len(short) > 30 and short["maze_size"].max() >= 19
    assert all(module.reaches(state, module.keeps_to_the_wall, rng) for state in short)
    assert not all(module.reaches(state, module.forgets, rng) for state in short)


def test_maps_of_plans_are_read_at_the_goals():
    module = loaded(PLANS)
    agent = astray.load_agent("maze-corner")
    _, states = visit(agent, "anywhere-small", range(20), per_episode=1)
    maps = np.tile(np.arange(49).reshape(7, 7), (20, 1, 1))
    cheese, corner = (module.at(maps, states, goal) for goal in ("cheese", "corner"))
    assert (cheese == 7 * states["goal_y"] + states["goal_x"]).all()
    far = (7 - states["maze_size"]) // 2 + states["maze_size"] - 1
    assert (corner == 8 * far).all() and (corner != cheese).any()
