"""Maps of what the critic's value depends on, beside slow calculations of the same."""

import sys

import numpy as np
import polars as pl
import pytest
import torch

from astray import games
from astray.agents.policy import Architecture, weights
from astray.analysis.critic import observe
from astray.analysis.trained import Agent
from astray.games.coinrun import edits
from astray.insight import attribution
from astray.level import Level
from helpers.thorough import thorough

COINRUN, MAZE = games.find("coinrun"), games.find("maze")
END = COINRUN.variants["coin-end"]
ROOM = """
    #..........####
    #..........####
    #....<.....####
    #@.ocx.....####
    ===========####
"""
PLANES = Architecture("mlp", (7, 13, 13), (1,) * 7, 15, width=16)
CATEGORIES = Architecture("mlp", (4, 7, 7), (1, 1, 6, 6), 15, width=16)
IMAGE = Architecture("impala", (64, 64, 3), (), 15)


def make_agent(architecture, game, folder):
    torch.manual_seed(1)
    path = folder / "agent.safetensors"
    path.write_bytes(weights(architecture.build(), architecture, game))
    return Agent(path, game)


@pytest.fixture
def planes(tmp_path):
    return make_agent(PLANES, "coinrun", tmp_path)


@pytest.fixture
def categories(tmp_path):
    return make_agent(CATEGORIES, "maze", tmp_path)


@pytest.fixture
def images(tmp_path):
    return make_agent(IMAGE, "coinrun", tmp_path)


def states(*drawings):
    levels = [Level.from_text(COINRUN, END, drawing) for drawing in drawings]
    built = np.array([level.state(solvable=False) for level in levels], COINRUN.state)
    built["x"] = 6.1  # the wall is in view, the coin, crate, saw and walker are left of it
    built["time"] = 3  # a walker has left three puffs
    return built


def shown_to(agent, count=2):
    """Some observations, and a game's that are far from 0 everywhere else."""
    if agent.game == "coinrun":
        return observe(agent, END, states(ROOM, ROOM.replace("o", "."))[:count])
    random = np.random.default_rng(0)
    flags, kinds = random.integers(0, 2, (count, 2, 7, 7)), random.integers(0, 7, (count, 2, 7, 7))
    return np.concatenate([flags, kinds], 1).astype(np.uint8)


def value_of(network, planes):
    """The value of float planes [channels, H, W], in float64 and without torch."""
    x = planes.reshape(-1).astype(float)
    for layer in (network.features.linear1, network.features.linear2):
        w, b = (p.detach().double().numpy() for p in (layer.weight, layer.bias))
        x = np.maximum(w @ x + b, 0)
    w, b = (p.detach().double().numpy() for p in (network.value.weight, network.value.bias))
    return (w @ x + b)[0]


def test_gradients_of_planes_are_small_differences(planes):
    shown = shown_to(planes)
    maps = attribution.gradients(planes, shown)
    assert maps.shape == shown.shape
    random = np.random.default_rng(0)
    for n, *cell in zip(*(random.integers(0, side, 60) for side in shown.shape), strict=True):
        step = np.zeros(shown.shape[1:])
        step[tuple(cell)] = 1e-6
        up, down = (value_of(planes.network, shown[n] + sign * step) for sign in (1, -1))
        assert maps[n][tuple(cell)] == pytest.approx((up - down) / 2e-6, abs=1e-5)
    assert abs(maps).max() > 0.01


def test_gradients_of_categories_go_towards_more_of_what_is_there(categories):
    shown = shown_to(categories, 1)
    maps = attribution.gradients(categories, shown)[0]
    spread = categories.network.spread(torch.from_numpy(shown))[0].numpy()
    for plane in (2, 3):
        for y, x in np.ndindex(7, 7):
            step = np.zeros_like(spread, float)
            pair = ([plane, plane + 2], y, x)  # the two coordinates on the circle
            step[pair] = 1e-6 * spread[pair]
            up, down = (value_of(categories.network, spread + sign * step) for sign in (1, -1))
            assert maps[plane, y, x] == pytest.approx((up - down) / 2e-6, abs=1e-5)
            assert shown[0, plane, y, x] or maps[plane, y, x] == 0


def test_gradients_of_images_are_small_differences_in_brightness(images):
    """Of noise: where a sky is flat, inputs of a pooling are equal, and there is a kink."""
    shown = np.random.default_rng(0).integers(0, 256, (1, 64, 64, 3)).astype(np.uint8)
    (of_map,) = attribution.gradients(images, shown)
    assert of_map.shape == (64, 64)
    network = images.network.double()
    for y, x in [(3, 60), (20, 31), (40, 10), (63, 0), (33, 33)]:
        per_colour = []
        for colour in range(3):
            step = torch.zeros(1, 64, 64, 3, dtype=torch.float64)
            step[0, y, x, colour] = 255e-7  # a ten-millionth of full brightness
            up, down = (network(torch.from_numpy(shown) + sign * step)[1] for sign in (1, -1))
            per_colour.append((up - down).item() / 2e-7)
        assert of_map[y, x] == pytest.approx(np.mean(per_colour), rel=1e-3, abs=1e-6)


@pytest.mark.parametrize("kind", ["planes", "categories", *thorough("images")])
def test_integrated_gradients_add_up(kind, request):
    agent = request.getfixturevalue(kind)
    shown = shown_to(agent)
    for baseline in (None, shown[1]):
        zero = np.zeros_like(shown) if baseline is None else shown[[1, 1]]
        maps = attribution.integrated_gradients(agent, shown, baseline, steps=256)
        risen = (agent.outputs(shown)[1] - agent.outputs(zero)[1]).numpy()
        total = maps.reshape(2, -1).sum(1) * (3 if kind == "images" else 1)
        assert total == pytest.approx(risen, abs=0.01 * float(abs(risen).max()) + 1e-6)
        assert abs(risen).max() > 1e-3
    same = (shown[0] == shown[1]) if kind != "images" else (shown[0] == shown[1]).all(2)
    assert not maps[0][same].any() and not maps[1].any()


@pytest.mark.parametrize("kind", ["planes", "categories"])
def test_occlusion_of_planes_by_hand(kind, request):
    agent = request.getfixturevalue(kind)
    shown = shown_to(agent)
    maps = attribution.occlusion(agent, shown)
    assert maps.shape == shown.shape
    values = agent.outputs(shown)[1]
    for cell in map(tuple, np.argwhere(shown)[::7]):
        covered = shown.copy()
        covered[cell] = 0
        fallen = values - agent.outputs(covered)[1]
        assert maps[cell] == pytest.approx(fallen[cell[0]].item(), abs=1e-5)
    assert maps[shown == 0] == pytest.approx(0, abs=1e-6)


@pytest.mark.parametrize("window, colour", [(4, 0), (16, 128), (24, 0)])
def test_occlusion_of_images_by_hand(images, window, colour):
    """24 does not divide 64: the last squares are smaller."""
    shown = shown_to(images)
    maps = attribution.occlusion(images, shown, window=window, colour=colour)
    values = images.outputs(shown)[1].numpy()
    for top, left in [(0, 0), (window, 2 * window), (64 // window * window - window, window)]:
        square = (slice(None), slice(top, top + window), slice(left, left + window))
        covered = shown.copy()
        covered[square] = colour
        fallen = values - images.outputs(covered)[1].numpy()
        assert maps[square] == pytest.approx(
            np.broadcast_to(fallen[:, None, None], maps[square].shape), abs=1e-5
        )


def test_masks_of_planes_are_the_cells_of_the_drawing(planes):
    """The runner is in column 6 of the world and of what is seen, and in row 1: 5 lower."""
    where = attribution.masks(planes, END, states(ROOM), edits.PARTS)
    cells = {part: set(map(tuple, np.argwhere(mask[0]).tolist())) for part, mask in where.items()}
    low = 5  # the world's row 0
    assert cells["coin"] == {(3, low + 1, 3)}
    assert cells["crates"] == {(2, low + 1, 4)}
    assert cells["saws"] == {(1, low + 1, 5)}
    assert cells["walkers"] == {(4, low + 2, 5)}
    assert cells["end wall"] == {(0, y, x) for y in range(low + 1, 13) for x in (11, 12)}
    assert not cells["runner"] and not cells["background"]
    nothing = observe(planes, END, states(ROOM))[0] == 0
    assert cells["nothing"] == set(map(tuple, np.argwhere(nothing).tolist()))
    assert (0, low, 3) in cells["rest"]  # the ground


def test_masks_of_images_lie_in_the_boxes_of_what_is_drawn(images):
    where = attribution.masks(images, END, states(ROOM), edits.PARTS)
    scale, left, top = 64 / 13, 6.1 - 6.5, 1.5787 + 6.5  # of the picture, in cells
    boxes = {  # left, right, bottom, top, in cells; and the least fraction that is covered
        "coin": (3, 4, 1, 2, 0.2), "crates": (4, 5, 1, 2, 0.5), "saws": (5, 6, 1, 2, 0.2),
        "walkers": (5, 6.2, 2, 3, 0.3), "runner": (5.6, 6.6, 1, 2.4, 0.3),
        "end wall": (11, 13, 1, 9, 0.7),
    }  # fmt: skip
    for part, (x0, x1, y0, y1, least) in boxes.items():
        rows = slice(max(round((top - y1) * scale) - 1, 0), round((top - y0) * scale) + 1)
        columns = slice(max(round((x0 - left) * scale) - 1, 0), round((x1 - left) * scale) + 1)
        inside = where[part][0, rows, columns]
        assert inside.sum() == where[part].sum(), part
        assert inside.mean() > least, part
    assert where["end wall"][0, :33, 57:].all()
    together = np.sum(list(where.values()), axis=0)
    assert (together == 1).all()
    sky = where["background"][0, 18, 10:50]
    assert sky.all() and where["rest"][0, 60, :50].all()


def test_what_is_of_two_parts_is_of_the_first(images):
    both = {"background": edits.with_other_background, "coin": edits.without_coin}
    first, second = (
        attribution.masks(images, END, states(ROOM), dict(parts))
        for parts in (both.items(), reversed(both.items()))
    )
    assert 0 < first["coin"].sum() < second["coin"].sum()  # its soft edge
    assert np.array_equal(
        first["coin"] | first["background"], second["coin"] | second["background"]
    )


def test_fractions_are_of_absolute_values_and_of_area():
    rows = pl.DataFrame({"level": [7, 8, 9]})
    maps = np.array([[[1.0, -3.0]], [[2.0, 2.0]], [[0.0, 0.0]]])
    left = np.array([[[True, False]]] * 3)
    told = attribution.fractions(rows, maps, {"left": left, "right": ~left})
    assert told.to_dict(as_series=False) == {
        "level": [7, 8, 9] * 2,
        "part": ["left"] * 3 + ["right"] * 3,
        "attribution": [0.25, 0.5, None, 0.75, 0.5, None],
        "area": [0.5] * 6,
    }
    with pytest.raises(ValueError, match=r"3 rows, maps \(3, 1, 2\) and a mask \(2, 1, 2\)"):
        attribution.fractions(rows, maps, {"left": left[:2]})


def test_many_observations_are_as_one_by_one(images):
    shown = np.repeat(shown_to(images), 33, 0)  # more than a chunk
    maps = attribution.gradients(images, shown)
    alone = attribution.gradients(images, shown[-1:])
    assert maps.shape == (66, 64, 64) and maps[-1] == pytest.approx(alone[0], abs=1e-6)


@pytest.mark.parametrize("method", ["gradients", "integrated_gradients", "occlusion"])
def test_observations_of_another_shape_are_refused(planes, method):
    with pytest.raises(ValueError, match=r"sees observations \[N, 7, 13, 13\], not \(2, 4, 7, 7\)"):
        getattr(attribution, method)(planes, np.zeros((2, 4, 7, 7), np.uint8))


def test_gradients_of_a_network_of_ones_own_are_refused(planes):
    class Own(torch.nn.Module):
        """Of a guest."""

    planes.network = Own()
    for method in (attribution.gradients, attribution.integrated_gradients):
        with pytest.raises(ValueError, match=r"takes any\) must be a MLP; got Own"):
            method(planes, shown_to(planes))


def test_without_captum_the_extra_is_named(planes, monkeypatch):
    monkeypatch.setitem(sys.modules, "captum.attr", None)
    with pytest.raises(ImportError, match=r'pip install ".\[insight\]"'):
        attribution.gradients(planes, shown_to(planes))
