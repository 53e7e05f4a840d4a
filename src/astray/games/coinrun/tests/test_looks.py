"""Observations of CoinRun, in pictures and in symbols."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from astray.envs.pictures import picture
from astray.envs.vector import GameVectorEnv
from astray.games.coinrun import GAME, backdrops, draw
from astray.games.coinrun.rules import COIN, CORNER, CRATE, HALF, SAW, TOP, WALL, turned_by
from astray.games.coinrun.variants import VARIANTS


def begin(variant, observation, level=4):
    env = GameVectorEnv("coinrun", variant, observation=observation, autoreset_mode="Disabled")
    return env, env.reset(seed=0, options={"level": level})[0][0]


def window(grid, s, outside):
    """The 13 x 13 cells of `grid` around the runner."""
    x, y = int(s.x), int(s.y)
    return np.pad(grid, 6, constant_values=outside)[y : y + 13, x : x + 13]


def test_symbols_say_what_is_where():
    env, planes = begin("coin-end", "symbolic")
    guide = GAME.solver.expert(env.states[0], "coin")
    for _ in range(40):
        s = env.states[0]
        assert np.array_equal(planes[0], window(np.isin(s.cell, (WALL, TOP)), s, True))
        assert np.array_equal(planes[1], window((s.thing == SAW) | np.isin(s.cell, (3, 4)), s, 0))
        assert np.array_equal(planes[2], window(s.thing == CRATE, s, 0))
        assert np.array_equal(planes[3], window(s.cell == COIN, s, 0))
        if s.ended:
            break
        planes = env.step(np.array([guide(s)]))[0][0]


def test_symbols_say_where_walkers_are_and_where_they_go():
    env, _ = begin("coin-end", "symbolic", level=0)
    seen = set()
    for _ in range(60):
        planes = env.step(np.array([7]))[0][0]
        s = env.states[0]
        dx, dy = s.walker_x[0] - int(s.x) + 6, int(s.walker_y[0] - int(s.y) + 6)
        for plane, goes in ((4, s.walker_vx[0] < 0), (5, s.walker_vx[0] > 0)):
            columns = {int(np.floor(dx - 0.49)), int(np.floor(dx + 0.49))} if goes else set()
            expected = {(dy, c) for c in columns if 0 <= c < 13 and 0 <= dy < 13}
            assert set(map(tuple, np.argwhere(planes[plane]).tolist())) == expected
            seen |= {plane} if expected else set()
    assert seen == {4, 5}


@pytest.mark.parametrize("aside, cells", [(-0.011, 2), (-0.009, 1), (0.009, 1), (0.011, 2)])
def test_a_walker_is_in_the_cells_whose_walls_turn_it(aside, cells):
    env, _ = begin("coin-end", "symbolic", level=0)
    s = env.get_state()
    x, y = (int(s[name][0, 0]) for name in ("walker_x", "walker_y"))
    s["x"], s["y"], s["walker_x"][0, 0], s["walker_vx"][0, 0] = x + 3.5, y + 0.5, x + 0.5 + aside, 1
    assert env.set_state(s)[0][draw.RIGHT_PLANE].sum() == cells
    s["cell"][0, y, [x - 1, x + 1]] = WALL
    ends = [x + 0.5 + aside + HALF * CORNER * side for side in (-1, 1)]
    assert any(turned_by(s[0], end, y + 0.5) for end in ends) == (cells == 2)


def test_gauges_rise_with_place_and_speed():
    env, planes = begin("coin-end", "symbolic", level=3)
    gauges = [planes[6]]
    for _ in range(9):
        gauges.append(env.step(np.array([8]))[0][0][6])
    still, rising = gauges[0], gauges[1]
    marks = [g.reshape(-1)[: 8 * 13].reshape(4, 26).sum(1).tolist() for g in gauges]
    assert marks[0] == [13, 15, 13, 13]  # in the middle, 0.5787 up, at rest
    assert still[8].all() and not rising[8].any()  # supported, and not
    assert marks[1][3] == 26 and marks[9][3] < 13  # up, and down
    assert marks[9][2] > 13  # to the right


@pytest.mark.parametrize("name", ["coin-end", "coin-end-permeable", "coin-end-easy"])
def test_a_picture_of_the_agents_size_is_what_the_agent_sees(name):
    env, image = begin(name, "image")
    for action in (7, 8, 8, 1, 5, 7):
        assert np.array_equal(env.picture(64)[0], image)
        image = env.step(np.array([action]))[0][0]


def test_a_large_picture_shows_what_the_small_one_does():
    """It is drawn anew in every step, without a scene: the same, but finer."""
    env, _ = begin("coin-end", "image", level=14)
    for action in (7, 8):
        image = env.step(np.array([action]))[0][0]
        large = env.picture(256)[0].reshape(64, 4, 64, 4, 3).mean((1, 3))
        assert np.abs(large - image).mean() < 8  # of 255


def test_the_runner_is_in_the_middle_and_the_world_moves():
    env, _ = begin("coin-end", "image", level=3)
    background = env.states["background"]
    for action in (7, 7, 7, 8, 8, 8, 8):
        image = env.step(np.array([action]))[0][0]
        gone = env.states.copy()
        gone["runner_look"] = (gone["runner_look"] + 1) % 5
        other = picture("coinrun", env.variant, gone, 64)[0]
        rows, columns = np.nonzero((image != other).any(2))
        assert rows.min() >= 28 and rows.max() <= 36 and columns.min() >= 28
        assert columns.max() <= 36
    assert (env.states["background"] == background).all()


@pytest.mark.parametrize("field, values", [("runner_look", 5), ("ground", 6), ("background", 62)])
def test_every_look_looks_different(field, values):
    env, _ = begin("coin-end", "image", level=3)
    states = np.repeat(env.states.copy(), values)
    states[field] = np.arange(values)
    images = picture("coinrun", env.variant, states, 64).astype(int)
    for k in range(values):
        for other in images[k + 1 :]:
            assert np.sqrt(((images[k] - other) ** 2).sum(2)).max() > 20  # of 441


def test_walkers_crates_coin_and_hazards_are_told_from_every_backdrop():
    skies, _, lavas, crates, saws, coin, _, walkers, _ = draw.art(VARIANTS["coin-end"], 64)
    skies = skies[:, ::7, ::7].reshape(-1, 3).astype(int)
    things = [lavas[0], *crates, *saws, coin, *walkers[:, 0, 0]]
    for thing in things:
        opaque = thing[thing[..., 3] > 200][:, :3].astype(int)
        apart = np.linalg.norm(opaque[:, None] - skies[None], axis=2).max(0)
        assert apart.min() > 35  # of 441


def test_backdrops_are_the_bytes_that_they_were():
    assert hashlib.sha256(backdrops.render(1.0).tobytes()).hexdigest()[:16] == "6a4cbda8436cda38"
    assert backdrops.render(2.0).shape == (62, 64, 128, 3)


def test_a_permeable_wall_looks_like_dirt_on_every_ground():
    variant = replace(VARIANTS["coin-end-permeable"], shifted=None)
    env, _ = begin(variant, "image", level=3)
    states = np.repeat(env.states.copy(), 6)
    states["ground"] = np.arange(6)
    states["x"], states["y"] = states["end_x"] + 8.5, 30.5
    images = picture("coinrun", variant, states, 64)
    assert all(np.array_equal(images[0], image) for image in images[1:])


def test_a_runner_in_the_end_wall_sees_what_is_not_in_the_scene_either(monkeypatch):
    env, _ = begin("coin-end", "image", level=3)
    states = np.repeat(env.states.copy(), 4)
    states["x"] = [states["end_x"][0] + 0.5, states["end_x"][0] + 3.2, 50.5, 63.5]
    images = picture("coinrun", env.variant, states, 64)
    monkeypatch.setattr(draw, "LARGEST", 0)  # no scene: painted anew
    assert np.array_equal(images, picture("coinrun", env.variant, states, 64))
