"""Insight into agents with memory: states as layers, along episodes; ticks; maps of probes."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import torch

import astray
from astray.analysis.critic import observe, policy_and_value, visit
from astray.analysis.trained import Opaque
from astray.insight import cell_probes
from astray.insight.activations import activations, capture, layers
from astray.insight.explain import default_layers
from astray.insight.fields import fields, states_at
from astray.insight.interventions import ablate, changed, interchange, steer, thinking
from astray.insight.probes import probe
from astray.training.loop import train
from helpers.thorough import thorough
from helpers.trainings import TINY

SMALL = TINY.variant_for("anywhere-small")
NETWORKS = ("mlp+gru", "mlp+lstm", "drc-1-2")
STATE = {"mlp+gru": "recalled", "mlp+lstm": "recalled", "drc-1-2": "tick2"}


@pytest.fixture(scope="module", params=[*thorough(NETWORKS[0]), *NETWORKS[1:]])
def agent(request, made):
    return made(request.param)


@pytest.fixture(scope="module")
def mouse(made):
    return made("mlp+gru")


@pytest.fixture(scope="module")
def planner(made):
    return made("drc-1-2")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Function that makes an agent of each network once."""
    return functools.cache(lambda network: make(network, tmp_path_factory.mktemp("agent")))


def make(network, folder):
    train(replace(TINY, network=network, steps=256, validation=None), folder, progress=False)
    agent = astray.load_agent(folder)
    with torch.no_grad():  # from near uniform
        for name, weight in agent.network.named_parameters():
            weight.mul_(30 if name.endswith("policy.weight") else 1)
    return agent


@pytest.fixture(scope="module")
def states(planner):
    """States of whole episodes."""
    return visit(planner, SMALL, range(200_000, 200_030))[1]


def test_the_state_is_a_layer_and_holds_what_the_agent_saw_before(agent, states):
    layer = STATE[agent.architecture.name]
    assert layer in layers(agent)
    along = capture(agent, SMALL, states, [layer], episodes=True).values[layer]
    alone = capture(agent, SMALL, states, [layer]).values[layer]
    first = states["time"] == 0
    assert np.allclose(along[first], alone[first], atol=1e-6)
    assert abs(along[~first] - alone[~first]).max() > 1e-3
    seen, last = observe(agent, SMALL, states), int(np.flatnonzero(first)[1])
    net, state = agent.network, torch.zeros(1, agent.network.memory)
    for t in range(last):
        shown = torch.from_numpy(seen[t : t + 1])
        with torch.no_grad():
            *_, state = net.recall(shown, state, torch.tensor([t == 0]))
        hidden = state[0].numpy()
        where = along[t].ravel()
        assert np.allclose(hidden[: len(where)], where, atol=1e-5)


def test_a_steered_state_lasts_along_an_episode(agent, states):
    layer, seen = STATE[agent.architecture.name], observe(agent, SMALL, states[:4])
    calls = []

    def once(x):
        calls.append(len(x))
        return x + 1 if len(calls) == 1 else x

    before = policy_and_value(agent, seen, episode=True)[1]
    with changed(agent, {layer: once}):
        after = policy_and_value(agent, seen, episode=True)[1]
    assert len(calls) == 4 and (abs(after - before) > 1e-6).all()
    with steer(agent, {layer: np.array(0.0)}):
        assert (policy_and_value(agent, seen, episode=True)[1] == before).all()


def test_values_along_episodes_are_of_what_the_agent_remembers(agent):
    rows, states = visit(agent, SMALL, range(200_000, 200_003), batch=2)
    some, _ = visit(agent, SMALL, range(200_000, 200_003), per_episode=3)
    episodes = np.split(observe(agent, SMALL, states), np.flatnonzero(states["time"] == 0)[1:])
    slow = [policy_and_value(agent, shown, episode=True)[1] for shown in episodes]
    assert np.array_equal(rows["value"], np.concatenate(slow))
    assert not np.allclose(rows["value"], policy_and_value(agent, observe(agent, SMALL, states))[1])
    both = some.join(rows, on=["level", "step"], validate="1:1")
    assert len(both) == len(some) and both["value"].equals(both["value_right"].alias("value"))


def test_a_page_reads_layers_up_to_the_heads(agent):
    assert default_layers(agent, 3)[-1] == {"drc-1-2": "features"}.get(
        agent.architecture.name, "recalled"
    )


@pytest.mark.parametrize("layer", ["body.policy", "body.value"])
def test_heads_along_an_episode_are_layers_with_a_row_per_step(mouse, states, layer):
    along = capture(mouse, SMALL, states, [layer], episodes=True).values[layer]
    assert along.shape == (len(states), *layers(mouse)[layer])
    shown = observe(mouse, SMALL, states[: np.flatnonzero(states["time"] == 0)[1]])
    with ablate(mouse, "body.policy", [3]):
        logits, _ = mouse.outputs(shown, episode=True)
    plain, _ = mouse.outputs(shown, episode=True)
    assert (logits[:, 3] == 0).all() and torch.equal(logits[:, :3], plain[:, :3])


def test_states_that_are_not_whole_episodes_are_refused(planner, states):
    for some in (states[1:], states[::2], states[:0]):
        with pytest.raises(ValueError, match="must be those of whole episodes"):
            capture(planner, SMALL, some, ["tick1"], episodes=True)


def test_probes_along_episodes_read_what_the_agent_remembers(mouse, states):
    labels = {"high": lambda some: some["y"] > 2}
    tables = [
        probe(mouse, SMALL, states, ["recalled"], labels, folds=2, episodes=along)
        for along in (True, False)
    ]
    scores = [dict(table.select("layer", "score").rows()) for table in tables]
    assert scores[0]["recalled"] != scores[1]["recalled"]
    assert scores[0]["observation"] == scores[1]["observation"]


def test_a_layer_of_another_state_that_all_passes_through_gives_its_answer(agent, states):
    layer, n = STATE[agent.architecture.name], 70
    here, others = states[:n], states[n : 2 * n]
    policy, value = policy_and_value(agent, observe(agent, SMALL, here))
    there = policy_and_value(agent, observe(agent, SMALL, others))
    if layer == "recalled":
        for got, wanted in zip(interchange(agent, SMALL, here, others, layer), there, strict=True):
            assert np.allclose(got, wanted, atol=1e-5)
    got = interchange(agent, SMALL, here, others, layer, channels=[0])
    assert not np.allclose(got[1], value) and not np.allclose(got[1], there[1])
    same = interchange(agent, SMALL, here, here, layer)
    assert np.allclose(same[0], policy, atol=1e-6)
    with pytest.raises(ValueError, match="another state for each"):
        interchange(agent, SMALL, here, others[:5], layer)


def test_fields_after_fewer_ticks_are_those_of_a_network_that_ticks_less(planner):
    found = {}
    for ticks in (1, 2):
        with thinking(planner, ticks):
            (found[ticks],) = fields(planner, SMALL, [5])
    (whole,) = fields(planner, SMALL, [5])
    assert (found[2].policy == whole.policy).all() and planner.network.repeats == 2
    assert abs(found[1].policy - whole.policy).max() > 1e-4
    with (
        pytest.raises(ValueError, match="ticks must be an integer from 1 to 2"),
        thinking(planner, 3),
    ):
        pass
    with pytest.raises(ValueError, match="the network that ticks must be a DRC"):
        thinking(astray.load_agent("maze-corner"), 1).__enter__()


def test_an_agent_that_is_led_to_a_place_remembers_the_way(agent):
    (led,), (alone,) = (fields(agent, SMALL, [5], led=led) for led in (True, False))
    number, net = led.places.number, agent.network
    start = number[led.level.agent]
    assert np.allclose(led.policy[start], alone.policy[start], atol=1e-6)
    far = max(number, key=lambda cell: len(led.places.way(cell)))
    way, state = led.places.way(far), torch.zeros(1, net.memory)
    assert len(way) > 3
    for k, s in enumerate(states_at(led.level, way)):
        seen = torch.from_numpy(observe(agent, SMALL, np.array([s])))
        with torch.no_grad():
            logits, value, state = net.recall(seen, state, torch.tensor([k == 0]))
    assert np.allclose(led.policy[number[far]], logits.softmax(-1)[0], atol=1e-5)
    assert np.allclose(led.value[number[far]], value, atol=1e-5)
    assert abs(led.value - alone.value).max() > 1e-4


def test_a_function_that_is_led_to_a_place_remembers_the_way():
    def aging(seen, memory, begins):  # its action is the number of steps so far
        age = np.where(begins, 0, 0 if memory is None else memory + 1)
        return np.minimum(age, 14), age

    policy = astray.Function(aging, observation="symbolic", remembers=True)
    (led,) = fields(Opaque(policy, "maze"), SMALL, [5], led=True)
    for cell, k in led.places.number.items():
        assert led.policy[k].argmax() == min(max(len(led.places.way(cell)) - 1, 0), 14)
    (alone,) = fields(Opaque(policy, "maze"), SMALL, [5])
    assert (alone.policy[:, 0] == 1).all() and led.policy[:, 0].mean() < 0.5


def test_the_cells_ahead_are_those_of_the_rest_of_the_episode(states):
    found = cell_probes.ahead(states, 5)
    for t in range(0, 60):
        rest = [s for s in states[t:] if s["level"] == states["level"][t]]
        cells = [(int(s["x"]), int(s["y"])) for s in rest]
        later = {b for k, b in enumerate(cells[1:]) if b != cells[k]}
        assert {(x, y) for y, x in np.argwhere(found[t]).tolist()} == later


def test_a_map_reads_each_cell_by_the_same_weights():
    random = np.random.default_rng(0)
    x = random.normal(size=(80, 6, 5, 5)).astype(np.float32)
    truth, levels = x[:, 2] - x[:, 4] > 0.3, np.arange(80) // 2
    found = cell_probes.fit(x[:40], truth[:40], levels[:40])
    assert found.score(x[40:], truth[40:], levels[40:]).mean > 0.95
    moved = np.roll(x, (1, 2), (2, 3))
    assert np.allclose(found.map(moved), np.roll(found.map(x), (1, 2), (1, 2)))
    told = found.score(x, random.permutation(truth.ravel()).reshape(truth.shape), levels)
    assert 0.45 < told.mean < 0.55
    with pytest.raises(ValueError, match="cells of both kinds"):
        cell_probes.fit(x, truth & False, levels)
    with pytest.raises(ValueError, match=r"got \(80, 6, 5, 5\), \(80, 4, 5\)"):
        cell_probes.fit(x, truth[:, 1:], levels)
    with pytest.raises(ValueError, match=r"got \(80, 6, 5, 5\), \(80, 4, 5\)"):
        found.score(x, truth[:, 1:], levels)


@pytest.mark.parametrize("kind", [np.int64, np.float64, np.str_])
def test_what_holds_in_a_cell_is_true_or_false_and_no_count(kind):
    x = np.random.default_rng(0).normal(size=(20, 6, 5, 7))
    truth, levels = x[:, 2] > 0, np.arange(20) // 2
    found, told = cell_probes.fit(x, truth, levels), "the truth must be bool; got "
    with pytest.raises(ValueError, match=told):
        found.score(x, (2 * truth).astype(kind), levels)
    with pytest.raises(ValueError, match=told):
        cell_probes.fit(x, (2 * truth).astype(kind), levels)
    with pytest.raises(ValueError, match=r"got \(20, 6, 5, 7\), \(20, 7, 5\)"):
        found.score(x, truth.transpose(0, 2, 1), levels)


def test_channels_at_a_cell_are_those_of_its_place(planner, states):
    some = states[:50]
    values = activations(planner, observe(planner, SMALL, some), ["encoder.conv1"])
    seen = cell_probes.at_cells(planner, SMALL, values["encoder.conv1"])
    assert seen.shape[2:] == (5, 5)
    mouse = np.zeros((len(some), 5, 5), bool)
    mouse[np.arange(len(some)), some["y"].astype(int), some["x"].astype(int)] = True
    found = cell_probes.fit(seen, mouse, some["level"])
    assert found.score(seen, mouse, some["level"]).mean > 0.95
