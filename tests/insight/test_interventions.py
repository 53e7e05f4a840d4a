"""Interventions on layers, beside the same done by hand, on networks of every kind."""

from contextlib import nullcontext

import gymnasium
import numpy as np
import pytest
import torch

from astray.analysis.trained import Network
from astray.games import find
from astray.insight.activations import activations, layers
from astray.insight.interventions import ablate, changed, patch, place, resample, steer
from helpers.looked_into import ARCHITECTURES, LAYERS, make_agent

MAZE = find("maze")


@pytest.fixture(params=ARCHITECTURES)
def kind(request):
    return request.param


@pytest.fixture
def agent(kind, tmp_path):
    return make_agent(kind, tmp_path)


def seen_by(agent, count=5):
    random = np.random.default_rng(0)
    most = 2 if agent.observation == "symbolic" else 256
    return random.integers(0, most, (count, *agent.architecture.shape)).astype(np.uint8)


def both(agent, shown):
    return torch.cat([agent.outputs(shown)[0], agent.outputs(shown)[1][:, None]], 1)


def test_layers_have_names_and_shapes(agent, kind):
    shapes = layers(agent)
    assert LAYERS[kind] in shapes
    assert "relu" not in shapes, "a module that is used twice is no one layer"
    given = activations(agent, seen_by(agent), [LAYERS[kind]])[LAYERS[kind]]
    assert given.shape == (5, *shapes[LAYERS[kind]]) and given.dtype == np.float32


def test_a_layer_gives_what_the_networks_own_module_gives(agent, kind):
    shown, name = seen_by(agent, 3), LAYERS[kind]
    expected = []
    module = agent.network.get_submodule(name)
    hook = module.register_forward_hook(lambda _, __, output: expected.append(output))
    agent.network(torch.from_numpy(shown))
    hook.remove()
    given = activations(agent, shown, [name])[name]
    assert given == pytest.approx(expected[0].detach().numpy(), abs=1e-5)


def test_one_and_many_observations_give_the_same(agent, kind):
    shown, name = seen_by(agent, 70), LAYERS[kind]
    some = activations(agent, shown, [name])[name]
    for k in (0, 17, 69):
        alone = activations(agent, shown[k : k + 1], [name])[name]
        assert (alone[0] == some[k]).all()


@pytest.mark.parametrize("what", ["steer", "nested", "patch", "ablate", "resample", "error"])
def test_afterwards_the_agent_is_as_before_to_the_bit(agent, kind, what):
    shown, name = seen_by(agent), LAYERS[kind]
    before, shape = both(agent, shown), layers(agent)[name]
    one = np.ones(shape)
    make = {
        "steer": lambda: steer(agent, {name: one}, 0.3),
        "nested": lambda: steer(agent, {name: one}, -2.0),
        "patch": lambda: patch(agent, name, [0, 2], 3.0),
        "ablate": lambda: ablate(agent, name),
        "resample": lambda: resample(agent, name, np.random.default_rng(0).random((4, *shape))),
        "error": lambda: steer(agent, {name: one}, 5.0),
    }
    with pytest.raises(KeyError) if what == "error" else nullcontext(), make[what]():
        inner = steer(agent, {name: one}) if what == "nested" else nullcontext()
        with inner:
            assert (both(agent, shown) != before).any()
        if what == "error":
            raise KeyError
    assert (both(agent, shown) == before).all()
    assert not any(module._forward_hooks for module in agent.network.modules())


@pytest.mark.parametrize("what", ["steer", "patch", "ablate", "changed"])
def test_a_change_of_nothing_changes_no_bit(agent, kind, what):
    shown, name = seen_by(agent), LAYERS[kind]
    before, shape = both(agent, shown), layers(agent)[name]
    none = {
        "steer": steer(agent, {name: np.ones(shape)}, 0.0),
        "patch": patch(agent, name, [], 9.0),
        "ablate": ablate(agent, name, []),
        "changed": changed(agent, {name: lambda x: x}),
    }
    with none[what]:
        assert (both(agent, shown) == before).all()


def test_steering_adds_what_a_hand_would_add(tmp_path):
    agent = make_agent("small", tmp_path)
    shown, vector = seen_by(agent), np.linspace(-1, 1, 16)
    network = agent.network
    with torch.no_grad():
        x = network.features.relu1(
            network.features.linear1(network.spread(torch.from_numpy(shown)).flatten(1))
        )
        x = network.features.relu2(network.features.linear2(x - 2 * torch.tensor(vector).float()))
        expected = network.policy(x)
    with steer(agent, {"features.relu1": vector}, -2.0):
        assert agent.outputs(shown)[0].numpy() == pytest.approx(expected.numpy(), abs=1e-5)


def test_a_network_of_bfloat16_is_resampled():
    net = torch.nn.Sequential(torch.nn.Linear(12, 8), torch.nn.Linear(8, 2)).bfloat16()
    agent = Network(net, gymnasium.spaces.Box(0, 1, (12,)), ask=lambda net, x: net(x.bfloat16()))
    shown = np.ones((3, 12), np.float32)
    before = agent.outputs(shown)[0]
    with resample(agent, "0", activations(agent, shown, ["0"])["0"]):
        assert (agent.outputs(shown)[0] == before).all()


def test_a_compiled_network_is_steered_and_read_as_its_module_is():
    body = torch.nn.Sequential(torch.nn.Flatten(), torch.nn.Linear(12, 8), torch.nn.Tanh())
    inner = torch.compile(body, backend="eager")
    space, shown = gymnasium.spaces.Box(0, 1, (12,)), np.ones((3, 12), np.float32)
    found = []
    for module in (body, inner):
        last = torch.nn.Linear(8, 2)
        torch.nn.init.constant_(last.weight, 0.5)
        torch.nn.init.constant_(last.bias, 0)
        agent = Network(torch.nn.Sequential(module, last), space)
        before = agent.outputs(shown)[0]
        name = next(name for name in layers(agent) if name.endswith(".2"))
        with steer(agent, {name: np.ones(8)}):
            found.append((before, agent.outputs(shown)[0], activations(agent, shown, [name])[name]))
    (plain, steered, given), compiled = found
    assert (steered - plain).numpy() == pytest.approx(4, abs=1e-5)
    for mine, its in zip(compiled, (plain, steered, given), strict=True):
        assert np.asarray(mine) == pytest.approx(np.asarray(its), abs=1e-5)


def test_what_is_nested_adds_up(agent, kind):
    shown, name = seen_by(agent), LAYERS[kind]
    vector = np.random.default_rng(2).normal(size=layers(agent)[name])
    with steer(agent, {name: vector}, 1.5), steer(agent, {name: vector}, -0.5):
        twice = both(agent, shown)
    with steer(agent, {name: vector}):
        assert twice.numpy() == pytest.approx(both(agent, shown).numpy(), abs=1e-4)


def test_a_patch_sets_one_place_of_some_channels(tmp_path):
    agent = make_agent("impala", tmp_path)
    shown, name = seen_by(agent), "block2.residual1"
    plain = activations(agent, shown, [name])[name]
    with patch(agent, name, [1, 4], np.array([7.0, -8.0]), (3, 9)):
        given = activations(agent, shown, [name])[name]
    changed_at = plain.copy()
    changed_at[:, 1, 3, 9], changed_at[:, 4, 3, 9] = 7.0, -8.0
    assert (given == changed_at).all()


def test_an_ablation_to_the_mean_gives_the_mean(tmp_path):
    agent = make_agent("impala", tmp_path)
    shown, name = seen_by(agent), "block3.residual2"
    plain = activations(agent, shown, [name])[name]
    with ablate(agent, name, [2], mean_of=plain):
        given = activations(agent, shown, [name])[name]
    assert given[:, 2] == pytest.approx(np.broadcast_to(plain[:, 2].mean(0), plain[:, 2].shape))
    assert (np.delete(given, 2, 1) == np.delete(plain, 2, 1)).all()


def test_resampled_channels_are_a_donors_and_the_same_in_every_batch(agent, kind):
    shown, name = seen_by(agent, 40), LAYERS[kind]
    donors = np.random.default_rng(0).random((6, *layers(agent)[name])).astype(np.float32)
    with resample(agent, name, donors, [0, 1], seed=3):
        given = activations(agent, shown, [name])[name]
        alone = activations(agent, shown[33:34], [name])[name]
    assert (alone[0] == given[33]).all()
    drawn = {k for one in given for k in range(6) if (one[:2] == donors[k, :2]).all()}
    assert all(any((one[:2] == donor[:2]).all() for donor in donors) for one in given)
    assert len(drawn) > 3


def test_a_cell_of_a_level_is_found_in_a_layer(tmp_path):
    images, planes = make_agent("impala", tmp_path), make_agent("small", tmp_path)
    easy = MAZE.variant("anywhere-easy")  # 15 cells a side
    assert place(images, easy, (0, 0), (32, 16, 16)) == (15, 0)
    assert place(images, easy, (14, 14), (32, 16, 16)) == (0, 15)
    assert place(images, easy, (7, 7), (32, 8, 8)) == (4, 4)
    assert place(planes, MAZE.variant("anywhere-small"), (1, 6), (6, 7, 7)) == (6, 1)
    for variant in (MAZE.variant("anywhere-memory"), find("box").variant("bare")):
        with pytest.raises(ValueError, match="here, give patch the layer's row and column"):
            place(images, variant, (3, 3), (32, 8, 8))


@pytest.mark.parametrize(
    "make, message",
    [
        (lambda a: steer(a, {"features.relu9": np.ones(16)}), "unknown layer 'features.relu9'; th"),
        (lambda a: steer(a, {"features.relu1": np.ones(15)}), r"go with .* \(16,\); got array"),
        (lambda a: steer(a, {"features.relu1": np.full(16, np.nan)}), "finite numbers"),
        (lambda a: steer(a, {"features.relu1": np.ones(16)}, np.inf), "coefficient must be a fin"),
        (lambda a: steer(a, {"features.relu1": np.ones(16)}, "1"), "coefficient must be a fin"),
        (lambda a: changed(a, {"features.relu1": 1}), "relu1 must be a function; got 1"),
        (lambda a: patch(a, "spread", [1], 0.0, (0, 1, 2)), "a cell must be two integers"),
        (lambda a: patch(a, "spread", [1], 0.0, "ab"), "a cell must be two integers"),
        (lambda a: patch(a, "features.relu1", [16], 0.0), "channels must be from 0 to 15"),
        (lambda a: patch(a, "features.relu1", [1.5], 0.0), "channels must be integers"),
        (lambda a: patch(a, "features.relu1", [1], 0.0, (0, 0)), "has no places"),
        (lambda a: patch(a, "spread", [1], 0.0, (0, 7)), "column must be an integer from 0 to 6"),
        (lambda a: ablate(a, "features.relu1", mean_of=np.ones((3, 15))), "must be .M, "),
        (lambda a: resample(a, "features.relu1", np.ones((0, 16))), "must be .M, "),
        (lambda a: ablate(a, "features.relu1", mean_of=np.full((3, 16), np.nan)), "finite numbers"),
        (lambda a: resample(a, "features.relu1", np.full((3, 16), np.inf)), "finite numbers"),
        (lambda a: steer(a, {"features.relu1": np.ma.masked_less([1.0] * 16, 2)}), "finite num"),
    ],
)
def test_what_cannot_be_changed_is_told(tmp_path, make, message):
    agent = make_agent("small", tmp_path)
    with pytest.raises(ValueError, match=message), make(agent):
        pass


@pytest.mark.parametrize(
    ("change", "got"),
    [
        (lambda x: None, "None"),
        (lambda x: "x", "'x'"),
        (lambda x: x[:, :2], r"torch.Size\(\[.*, 2"),
        (lambda x: x[:1], r"torch.Size\(\[1, "),
    ],
)
def test_a_change_that_returns_no_activations_is_told(kind, agent, change, got):
    said = f"the change of .* must return a tensor of .*; got {got}"
    with changed(agent, {LAYERS[kind]: change}), pytest.raises(ValueError, match=said):
        agent.outputs(seen_by(agent))
