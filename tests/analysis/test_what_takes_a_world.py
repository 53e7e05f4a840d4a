"""A World is taken and refused as the table in docs/worlds.md says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from astray.acting import initial_states
from astray.analysis.adapters import from_sb3
from astray.analysis.critic import counterfactual, sees, visit
from astray.analysis.overlap import overlap
from astray.analysis.replay import replay
from astray.analysis.trained import Network
from astray.envs.vector import GameVectorEnv
from astray.insight.activations import capture
from astray.insight.attribution import gradients, integrated_gradients
from astray.insight.behaviour import level_features
from astray.insight.episode import along
from astray.insight.fields import fields
from astray.insight.interventions import ablate, patch, steer
from astray.insight.probes import probe
from astray.lab.serving import make_lab
from helpers.rooms import CELLS, WORLD, Room


def both(network, seen):
    logits = network(seen.float())
    return logits, logits.sum(1)


@pytest.fixture(scope="module")
def network():
    torch.manual_seed(0)
    body = nn.Sequential(nn.Flatten(), nn.Linear(2 * CELLS, 2))
    return Network(body, Room().observation_space, WORLD, ask=both)


REFUSES = {
    "insight.fields": lambda network: fields(network, "end", [1]),
    "insight.episode": lambda network: along(network, "end", 1),
    "insight.behaviour": lambda network: level_features(WORLD, "end", [1]),
    "lab.serving.make_lab": lambda network: make_lab(network, {"game": WORLD}),
    "analysis.overlap": lambda network: overlap(WORLD, "end", "anywhere", range(1), range(1)),
    "analysis.replay": lambda network: replay(WORLD, "end", 1, [0]),
    "GameVectorEnv": lambda network: GameVectorEnv(WORLD, "end", 1),
}


@pytest.mark.parametrize("name", REFUSES)
def test_what_needs_states_refuses_a_world_in_a_sentence(name, network):
    table = (Path(__file__).parents[2] / "docs" / "worlds.md").read_text()
    (row,) = [line for line in table.splitlines() if f"`{name}`" in line and line[0] == "|"]
    assert "| no: " in row
    with pytest.raises(ValueError, match=r"must be a Game or its name; got World.*worlds\.md says"):
        REFUSES[name](network)


def test_endless_episodes_of_a_world_are_visited_for_some_steps(network):
    rows, states = visit(network, "end", range(3), longest=2)
    whole, _ = visit(network, "end", range(3))
    assert rows.equals(whole.filter(whole["step"] < 2)) and rows.height < whole.height
    assert len(states) == len(rows)


def test_a_network_is_looked_into_in_a_world(network):
    rows, states = visit(network, "anywhere", range(3))
    seen = states["observation"]
    assert len(rows) == len(states) and gradients(network, seen).shape == seen.shape
    assert capture(network, "anywhere", states, ["1"]).values["1"].shape == (len(states), 2)
    with ablate(network, "1", None):
        assert not network.outputs(seen)[0].any()

    def emptied(states):
        states["observation"][1:] = 0
        return states

    pairs = counterfactual(network, "anywhere", states, emptied)
    assert pairs["seen"].to_list() == [k > 0 and np.any(one) for k, one in enumerate(seen)]
    assert pairs["value_edited"][1] == float(network.outputs(0 * seen[:1])[1])
    assert sees(network, "anywhere", emptied)(states).tolist() == pairs["seen"].to_list()


def test_a_model_of_stable_baselines3_is_changed_and_read_in_a_world():
    sb3 = pytest.importorskip("stable_baselines3")
    model = sb3.PPO("MlpPolicy", Room(), seed=0, device="cpu")
    agent, layer = from_sb3(model).network, "mlp_extractor.policy_net.1"
    agent = replace(agent, game=WORLD)
    states = visit(agent, "anywhere", range(80), per_episode=3)[1]
    seen, net = states["observation"], model.policy
    values = capture(agent, "anywhere", states, [layer]).values[layer]

    def logits(changed):
        with torch.no_grad():
            hidden = net.mlp_extractor.policy_net[2:](torch.as_tensor(changed))
            return net.action_net(hidden).log_softmax(1)

    with steer(agent, {layer: np.ones(64, np.float32)}, 2.0):
        assert torch.allclose(agent.outputs(seen)[0], logits(values + 2), atol=1e-5)
    with patch(agent, layer, [5], 9.0):
        values[:, 5] = 9
        assert torch.allclose(agent.outputs(seen)[0], logits(values), atol=1e-5)
    right = {"right": lambda states: states["observation"][:, 0, CELLS // 2 :].any(1)}
    assert (probe(agent, "anywhere", states, [layer], right, folds=2)["score"] > 0.8).all()
    assert np.isfinite(integrated_gradients(agent, seen, steps=4)).all()


def test_states_of_levels_are_of_games():
    with pytest.raises(ValueError, match="must be a Game"):
        initial_states(replace(WORLD, name="other"), "end", np.arange(2))
