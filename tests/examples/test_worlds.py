"""The examples of worlds of others, in miniature."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import pytest
import torch

from astray.experiments.run import reproduce
from helpers.foreign import as_cleanrl, reference

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


def test_agents_of_cleanrl_play_coinrun_of_envpool(tmp_path, monkeypatch):
    pytest.importorskip("envpool")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "agents").mkdir()
    torch.save(as_cleanrl(reference((16, 32, 32))[0]), tmp_path / "agents" / "one.cleanrl_model")
    example = loaded("coinrun_envpool")
    env = example.WORLD.variant("easy").make()
    first, again, other = (env.reset(seed=level)[0] for level in (3, 3, 4))
    assert (first == again).all() and (first != other).any()
    plan = replace(example.EXPERIMENT.sizes["smoke"], levels=2)
    page = reproduce(replace(example.EXPERIMENT, sizes={"smoke": plan}), "smoke", tmp_path)
    assert "reaches coin less often than in training" in page.read_text("utf-8")
