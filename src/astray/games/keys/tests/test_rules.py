"""The rules of Keys and Chests, on rooms drawn in text."""

import contextlib
from dataclasses import replace

import numpy as np
import pytest

from astray.envs.vector import GameVectorEnv
from astray.games.keys import GAME
from astray.games.keys.variants import Keys
from astray.level import Level

SEVEN = Keys(about="", world=7, largest=7)
CORRIDOR = """
    #######
    #######
    #######
    @......
    #######
    #######
    #######
"""


@contextlib.contextmanager
def changed(env):
    """The only state of `env`, to be changed; it goes on from there."""
    states = env.get_state()
    yield states[0]
    env.set_state(states)


def corridor(row, **knobs):
    """An environment in which `row` is the only one without walls."""
    variant = replace(SEVEN, **knobs)
    env = GameVectorEnv("keys", variant, observation="symbolic", autoreset_mode="Disabled")
    drawing = CORRIDOR.replace("@......", row)
    env.set_state(Level.from_text(GAME, variant, drawing).state(solvable=False))
    return env


def play(env, actions):
    """The rewards of `actions`, and whether the last ended the level."""
    rewards, terminated = [], [False]
    for name in actions.split():
        _, reward, terminated, _, _ = env.step(np.array([GAME.actions.index(name)]))
        rewards.append(float(reward[0]))
    return rewards, bool(terminated[0])


def test_the_thief_speeds_up_as_it_is_pushed_and_slows_down_as_it_is_not():
    env = corridor("@......")
    speeds = [(play(env, name), float(env.states[0].vx))[1] for name in ("right",) * 3 + ("stay",)]
    assert speeds == pytest.approx([0.3375, 0.489375, 0.55771875, 0.2509734375])
    assert env.states[0].x == pytest.approx(0.5 + sum(speeds))


def test_walls_stop_the_thief_where_its_box_touches_them():
    env = corridor("#@.....")
    play(env, "left")
    s = env.states[0]
    assert (s.x, s.y) == (1.375, 3.5)
    assert s.vx == pytest.approx(-0.3375 / 4)  # one part of four was free
    play(env, "up")
    assert (s.y, s.vy) == (3.625, pytest.approx(0.3375 / 4))
    play(env, "right right right right right right right right right right right right right")
    assert s.x == 6.625  # the world's end is a wall


def test_both_axes_are_pressed_at_once_and_y_goes_first():
    room = CORRIDOR.replace("@......", "...@...").replace("#######", "#.#.#.#")
    env = GameVectorEnv("keys", SEVEN, observation="symbolic", autoreset_mode="Disabled")
    env.set_state(Level.from_text(GAME, SEVEN, room).state())
    play(env, "right-up right-up right-up")
    s = env.states[0]
    # Up into the side corridor, and as far right in it as it is wide.
    assert s.x == 3.625 and s.y > 4 and s.vx == 0 and s.vy > 0.4


def test_a_key_is_taken_and_opens_a_chest_and_the_last_chest_ends_the_level():
    env = corridor("@k.C...")
    rewards, terminated = play(env, "right right right right right")
    s = env.states[0]
    assert (rewards, terminated) == ([0, 0, 0, 0, 1], True)
    assert (s.first_key, s.all_keys, s.first_chest, s.all_chests) == (1, 1, 5, 5)
    assert s.keys_before_last == 1 and s.passed_chest == -1
    assert s.gone[:2].tolist() == [1, 5] and s.had[:2].tolist() == [0, 1]
    assert s.touched == 0 and s.passed == 0


# Half-sizes, in cells: thief 0.375 each way, chest 0.5, key 0.375 across and 0.232 up.
@pytest.mark.parametrize(
    "what, dx, dy, touched",
    [
        ("C", 0.87, 0, True), ("C", 0.88, 0, False), ("C", 0, -0.87, True), ("C", 0, 0.88, False),
        ("k", -0.74, 0, True), ("k", 0.76, 0, False), ("k", 0, 0.60, True), ("k", 0, -0.61, False),
    ],
)  # fmt: skip
def test_boxes_that_overlap_touch(what, dx, dy, touched):
    env = corridor(f"..@.{what}..")
    s = env.states[0]
    with changed(env) as new:
        new.object_x[0], new.object_y[0] = s.x + dx, s.y + dy
    play(env, "stay")
    assert (s.passed_chest == 1 or s.first_key == 1) == touched


@pytest.mark.parametrize(
    "moves, passed",
    [
        ("right", 1),
        ("right right", 1),
        ("right left left left", 1),
        ("right left left left right right right right", 2),
    ],
)
def test_a_chest_without_a_key_stays_shut_and_is_counted_each_time_it_is_come_upon(moves, passed):
    env = corridor(".@C...k")
    rewards, terminated = play(env, moves)
    assert not any(rewards) and not terminated
    assert env.states[0].passed == passed and env.states[0].passed_chest == 1


def test_a_level_with_more_chests_ends_when_the_keys_are_used():
    env = corridor("C@k.C.C")
    rewards, terminated = play(env, "right right right right right")
    assert (rewards, terminated) == ([0, 0, 0, 0, 1], True)
    assert env.states[0].all_chests == 5


def test_a_level_with_more_keys_ends_when_all_chests_are_open():
    env = corridor("k@k.C.k")
    rewards, terminated = play(env, "right right right right right")
    assert (rewards, terminated) == ([0, 0, 0, 0, 1], True)
    s = env.states[0]
    assert (s.taken, s.opened, s.all_keys, s.keys_before_last) == (1, 1, -1, -1)


def test_all_keys_before_the_last_chest_is_told_from_all_keys_with_it():
    env = corridor("C.k@k..")
    play(env, "right")
    assert env.states[0].keys_before_last == -1
    play(env, "left left left left")
    assert env.states[0].keys_before_last == env.states[0].all_keys > 0


def test_a_last_key_that_is_taken_with_the_last_chest_was_not_taken_before_it():
    env = corridor("@kkC...")
    s = env.states[0]
    play(env, "right")
    with changed(env) as new:
        new.x, new.vx, new.object_x[1], new.object_x[2] = 2.2, 0, 2.4, 3.0
    play(env, "stay")  # the chest was made later: it is first
    assert (s.all_keys, s.all_chests, s.keys_before_last) == (2, 2, -1)


def test_penalties_are_paid_for_keys_and_steps():
    env = corridor("@k.C.kC", key_penalty=0.25, step_penalty=0.125)
    rewards, _ = play(env, "right right right right right")
    assert rewards == [-0.375, -0.125, -0.125, -0.125, 0.875]


# The key is taken and its chest opened in one step; the original forgets the key's penalty.
@pytest.mark.parametrize("strict, reward", [(True, 1.0), (False, 0.75)])
def test_a_chest_overwrites_a_keys_penalty_in_the_original_alone(strict, reward):
    env = corridor("@Ck...C", key_penalty=0.25, strict=strict)
    s = env.states[0]
    with changed(env) as new:
        new.x, new.vx = 1.6, 0.3  # the key is the later object, which is first
    assert play(env, "right")[0] == [reward]
    assert (s.taken, s.opened) == (1, 1)


@pytest.mark.parametrize("strict, reward", [(True, 1.0), (False, 2.0)])
def test_two_chests_at_once_are_worth_one_in_the_original_alone(strict, reward):
    env = corridor("@kkC.C.", strict=strict)
    s = env.states[0]
    play(env, "right right right")
    assert s.taken == 2
    with changed(env) as new:
        new.x, new.vx = 4.5, 0
        new.object_x[2:4] = (
            3.9,
            5.1,
        )  # nearer than two cells' middles: in a room both are at corners
    assert play(env, "stay") == ([reward], True)


def test_the_last_step_of_an_episode_truncates_it():
    env = corridor("@.k...C", time_limit=2)
    _, _, terminated, truncated, _ = [env.step(np.array([4])) for _ in range(2)][-1]
    assert (terminated[0], truncated[0]) == (False, True)


@pytest.mark.parametrize("inventory, cells", [("upper-right", (6, 6)), ("upper-left", (0, 6)),
                                              ("lower-right", (6, 0)), ("lower-left", (0, 0)),
                                              ("hidden", (6, 6))])  # fmt: skip
def test_steps_at_the_inventory_are_counted_while_a_key_is_in_hand(inventory, cells):
    env = corridor("@k..C..", inventory=inventory)
    s = env.states[0]
    with changed(env) as new:
        new.cell[:7, :7] = 0
    for x, y in [(0, 0), (0, 6), (6, 0), (6, 6)]:
        before = int(s.at_inventory)
        with changed(env) as new:
            new.taken, new.gone[0] = 1, 0
            new.x, new.y, new.vx, new.vy = x + 0.5, y + 0.5, 0, 0
        play(env, "stay")
        assert s.at_inventory - before == ((x, y) == cells)
        with changed(env) as new:
            new.taken, new.gone[0], new.x, new.y = 0, -1, x + 0.5, y + 0.5
        play(env, "stay")
        assert s.at_inventory - before == ((x, y) == cells)


@pytest.mark.parametrize(
    "knobs, message",
    [
        ({"world": 25}, "from 5 to 23"),
        ({"largest": 15}, "must be odd, in order"),
        ({"smallest": 6}, "must be odd, in order"),
        ({"keys": 0}, "0 keys and 1 chests; at least 1"),
        ({"fewest": 2, "most": 1}, r"in order, or both 0; got \(2, 1\)"),
        ({"fewest": 0, "most": 3}, "or both 0"),
        ({"keys": 5, "chests": 5}, "up to 60 keys and chests, 6 groups of 5 \\+ 5; at most 36"),
        ({"keys": 5, "chests": 4, "most": 1, "fewest": 1}, "certainly has room for 8"),
        ({"key_penalty": float("nan")}, "key_penalty must be a finite number; got nan"),
        ({"step_penalty": 1e9}, r"step_penalty must be a finite number from -1e\+06 to 1e\+06"),
        ({"inventory": "middle"}, "unknown inventory 'middle'; there are: upper-right"),
        ({"window": 99}, "from 0 to 26"),
        ({"background": 9}, "from 0 to 8"),
        ({"shifted": SEVEN, "shift_probability": 0.1}, "another world or window"),
    ],
)
def test_bad_knobs_are_explained(knobs, message):
    with pytest.raises(ValueError, match=message):
        Keys(about="", **knobs)


@pytest.mark.parametrize(
    "field, value",
    [
        ("world", 9), ("window", 8), ("cell", 2), ("x", -1), ("x", np.nan), ("y", 12.9),
        ("vx", 2), ("vy", np.nan), ("facing", 9), ("objects", 37), ("what", 0), ("what", 7),
        ("object_x", 13), ("object_y", np.nan), ("gone", 5), ("had", -1), ("keys", 9),
        ("chests", 0), ("taken", 1), ("opened", 1), ("inventory", 5), ("background", 9),
        ("background_offset", 2), ("key_penalty", np.inf), ("step_penalty", np.nan),
        ("mt_next", 624), ("first_key", 5),
    ],
)  # fmt: skip
def test_impossible_states_never_reach_compiled_code(field, value):
    env = GameVectorEnv("keys", "many-keys", 2)
    env.reset(seed=0)
    states = env.states.copy()
    states[field][1] = value
    with pytest.raises(ValueError, match="invalid for this variant"):
        env.set_state(states)


def test_a_thief_in_a_wall_never_reaches_compiled_code():
    env = GameVectorEnv("keys", "many-keys")
    env.reset(seed=0)
    states = env.states.copy()
    states["cell"][0][int(states["y"][0]), int(states["x"][0])] = 1
    with pytest.raises(ValueError, match="place of the thief"):
        env.set_state(states)


@pytest.mark.parametrize(
    "looks, message",
    [
        ({"twister": [1]}, r"twister must be .*; got \[1\]"),
        ({"twister": [-1, 0]}, "from 0 to"),
        ({"twister": [1, 700]}, "draws from 0 to 623"),
        ({"twister": [1.5, 2]}, "twister"),
        ({"background": 12}, "background"),
    ],
)
def test_bad_looks_are_explained(looks, message):
    level = Level.from_text(GAME, SEVEN, CORRIDOR)
    with pytest.raises(ValueError, match=message):
        replace(level, looks=looks).state()
