"""Observations of keys and chests, in pictures and in symbols."""

from dataclasses import replace
from typing import get_args

import numpy as np
import pytest

from astray.art import own
from astray.envs.pictures import picture
from astray.envs.vector import GameVectorEnv
from astray.games.keys import GAME
from astray.games.keys.draw import ART, STRIPS
from astray.games.keys.rules import CHEST, KEY
from astray.games.keys.variants import VARIANTS, Inventory
from astray.kernel.maze import FLOORS, WALL

INVENTORIES = get_args(Inventory)
MANY_KEYS = VARIANTS["many-keys"]


def begin(variant, observation, level=1):
    env = GameVectorEnv("keys", variant, observation=observation, autoreset_mode="Disabled")
    return env, env.reset(seed=0, options={"level": level})[0][0]


def with_hand(states, keys):
    """`states` with this many keys in hand and no other change in what is drawn."""
    copy = states.copy()
    copy["taken"] = keys  # not a state of the game: only drawn
    return copy


@pytest.mark.parametrize("name", ["many-chests", "many-keys-easy"])
def test_symbols_say_what_is_where(name):
    env, planes = begin(VARIANTS[name], "symbolic")
    s = env.states[0]
    wall, key, chest, thief, hand, sub_x, sub_y = planes
    cells = GAME.editing.grid(s)
    for plane, code in ((wall, WALL), (key, KEY), (chest, CHEST)):
        assert np.array_equal(plane, cells == code)
    place = [[int(s.y), int(s.x)]]
    assert np.argwhere(thief).tolist() == np.argwhere(sub_x).tolist() == place
    assert sub_x.sum() == sub_y.sum() == 1 + STRIPS // 2 and not hand.any()


def test_symbols_follow_the_thief_inside_its_cell_and_count_its_keys():
    env, _ = begin(MANY_KEYS, "symbolic")
    guide = GAME.solver.expert(env.states[0], "keys")
    most = 0
    while not env.states[0].ended:
        _, key, chest, thief, hand, sub_x, sub_y = env.step(np.array([guide(env.states[0])]))[0][0]
        s = env.states[0]
        y, x = np.argwhere(thief)[0]
        assert abs(x + (sub_x.max() - 0.5) / STRIPS - s.x) <= 0.5 / STRIPS
        assert abs(y + (sub_y.max() - 0.5) / STRIPS - s.y) <= 0.5 / STRIPS
        assert (key.sum(), chest.sum()) == (s.keys - s.taken, s.chests - s.opened)
        assert hand.sum() == s.taken - s.opened == hand.ravel()[: hand.sum()].sum()
        most = max(most, hand.sum())
    assert most > 1


def test_a_window_of_symbols_is_what_is_around_the_thief():
    env, planes = begin(VARIANTS["many-keys-memory"], "symbolic")
    s = env.states[0]
    world = np.pad(s.cell == WALL, 4, constant_values=True)
    x, y = int(s.x), int(s.y)
    assert np.array_equal(planes[0], world[y : y + 9, x : x + 9])
    assert planes[3].sum() == planes[3, 4, 4] == 1


@pytest.mark.parametrize("name", ["many-keys", "many-keys-easy", "many-keys-memory"])
@pytest.mark.parametrize("observation", ["image", "symbolic"])
def test_a_level_that_was_drawn_step_by_step_is_drawn_as_it_is_anew(name, observation):
    env, _ = begin(VARIANTS[name], observation)
    guide = GAME.solver.expert(env.states[0], "chests")
    while not env.states[0].ended:
        seen = env.step(np.array([guide(env.states[0])]))[0]
        other = GameVectorEnv("keys", env.variant, observation=observation)
        other.set_state(env.states)
        assert np.array_equal(seen, other.set_state(env.states))
        if observation == "image":
            assert np.array_equal(seen, env.picture(64))


@pytest.mark.parametrize("window", [0, 5, 8, 9, 13])
def test_nothing_of_the_level_before_is_seen(window):
    variant = replace(MANY_KEYS, window=window, shifted=None)
    env, _ = begin(variant, "image")
    for level in range(20):
        seen, _ = env.reset(options={"level": level})
        other = GameVectorEnv("keys", variant, observation="image")
        assert np.array_equal(seen, other.reset(seed=0, options={"level": level})[0])


def test_y_goes_up_in_the_picture():
    env, _ = begin(MANY_KEYS, "image")
    s = env.states[0]
    image = env.picture(260)[0].astype(int)  # 20 pixels a cell
    patch = image[260 - int(s.y * 20) - 6 : 260 - int(s.y * 20) + 6, int(s.x * 20) - 6 :][:, :12]
    assert (patch[..., 2] - patch[..., 0]).mean() > 40  # cyan


def test_taken_keys_and_open_chests_are_not_drawn():
    env, before = begin(MANY_KEYS, "image")
    gone = env.states.copy()
    gone["gone"][:] = 0
    empty = picture("keys", replace(MANY_KEYS, inventory="hidden"), _emptied(gone), 64)[0]
    s = env.states[0]
    for k in range(s.objects):
        y, x = 63 - int(s.object_y[k] * 64 / 13), int(s.object_x[k] * 64 / 13)
        assert np.abs(before[y, x].astype(int) - empty[y, x]).sum() > 100


def _emptied(states):
    """The same level without objects."""
    states = states.copy()
    for name in ("objects", "keys", "chests"):
        states[name] = 0
    return states


@pytest.mark.parametrize("inventory", INVENTORIES)
def test_the_inventory_is_drawn_where_the_variant_says_a_key_at_a_time(inventory):
    env, _ = begin(MANY_KEYS, "symbolic")
    guide, icons = GAME.solver.expert(env.states[0], "keys"), []
    while len(icons) < 3:
        if env.states[0].taken - env.states[0].opened == len(icons):
            icons.append(np.argwhere(_icons(env.states, inventory)))
        env.step(np.array([guide(env.states[0])]))
    none, one, two = icons
    assert not len(none) and (len(two) == 2 * len(one) or inventory == "hidden")
    if inventory == "hidden":
        assert not len(one)
        return
    low, right = (one.mean(0) > 32).tolist()
    assert (low, right) == (inventory.startswith("lower"), inventory.endswith("right"))
    outermost = one[:, 1].max() >= 62 if right else one[:, 1].min() <= 1
    assert outermost and abs(two.mean(0)[1] - one.mean(0)[1]) == pytest.approx(3.84 / 2, abs=0.6)


def _icons(states, inventory):
    """Pixels that are the inventory's, [64, 64] bool."""
    images = []
    for name in (inventory, "hidden"):
        copy = states.copy()
        copy["inventory"] = INVENTORIES.index(name)
        images.append(picture("keys", MANY_KEYS, copy, 64)[0])
    return (images[0] != images[1]).any(2)


def test_everything_is_told_apart_on_every_floor():
    """The mean colours of what a cell of 5 pixels shows are far from each other, of 441."""
    names = ["key", "chest", "thief-right", "wall-brick"]
    for k in range(FLOORS):
        floor = own.resize(own.load(ART, f"floor-{k}"), 64, 128)[:, :, :3].reshape(-1, 3).mean(0)
        seen = [floor]
        for name in names:
            sprite = own.resize(own.load(ART, name), 5, 5).reshape(-1, 4).astype(float)
            weight = sprite[:, 3:] / 255
            seen.append((sprite[:, :3] * weight + floor * (1 - weight)).mean(0))
        apart = [np.linalg.norm(a - b) for i, a in enumerate(seen) for b in seen[i + 1 :]]
        assert min(apart) > 40


def test_the_background_can_be_chosen_without_touching_the_layout():
    plain, one = begin(MANY_KEYS, "image")
    other, two = begin(replace(MANY_KEYS, background=8), "image")
    assert np.array_equal(plain.states["cell"], other.states["cell"])
    assert not np.array_equal(one, two)
