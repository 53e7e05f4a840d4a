"""Insight into any torch module, in environments of nobody's: as hooks by hand tell it."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

from astray.acting import steps
from astray.analysis.critic import visit
from astray.analysis.trained import Network
from astray.insight.activations import activations, capture, layers
from astray.insight.attribution import gradients, integrated_gradients, occlusion
from astray.insight.interventions import ablate, patch, steer
from astray.insight.probes import probe, untrained
from helpers.rooms import CELLS, WORLD, Room

HIDDEN, LEVELS = "body.2", range(40)


class Model(nn.Module):
    def __init__(self):
        super().__init__()
        torch.manual_seed(1)
        self.body = nn.Sequential(nn.Flatten(), nn.Linear(2 * CELLS, 12), nn.Tanh())
        self.actor, self.critic = nn.Linear(12, 2), nn.Linear(12, 1)

    def forward(self, seen):
        hidden = self.body(seen)
        return self.actor(hidden), self.critic(hidden)


@pytest.fixture
def model():
    return Network(Model(), Room().observation_space, WORLD)


def square(states):
    return states["observation"][:, 1].argmax(1)


def walked(states):
    return states["walked"]


def test_states_of_a_world_hold_what_was_shown_and_the_measures_of_each_step(model):
    rows, states = visit(model, "anywhere", LEVELS, per_episode=3, measures={"walked": walked})
    env = Room("anywhere")
    for level, there in zip(states["level"].tolist(), square(states), strict=True):
        env.reset(seed=level)
        assert env.square == there
    assert rows["walked"].to_list() == rows["step"].to_list() and rows["walked"].n_unique() > 3
    shown = torch.from_numpy(states["observation"])
    assert np.allclose(rows["value"], model.network(shown)[1][:, 0].detach(), atol=1e-6)


def test_a_measure_of_any_name_is_told_at_each_step(model):
    world = replace(WORLD, measures={"turn": lambda env: env.steps})
    _, states = visit(replace(model, game=world), "anywhere", range(5))
    assert states["turn"].tolist() == states["time"].tolist() and states["turn"].max() > 3


def test_what_layers_give_is_captured(model):
    assert layers(model)[HIDDEN] == (12,) and layers(model)["actor"] == (2,)
    _, states = visit(model, "anywhere", LEVELS, per_episode=2)
    found = capture(model, "anywhere", states, [HIDDEN], measures={"square": square})
    by_hand = model.network.body(torch.from_numpy(states["observation"])).detach()
    assert np.allclose(found.values[HIDDEN], by_hand, atol=1e-6)
    assert found.labels["square"].to_list() == square(states).tolist()


def test_a_layer_is_captured_before_another_module_writes_to_it(model):
    model.network.body.append(nn.ReLU(inplace=True))
    _, states = visit(model, "anywhere", range(3))
    found = capture(model, "anywhere", states, [HIDDEN, "body.3"]).values
    assert found[HIDDEN].min() < 0
    assert (np.maximum(found[HIDDEN], 0) == found["body.3"]).all()


def test_steering_and_ablating_change_what_it_does_as_long_as_they_last(model):
    def rate():
        taken = [step.actions for step in steps(model, WORLD, "anywhere", LEVELS)]
        return np.concatenate(taken).mean()

    before = rate()
    toward = (model.network.actor.weight[1] - model.network.actor.weight[0]).detach().numpy()
    with steer(model, {HIDDEN: toward}, 30.0):
        assert rate() == 1
    with patch(model, HIDDEN, None, 0.0), ablate(model, "actor"):
        assert abs(rate() - 0.5) < 0.1
    assert rate() == before


def test_a_probe_reads_what_is_shown_better_than_shuffled_labels(model):
    _, states = visit(model, "anywhere", range(150), per_episode=4)
    labels = {"right": lambda states: square(states) > CELLS // 2}
    found = probe(model, "anywhere", states, [HIDDEN], labels).to_dicts()
    seen, hidden = found
    assert seen["layer"] == "observation" and seen["score"] > 0.95
    assert hidden["score"] > hidden["shuffled"] + 0.2 and hidden["untrained"] is not None


def test_attribution_adds_up_to_the_value(model):
    pytest.importorskip("captum")
    _, states = visit(model, "anywhere", range(5), per_episode=2)
    shown = states["observation"]
    seen = torch.from_numpy(shown.copy()).requires_grad_()
    model.network(seen)[1].sum().backward()
    assert np.allclose(gradients(model, shown), seen.grad, atol=1e-6)
    nothing = model.network(torch.zeros_like(seen))[1][:, 0].detach()
    rise = (model.network(seen)[1][:, 0] - nothing).detach().numpy()
    assert np.allclose(integrated_gradients(model, shown).sum((1, 2)), rise, atol=1e-3)
    assert occlusion(model, shown).shape == shown.shape


def test_a_layer_that_a_pass_calls_twice_is_refused_with_the_reason(model):
    ask = lambda network, seen: (network(seen)[0], network(seen)[1])  # noqa: E731
    twice = Network(model.network, model.space, WORLD, ask)
    seen = np.zeros((2, *model.space.shape), model.space.dtype)
    with pytest.raises(ValueError, match="of those that a pass calls once; there are: none"):
        activations(twice, seen, [HIDDEN])


@pytest.mark.filterwarnings("ignore:.*weight_norm.* is deprecated:FutureWarning")
@pytest.mark.parametrize("norm", [nn.utils.spectral_norm, nn.utils.weight_norm])
def test_a_network_that_would_keep_trained_weights_is_no_untrained_one(model, norm):
    normed = Network(nn.Sequential(nn.Flatten(), norm(nn.Linear(2 * CELLS, 2))), model.space, WORLD)
    normed.outputs(np.zeros((1, 2, CELLS), np.float32))  # else torch copies no weight_norm
    with pytest.raises(
        ValueError, match=r"module '1' has no reset_parameters\(\) for normed weights"
    ):
        untrained(normed, 0)


def test_what_cannot_be_looked_into_is_told(model):
    _, states = visit(model, "anywhere", range(30), per_episode=2)
    with pytest.raises(ValueError, match="attribution needs values; network returns none"):
        ask = lambda network, seen: network(seen)[0]  # noqa: E731
        gradients(Network(model.network, model.space, WORLD, ask), states["observation"])
    with pytest.raises(ValueError, match=r"states of room must be those that `critic.visit`"):
        capture(model, "anywhere", np.zeros(3, WORLD.state), [HIDDEN])
    model.network.free = nn.ParameterList([nn.Parameter(torch.zeros(2))])
    with pytest.raises(ValueError, match="module 'free' has no reset_parameters"):
        probe(model, "anywhere", states, [HIDDEN], {"right": lambda s: square(s) > 4})
