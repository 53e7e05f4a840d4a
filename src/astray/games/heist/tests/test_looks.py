"""Pictures and symbols of Heist."""

from dataclasses import replace

import numpy as np
import pytest

from astray.art import own
from astray.envs.vector import GameVectorEnv
from astray.games.heist import GAME
from astray.games.heist.draw import ART, STRIPS
from astray.games.heist.rules import COLOURS, DOOR_CODE, GEM, KEY
from astray.games.heist.variants import VARIANTS
from astray.kernel.maze import FLOORS, WALL

HARD = VARIANTS["hard"]


def begin(variant, observation, level=2):
    env = GameVectorEnv("heist", variant, observation=observation, autoreset_mode="Disabled")
    return env, env.reset(seed=0, options={"level": level})[0][0]


def test_symbols_say_what_is_where_and_what_is_in_hand():
    env, planes = begin(HARD, "symbolic")
    guide, most = GAME.solver.expert(env.states[0], "gem"), 0
    while not env.states[0].ended:
        s = env.states[0]
        wall, gem, thief, hand, key, door, sub_x, sub_y = planes.astype(int)
        cells = GAME.editing.grid(s).astype(int)
        assert np.array_equal(wall == 1, cells == WALL) and np.array_equal(gem == 1, cells == GEM)
        assert np.array_equal(key, np.where((cells >= KEY) & (cells < DOOR_CODE), cells - 1, 0))
        is_door = (cells >= DOOR_CODE) & (cells < GEM)
        assert np.array_equal(door, np.where(is_door, cells - DOOR_CODE + 1, 0))
        ((y, x),) = np.argwhere(thief)
        assert abs(x + (sub_x[y, x] - 0.5) / STRIPS - s.x) <= 0.5 / STRIPS
        assert abs(y + (sub_y[y, x] - 0.5) / STRIPS - s.y) <= 0.5 / STRIPS
        assert hand[0, :3].tolist() == [int(s.hand) >> k & 1 for k in range(3)]
        most = max(most, hand.sum())
        planes = env.step(np.array([guide(s)]))[0][0]
    assert most == 3


def test_a_window_of_symbols_is_what_is_around_the_thief():
    env, planes = begin(VARIANTS["memory"], "symbolic")
    s = env.states[0]
    world = np.pad(s.cell == WALL, 4, constant_values=True)
    x, y = int(s.x), int(s.y)
    assert np.array_equal(planes[0], world[y : y + 9, x : x + 9])
    assert planes[2].sum() == planes[2, 4, 4] == 1


@pytest.mark.parametrize("name", ["hard", "easy", "memory"])
@pytest.mark.parametrize("observation", ["image", "symbolic"])
def test_a_level_that_was_drawn_step_by_step_is_drawn_as_it_is_anew(name, observation):
    env, _ = begin(VARIANTS[name], observation)
    guide = GAME.solver.expert(env.states[0], "gem")
    while not env.states[0].ended:
        seen = env.step(np.array([guide(env.states[0])]))[0]
        other = GameVectorEnv("heist", env.variant, observation=observation)
        assert np.array_equal(seen, other.set_state(env.states))


@pytest.mark.parametrize("window", [0, 5, 8])
def test_nothing_of_the_level_before_is_seen(window):
    variant = replace(HARD, window=window, shifted=None)
    env, _ = begin(variant, "image")
    for level in range(10):
        seen, _ = env.reset(options={"level": level})
        other = GameVectorEnv("heist", variant, observation="image")
        assert np.array_equal(seen, other.reset(seed=0, options={"level": level})[0])


def test_each_key_in_hand_has_a_place_and_a_colour_of_its_own():
    env, bare = begin(HARD, "image")
    seen = []
    for k in range(3):
        states = env.get_state()
        states["hand"] = 1 << k
        other = GameVectorEnv("heist", HARD)
        changed = np.argwhere((other.set_state(states)[0] != bare).any(-1))
        assert len(changed) and (changed[:, 0] < 8).all()
        seen.append(changed.mean(0)[1])
    assert np.diff(seen) == pytest.approx([-3.84, -3.84], abs=0.6)


def test_everything_is_told_apart_on_every_floor():
    """The mean colours of what a cell of 5 pixels shows are far from each other, of 441."""
    tinted = [
        own.tint(own.load(ART, name, 5, 5), own.COLOURS[colour])
        for name in ("key", "door")
        for colour in COLOURS
    ]
    plain = [own.load(ART, name, 5, 5) for name in ("gem", "thief-right", "wall-brick")]
    for k in range(FLOORS):
        floor = own.load(ART, f"floor-{k}", 64, 128)[:, :, :3].reshape(-1, 3).mean(0)
        seen = [floor]
        for sprite in (one.reshape(-1, 4).astype(float) for one in (*tinted, *plain)):
            weight = sprite[:, 3:] / 255
            seen.append((sprite[:, :3] * weight + floor * (1 - weight)).mean(0))
        apart = [np.linalg.norm(a - b) for i, a in enumerate(seen) for b in seen[i + 1 :]]
        assert min(apart) > 20, k
