"""The examples of worlds of others, in miniature."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.wrappers import TimeLimit

import astray
from astray.analysis.policies import Random
from astray.experiments import outcomes, videos
from astray.experiments.run import reproduce
from helpers.foreign import as_cleanrl, procgen_of_envpool, reference

WORLDS = Path(__file__).parents[2] / "examples" / "worlds"


def loaded(name):
    spec = importlib.util.spec_from_file_location(name, WORLDS / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.thorough  # `test_the_page_on_worlds_runs_as_it_stands_with_fewer_steps`
@pytest.mark.parametrize("name, steps", [("minigrid_corner", 10_000), ("minigrid_door", 15_000)])
def test_an_agent_of_stable_baselines3_pursues_the_proxy_in_minigrid(
    name, steps, tmp_path, monkeypatch
):
    pytest.importorskip("minigrid")
    example = loaded(name)
    example.STEPS = steps
    monkeypatch.setattr(videos, "RECORDED", 2)
    plan = replace(example.EXPERIMENT.sizes["smoke"], seeds=1, levels=80)
    page = reproduce(replace(example.EXPERIMENT, sizes={"smoke": plan}), "smoke", tmp_path)
    told = page.read_text("utf-8")
    assert told.count("✓") == 2 and "not supported" not in told
    assert (page.parent / "videos" / "goal-misgeneralization.gif").exists()


@pytest.mark.usefixtures("undrawn")
def test_agents_of_cleanrl_play_coinrun_of_envpool(tmp_path, monkeypatch):
    procgen_of_envpool()
    monkeypatch.chdir(tmp_path)
    (tmp_path / "agents").mkdir()
    torch.save(as_cleanrl(reference((16, 32, 32))[0]), tmp_path / "agents" / "one.cleanrl_model")
    example = loaded("coinrun_envpool")
    env = example.WORLD.variant("easy").make()
    first, again, other = (env.reset(seed=level)[0] for level in (3, 3, 4))
    assert (first == again).all() and (first != other).any()
    short = {
        name: lambda make=make, **knobs: TimeLimit(make(**knobs), 12)
        for name, make in example.WORLD.variants.items()
    }
    world = replace(example.WORLD, variants=short)
    plan = replace(example.EXPERIMENT.sizes["smoke"], levels=2, world=world)
    page = reproduce(replace(example.EXPERIMENT, sizes={"smoke": plan}), "smoke", tmp_path)
    assert "reaches “coin” less often than in training" in page.read_text("utf-8")


class Stream(gymnasium.Env):
    """CoinRun of EnvPool, whose pool chooses its levels and tells their numbers."""

    observation_space = gymnasium.spaces.Box(0, 255, (64, 64, 3), np.uint8)
    action_space = gymnasium.spaces.Discrete(15)

    def __init__(self, stream, task="CoinrunEasy-v0"):
        self.pool = procgen_of_envpool(task, seed=stream, channel_first=False)

    def reset(self, *, seed=None, options=None):
        (seen,), info = self.pool.reset()
        return seen, {"level_seed": info["level_seed"][0], "complete": False}

    def step(self, action):
        (seen,), (reward,), (ended,), (cut,), info = self.pool.step(np.array([action], np.int32))
        return seen, reward, ended, cut, {"complete": ended and info["prev_level_complete"][0] > 0}


@pytest.mark.usefixtures("undrawn")
def test_streams_of_envpool_tell_their_levels_and_are_audited(tmp_path):
    first = [int(procgen_of_envpool(seed=k).reset()[1]["level_seed"][0]) for k in range(2)]
    world = astray.World(
        name="streams",
        variants={
            name: lambda stream, task=task: TimeLimit(Stream(stream, task), 12)
            for name, task in (("easy", "CoinrunEasy-v0"), ("hard", "CoinrunHard-v0"))
        },
        events={"complete": "complete"},
        goals={"coin": "complete"},
        shifts={"hard": astray.Shift("easy", "hard", intended="coin", proxies=())},
        level_key="level_seed",
        repeats=False,
    )
    page = astray.audit(Random(), world, "hard", levels=4, out=tmp_path)
    assert outcomes.STREAMS in page.read_text("utf-8")
    with pytest.raises(ValueError, match="has no ghosts"):
        astray.audit(Random(), world, "hard", ghost="easy", levels=4, out=tmp_path)
    table = astray.evaluate(Random(), world, "easy", range(4), batch=2, longest=5)
    assert table["level"].to_list()[:2] == first and table["level"].n_unique() == 4
    assert table["length"].to_list() == [5] * 4
