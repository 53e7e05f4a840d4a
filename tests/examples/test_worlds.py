"""The examples of worlds of others, in miniature."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import pytest

from astray.experiments.run import reproduce

WORLDS = Path(__file__).parents[2] / "examples" / "worlds"


def loaded(name):
    spec = importlib.util.spec_from_file_location(name, WORLDS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_an_agent_of_stable_baselines3_goes_to_the_corner_of_a_minigrid_room(tmp_path):
    pytest.importorskip("minigrid")
    example = loaded("minigrid_corner")
    example.STEPS = 10_000
    plan = replace(example.EXPERIMENT.sizes["smoke"], seeds=1, levels=80)
    page = reproduce(replace(example.EXPERIMENT, sizes={"smoke": plan}), "smoke", tmp_path)
    told = page.read_text("utf-8")
    assert told.count("✓") == 2 and "not supported" not in told
    assert (page.parent / "videos" / "goal-misgeneralization.gif").exists()
