"""Planners of Sokoban of train-learned-planner, read from checkpoints that are made here."""

import gymnasium
import msgpack
import numpy as np
import pytest
import torch

import astray
from astray.agents.importers import files, planner
from astray.analysis.critic import visit
from astray.analysis.trained import BY_ITSELF
from astray.insight.activations import capture, layers
from astray.insight.interventions import thinking
from helpers.foreign import flax_bytes, sokoban_planner, square

IMAGES = np.random.default_rng(1).integers(0, 256, (4, 5, 5, 3), np.uint8)


def said(network, images=IMAGES):
    """Logits [T, A] and values [T] along an episode that begins with the first image."""
    begins = torch.arange(len(images))[:, None] == 0
    with torch.no_grad():
        logits, values, _ = network.unroll(
            torch.from_numpy(images)[:, None], torch.ones(1, network.memory), begins
        )
    return logits[:, 0].numpy(), values[:, 0].numpy()


@pytest.mark.parametrize(
    "changed",
    [
        {},
        {"n_recurrent": 1, "repeats_per_step": 1, "devices": 2},
        {"channels": 3, "actions": 5, "embed": [square(4, 3)]},
    ],
    ids=str,
)
def test_a_planner_computes_what_it_did_there_along_an_episode(tmp_path, changed):
    forward = sokoban_planner(tmp_path, **changed)
    for ours, theirs in zip(said(planner.read(tmp_path)), forward(IMAGES), strict=True):
        assert abs(theirs).max() > 0.05
        assert np.allclose(ours, theirs, atol=1e-5)


@pytest.mark.parametrize(
    "changed, why",
    [
        ({"_type_": "cleanba.network:GuezResNetConfig"}, "only 'cleanba.convlstm:ConvLSTMConfig'"),
        ({"norm": {"_type_": "cleanba.network:RMSNorm"}}, "has norm .*RMSNorm"),
        ({"normalize_input": True}, "has normalize_input True; only False is read"),
        ({"residual": True}, "has residual True; only False"),
        ({"pool_and_inject": "vertical"}, "has pool_and_inject 'vertical'; only 'horizontal'"),
        ({"fence_pad": "same"}, "has fence_pad 'same'; only 'valid' is read"),
        ({"pool_projection": "full"}, "has pool_projection 'full'; only 'per-channel'"),
        ({"output_activation": "sigmoid"}, "has output_activation 'sigmoid'; only 'tanh'"),
        ({"forget_bias": 1.0}, "has forget_bias 1.0; only 0 is read"),
        ({"skip_final": False}, "has skip_final False; only True"),
        ({"mlp_hiddens": [9, 9]}, "it has 2 dense layers; only one is read"),
        ({"mlp_hiddens": [8]}, r"linear\.bias is \(9,\); it would be \(8,\)"),
        ({"n_recurrent": 0}, "n_recurrent must be an integer from 1 to 20; got 0"),
        ({"embed": [square(4, 4) | {"strides": [2, 2]}] * 2}, "not square with stride 1"),
    ],
    ids=str,
)
def test_a_planner_of_another_network_is_refused_with_what_differs(tmp_path, changed, why):
    sokoban_planner(tmp_path, **changed)
    with pytest.raises(ValueError, match=f"is refused: .*{why}"):
        planner.read(tmp_path)


def test_a_damaged_checkpoint_is_refused(tmp_path):
    sokoban_planner(tmp_path)
    model, settings = tmp_path / "model", tmp_path / "cfg.json"
    data, told = model.read_bytes(), settings.read_text()

    def refused(why, bytes_=data, text=told):
        model.write_bytes(bytes_)
        settings.write_text(text)
        with pytest.raises(ValueError, match=f"is refused: .*{why}"):
            planner.read(tmp_path)

    refused("it is damaged, or not msgpack", data[:100])
    refused("it lacks params", msgpack.packb({}))
    refused(
        "it lacks network_params/cell_list_0", flax_bytes({"params": {"params": {"a": IMAGES}}})
    )
    refused("it lacks net", text="{}")
    settings.write_text("[" + "[]," * 350_000 + "0]")
    with pytest.raises(ValueError, match=r"cfg.json must be of at most 1,048,576 bytes"):
        planner.read(tmp_path)
    refused("", text="[1]")
    refused("", text=told[:30])
    refused("cell_list_2/.*, which its network does not", text=told.replace('rent": 3', 'rent": 2'))
    with pytest.raises(FileNotFoundError, match=r"cfg\.json"):
        planner.read(tmp_path / "elsewhere")


@pytest.mark.parametrize(
    "place, shape, why",
    [
        ("dense_list_0/kernel", (2**31, 0), "numbers of its fences must be .* from 1 to 10000000"),
        ("dense_list_0/kernel", (4 * 1000**2, 0), "numbers of its fences must be"),
        ("cell_list_0/fence/kernel", (2000, 1, 1, 16), "size of its fence .* from 1 to 20; got 20"),
        ("cell_list_0/fence/kernel", (3, 3, 1, 16_000), r"fence is \(3, 3, 1, 16000\), and a kern"),
        ("cell_list_0/fence/kernel", (3, 3, 0, 16), r"its fence is \(3, 3, 0, 16\)"),
        ("cell_list_0/project", (1, 30_000), r"pools has the weights \(1, 30000\)"),
        ("cell_list_0/hh/kernel", (1, 1, 2**40, 0), "numbers of its fences must be"),
    ],
)
def test_numbers_that_a_checkpoint_promises_take_no_memory(tmp_path, place, shape, why):
    sokoban_planner(tmp_path)
    held = planner.unpacked((tmp_path / "model").read_bytes())
    *path, last = place.split("/")
    at = held["params"]["params"]["network_params"]
    for name in path:
        at = at[name]
    at[last] = np.zeros(shape, np.float32)
    (tmp_path / "model").write_bytes(flax_bytes(held))
    with pytest.raises(ValueError, match=why):
        planner.read(tmp_path)


def test_the_verb_refuses_a_planner_for_want_of_the_game(tmp_path):
    sokoban_planner(tmp_path)
    for path in (tmp_path, tmp_path / "model"):
        with pytest.raises(ValueError, match="play Sokoban, which is not a game here"):
            files.digest(path)


class Squares(gymnasium.Env):
    """A pixel that actions move on 5 x 5; six steps an episode."""

    observation_space = gymnasium.spaces.Box(0, 255, (5, 5, 3), np.uint8)
    action_space = gymnasium.spaces.Discrete(4)

    def reset(self, *, seed=None, options=None):
        super().reset(seed=seed)
        self.time, self.at = 0, self.np_random.integers(5, size=2)
        return self.seen(), {}

    def seen(self):
        image = np.zeros((5, 5, 3), np.uint8)
        image[tuple(self.at)] = 255
        return image

    def step(self, action):
        self.time += 1
        self.at = np.clip(self.at + [(0, 1), (0, -1), (1, 0), (-1, 0)][action], 0, 4)
        return self.seen(), 0.0, self.time == 6, False, {}


def test_insight_looks_into_a_planner_that_remembers_in_an_environment_of_yours(tmp_path):
    forward = sokoban_planner(tmp_path)
    world = astray.World(
        name="squares",
        variants={"anywhere": Squares},
        events={"in_corner": lambda env, info: tuple(env.at) == (0, 4)},
        goals={"corner": "in_corner"},
        shifts={"none": astray.Shift("anywhere", "anywhere", "corner", ())},
    )
    agent = astray.Network(planner.read(tmp_path), Squares.observation_space, world)
    assert agent.caveat == BY_ITSELF and {"tick1", "tick2", "features.relu"} <= set(layers(agent))
    _, states = visit(agent, "anywhere", range(6))
    found = capture(agent, "anywhere", states, ["policy"], episodes=True).values["policy"]
    alone = capture(agent, "anywhere", states, ["policy"]).values["policy"]
    episode = states["level"] == 3
    assert episode.sum() == 6
    assert np.allclose(found[episode], forward(states["observation"][episode])[0], atol=1e-5)
    assert abs(found - alone)[episode][1:].max() > 1e-3
    with thinking(agent, 1):
        less = capture(agent, "anywhere", states, ["policy"], episodes=True).values["policy"]
    assert abs(found - less).max() > 1e-3
