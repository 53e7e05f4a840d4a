"""A World is taken and refused as the table in docs/worlds.md says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import nn

from astray.acting import initial_states
from astray.analysis.critic import visit
from astray.analysis.overlap import overlap
from astray.analysis.replay import replay
from astray.analysis.trained import Network
from astray.envs.vector import GameVectorEnv
from astray.insight.activations import capture
from astray.insight.attribution import gradients
from astray.insight.behaviour import level_features
from astray.insight.episode import along
from astray.insight.fields import fields
from astray.insight.interventions import ablate
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


def test_a_network_is_looked_into_in_a_world(network):
    rows, states = visit(network, "anywhere", range(3))
    seen = states["observation"]
    assert len(rows) == len(states) and gradients(network, seen).shape == seen.shape
    assert capture(network, "anywhere", states, ["1"]).values["1"].shape == (len(states), 2)
    with ablate(network, "1", None):
        assert not network.outputs(seen)[0].any()


def test_states_of_levels_are_of_games():
    with pytest.raises(ValueError, match="must be a Game"):
        initial_states(replace(WORLD, name="other"), "end", np.arange(2))
