"""The studies that come as examples run whole, in miniature."""

import json
from dataclasses import replace
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path

import numpy as np
import polars as pl

import astray
from astray.analysis.critic import visit
from astray.experiments import catalogue, run
from helpers.miniature import miniature, train_here

PLANS = Path(__file__).parents[2] / "examples" / "studies" / "maze_plans.py"


def test_the_study_of_plans_in_mazes_runs_in_miniature(tmp_path):
    _, whole = catalogue.find(str(PLANS))
    plan = miniature(whole.sizes["smoke"])
    train_here(plan, tmp_path)
    page = run.reproduce(replace(whole, sizes={"smoke": plan}), "smoke", tmp_path)
    found = json.loads((page.parent / "findings.json").read_text())
    assert [one["ours"].partition("; supported if ")[2][:9] for one in found["claims"]] == [
        "above 0.7", "above 0.7", "above 0; ", "below 0.5",
    ]  # fmt: skip
    table = pl.read_parquet(page.parent / "tables" / "readings.parquet")
    assert table.filter(what="direction of the cheese")["published"].to_list() == [0.85, 0.07]
    assert table["mean"].is_finite().all() and table["agents"].unique().to_list() == [2]


def test_maps_of_plans_are_read_at_the_goals():
    spec = spec_from_file_location("maze_plans", PLANS)
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    agent = astray.load_agent("maze-corner")
    _, states = visit(agent, "anywhere-small", range(20), per_episode=1)
    maps = np.tile(np.arange(49).reshape(7, 7), (20, 1, 1))
    cheese, corner = (module.at(maps, states, goal) for goal in ("cheese", "corner"))
    assert (cheese == 7 * states["goal_y"] + states["goal_x"]).all()
    far = (7 - states["maze_size"]) // 2 + states["maze_size"] - 1
    assert (corner == 8 * far).all() and (corner != cheese).any()
