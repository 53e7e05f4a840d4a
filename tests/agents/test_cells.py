"""The network that thinks in ticks: what it sees, and that it is computed as it is written."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import torch

from astray import games
from astray.agents.cells import SIDE, WINDOW, Cells, first_pixels
from astray.agents.policy import Architecture, weights
from astray.analysis.trained import Agent
from astray.envs.vector import GameVectorEnv
from astray.insight.activations import layers
from astray.training.fast.acceleration import agreement
from astray.training.loop import collect
from astray.training.ppo import Samples
from astray.training.trainer import Trainer
from helpers.trainings import PICTURES

SHAPE = (64, 64, 3)


@functools.cache
def network() -> Cells:
    torch.manual_seed(0)
    return Cells(SHAPE, 15)


def test_the_window_of_a_cell_holds_the_mouse_that_stands_there_and_no_other_does():
    env = GameVectorEnv("maze", "corner", 1, observation="image")
    env.reset(seed=3)
    state = env.get_state()
    free = games.find("maze").cells.free(state.view(np.recarray)[0])
    seen = []
    cells = np.argwhere(free)[:40]
    for y, x in cells:
        state["x"], state["y"] = x + 0.5, y + 0.5
        picture = torch.from_numpy(env.set_state(state))
        seen.append(network().cells(picture)[0].numpy().astype(int))
    for (y, x), one, other in zip(cells, seen, [*seen[1:], seen[0]], strict=True):
        changed = np.argwhere((one != other).any(-1))
        assert [SIDE - 1 - y, x] in changed.tolist()
        assert len(changed) <= 2 * 9  # of two mice, each in its own window and at the edge of some


@pytest.mark.parametrize("pixels", [3, 25, 64, 100])
def test_windows_lie_in_the_picture_from_one_side_to_the_other(pixels):
    first = first_pixels(pixels)
    assert len(first) == SIDE and first == sorted(first)
    assert min(first) >= 0 and max(first) + WINDOW <= pixels
    if pixels >= SIDE:
        assert first[0] <= 2 and first[-1] + WINDOW >= pixels - 2


def test_each_look_is_shared_out_among_all_places():
    pictures = torch.randint(0, 256, (2, *SHAPE), dtype=torch.uint8)
    cells = (network().cells(pictures).float() / 255).permute(0, 3, 1, 2)
    rates = network().attention(cells)
    torch.testing.assert_close(rates.sum(-1), torch.ones(2, rates.shape[1]))


def test_what_stands_out_by_its_colour_is_looked_at_before_anything_is_learned():
    pictures = torch.full((1, *SHAPE), 90, dtype=torch.uint8)
    pictures[:, ::2] = 60  # floor and walls
    pictures[:, 30:33, 40:43] = torch.tensor([250, 20, 20], dtype=torch.uint8)
    cells = (network().cells(pictures).float() / 255).permute(0, 3, 1, 2)
    most = network().attention(cells)[0].max(-1).values
    assert most.max() > 0.3 > 10 / 169


@pytest.mark.parametrize("change", [{"bfloat16": True}, {"channels_last": True}], ids=str)
def test_the_fast_path_computes_what_is_written(change):
    trainer = Trainer(PICTURES.changed(network="cells", microbatch=8, **change))
    samples, g = collect(trainer).flat(), torch.Generator().manual_seed(0)
    noise = torch.randn(2, len(samples), generator=g)
    samples: Samples = replace(samples, advantage=noise[0], target=noise[1])
    cosine, ratio = agreement(trainer.fast, trainer.network, samples, trainer.config).values()
    exact = "channels_last" in change
    assert cosine > (0.99999 if exact else 0.99) and abs(ratio - 1) < (1e-3 if exact else 0.05)
    trainer.close()


def test_a_picture_too_small_for_a_window_is_refused():
    with pytest.raises(ValueError, match="at least 3 pixels a side"):
        Architecture("cells", (2, 64, 3), (), 15).build()


def test_what_every_tick_has_found_can_be_read_and_changed(tmp_path):
    architecture = Architecture("cells", SHAPE, (), 15)
    path = tmp_path / "agent.safetensors"
    path.write_bytes(weights(architecture.build(), architecture, "maze"))
    agent = Agent(path, "maze")
    there = layers(agent)
    assert there["ticks.0"] == there["ticks.7"] == there["stem"] == (16, 13, 13)
    assert there["features.relu"] == (128,) and "unit" not in there  # which is used eight times
    pictures = torch.randint(0, 256, (2, *SHAPE), dtype=torch.uint8)
    before = agent.network(pictures)[0]
    tick = agent.network.get_submodule("ticks.3")
    handle = tick.register_forward_hook(lambda *a: torch.zeros_like(a[2]))
    assert not torch.equal(agent.network(pictures)[0], before)
    handle.remove()
    assert torch.equal(agent.network(pictures)[0], before)
