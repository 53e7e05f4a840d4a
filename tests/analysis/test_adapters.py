"""Policies of others that are no files: callables, and models of Stable-Baselines3."""

import gymnasium
import numpy as np
import polars as pl
import pytest
from torch import nn

from astray import games
from astray.acting import steps
from astray.analysis.adapters import Function, from_sb3
from astray.analysis.evaluate import evaluate
from astray.analysis.outcomes import label, load_shift
from astray.analysis.trained import Network


class Predictor:
    """As a model of Stable-Baselines3: draws, or always goes right."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        random = np.random.default_rng(0).integers(15, size=len(observation))
        return np.full(len(observation), 7) if deterministic else random, None


def test_a_callable_and_a_model_are_evaluated_as_policies():
    right = Function(lambda seen: np.full(len(seen), 7), "right", "symbolic")
    (one, two, three) = (
        evaluate(policy, "maze", "corner-small", range(20))
        for policy in (right, from_sb3(Predictor(), greedy=True), from_sb3(Predictor()))
    )
    assert set(one["policy"]) == {"right"} and set(two["policy"]) == {"sb3"}
    assert one.drop("policy").equals(two.drop("policy"))
    assert not one.drop("policy").equals(three.drop("policy"))
    table = label(one, games.find("maze"), load_shift(games.find("maze"), "corner-small"))
    assert len(table.filter(pl.col("outcome").is_not_null())) == 20


def test_a_model_that_is_shown_what_it_does_not_know_is_told_the_remedy():
    def refuse(*_, **how):
        raise ValueError("unexpected observation shape")

    model = Predictor()
    model.predict = refuse
    with pytest.raises(ValueError, match=r"shape from_sb3 takes .*'symbolic'.*; got 'image'"):
        evaluate(from_sb3(model), "maze", "corner-small", range(2))


@pytest.mark.parametrize("kind", ["model", "network"])
def test_who_learned_from_images_of_0_to_1_is_not_shown_those_of_0_to_255(kind):
    space = gymnasium.spaces.Box(0, 1, (64, 64, 3))
    model = Predictor()
    model.observation_space = space
    network = nn.Sequential(nn.Flatten(), nn.Linear(64 * 64 * 3, 15))
    policy = {
        "model": from_sb3(model),
        "network": Network(network, space, ask=lambda network, seen: network(seen.float())),
    }[kind]
    with pytest.raises(ValueError, match=r"sees numbers up to 1, .* shows uint8 up to 25"):
        evaluate(policy, "maze", "corner-small", range(2))


class Recurrent:
    """As a recurrent model of sb3-contrib: a state [layers, environments, numbers]."""

    def predict(self, observation, state=None, episode_start=None, deterministic=False):
        n = len(observation)
        (steps,) = (np.zeros((2, n, 1)),) if state is None else state
        begins = np.zeros(n, bool) if episode_start is None else episode_start
        steps = np.where(begins[None, :, None], 0, steps) + np.array([[[1]], [[2]]])
        return steps.sum((0, 2)).astype(int) % 15, (steps,)


@pytest.mark.parametrize("batch", [1, 3, 256])
def test_a_recurrent_model_remembers_its_episode_and_no_other(batch):
    model = from_sb3(Recurrent(), observation="symbolic")
    for step in steps(model, "maze", "anywhere-small", range(12), batch=batch):
        assert (step.actions == 3 * step.after["time"] % 15).all()


@pytest.mark.parametrize(
    "chosen, said",
    [
        (np.zeros(3, int), r"must return integers \[2\].*got int64 of shape \(3,\)"),
        (np.zeros(2), r"must return integers \[2\].*got float64"),
        (np.array([0, 15]), "must be from 0 to 14; got 0 to 15"),
        (np.array([-1, 3]), "must be from 0 to 14; got -1 to 3"),
    ],
)
def test_actions_that_are_none_are_refused(chosen, said):
    policy = Function(lambda seen: chosen, observation="symbolic")
    with pytest.raises(ValueError, match=said):
        evaluate(policy, "maze", "corner-small", range(2))


def test_a_model_of_stable_baselines3_is_evaluated():
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    from astray.envs.sb3 import GameVecEnv
    from astray.envs.vector import GameVectorEnv

    env = GameVectorEnv("maze", "corner-small", 4, autoreset_mode="SameStep")
    model = stable_baselines3.PPO("CnnPolicy", GameVecEnv(env), seed=0, device="cpu", n_steps=16)
    episodes = evaluate(from_sb3(model), "maze", "corner-small", range(3))
    assert len(episodes) == 3 and (episodes["length"] > 0).all()
    env.close()
