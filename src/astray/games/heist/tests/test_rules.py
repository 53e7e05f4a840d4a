"""The rules of Heist, on rooms drawn in text."""

from dataclasses import replace

import numpy as np
import pytest

from astray.envs.vector import GameVectorEnv
from astray.games.heist import GAME
from astray.games.heist.variants import Heist
from astray.level import Level

SEVEN = Heist(about="", world=7, largest=7)
WALLS = "#######\n" * 3


def corridor(row, **knobs):
    """An environment in which `row` is the only one without walls."""
    variant = replace(SEVEN, **knobs)
    env = GameVectorEnv("heist", variant, observation="symbolic", autoreset_mode="Disabled")
    level = Level.from_text(GAME, variant, f"{WALLS}{row}\n{WALLS}")
    env.set_state(level.state(solvable=False))
    return env


def play(env, actions):
    """The rewards of `actions`, and whether the last ended the level."""
    rewards, terminated = [], [False]
    for name in actions.split():
        _, reward, terminated, _, _ = env.step(np.array([GAME.actions.index(name)]))
        rewards.append(float(reward[0]))
        if terminated[0]:
            break
    return rewards, bool(terminated[0])


def test_the_gem_is_worth_ten_and_ends_the_level():
    env = corridor("@.*####")
    assert play(env, "right right right") == ([0, 0, 10], True)
    assert env.states[0].reached_gem == 3


@pytest.mark.parametrize("row", ["@.Bb..*", "@.Gb..*", "@g.Bb.*"])
def test_a_door_without_its_key_stops_the_thief_where_their_boxes_touch(row):
    env = corridor(row)
    play(env, "right " * 9)
    s = env.states[0]
    assert s.x == row.upper().index("B" if "B" in row else "G") - 0.375 and s.vx == 0
    play(env, "right")
    assert (s.x % 1, s.vx, s.opened_blue, s.opened_green) == (0.625, 0, -1, -1)


def test_a_door_stops_in_both_directions_and_up_and_down():
    env = corridor("*bB.@##")
    play(env, "left " * 6)
    assert env.states[0].x == 3.375
    drawing = "\n".join(["#B#####", "#@#####", "#R#####", *["#######"] * 4])
    for way, y in (("up", 5.625), ("down", 5.375)):
        env.set_state(Level.from_text(GAME, SEVEN, drawing).state(solvable=False))
        play(env, f"{way} " * 4)
        assert (env.states[0].y, env.states[0].vy) == (y, 0)


def test_a_key_opens_every_door_of_its_colour_and_no_other():
    env = corridor("@gGGR.*")
    s = env.states[0]
    play(env, "right " * 15)
    assert s.x == 3.625 and GAME.editing.grid(s)[3].tolist() == [0, 0, 0, 0, 7, 0, 8]
    assert 0 < s.took_green < s.opened_green and s.opened_red == -1
    assert s.all_keys == s.took_green and s.hand == 0b010


@pytest.mark.parametrize("row, x, opens", [("@bB...*", 1.6255, False), ("*...Bb@", 5.3745, True)])
def test_what_was_made_last_is_met_first_so_a_key_may_be_too_late_for_its_door(row, x, opens):
    env = corridor(row)
    states = env.get_state()
    states["x"] = x  # as near to a locked door as one can be: both are touched
    env.set_state(states)
    play(env, "stay")
    s = env.states[0]
    assert (s.took_blue, s.opened_blue) == (1, 1 if opens else -1)
    play(env, "stay")
    assert s.opened_blue == (1 if opens else 2)


def test_events_are_told_once_with_their_step():
    env = corridor("@bBrR.*")
    play(env, "right " * 20)
    s = env.states[0]
    order = [s.took_blue, s.opened_blue, s.took_red, s.opened_red, s.reached_gem]
    assert order == sorted(set(order)) and s.all_keys == s.took_red and s.took_green == -1


def test_the_last_step_of_an_episode_truncates_it():
    env = corridor("@.*####", time_limit=2)
    _, _, terminated, truncated, _ = [env.step(np.array([4])) for _ in range(2)][-1]
    assert (terminated[0], truncated[0]) == (False, True)


@pytest.mark.parametrize(
    "knobs, message",
    [
        ({"world": 25}, "from 5 to 23"),
        ({"largest": 15}, "must be odd, in order"),
        ({"window": 99}, "from 0 to 26"),
        ({"gem": "middle"}, "unknown gem 'middle'; there are: last, first"),
        ({"background": 9}, "from 0 to 8"),
        ({"shifted": SEVEN, "shift_probability": 0.1}, "another world or window"),
    ],
)
def test_bad_knobs_are_explained(knobs, message):
    with pytest.raises(ValueError, match=message):
        Heist(about="", **knobs)


@pytest.mark.parametrize(
    "field, value",
    [
        ("world", 9), ("window", 8), ("cell", 2), ("x", -1), ("y", np.nan), ("vx", 2),
        ("facing", 9), ("objects", 17), ("what", 9), ("what", 0), ("object_x", 13),
        ("gone", 5), ("gone", 0), ("keys", 8), ("keys", 0), ("hand", 8), ("background", 9),
        ("background_offset", 2), ("took_red", 5),
    ],
)  # fmt: skip
def test_impossible_states_never_reach_compiled_code(field, value):
    env = GameVectorEnv("heist", "hard", 2)
    env.reset(seed=0, options={"level": [1, 2]})
    states = env.states.copy()
    states[field][1] = value
    with pytest.raises(ValueError, match="invalid for this variant"):
        env.set_state(states)


def test_a_thief_in_a_locked_door_never_reaches_compiled_code():
    env = corridor("@.Bb..*")
    states = env.get_state()
    states["x"] = 1.7
    with pytest.raises(ValueError, match="place of the thief"):
        env.set_state(states)


@pytest.mark.parametrize(
    "looks, message",
    [({"hand": ["pink"]}, "pink"), ({"twister": [1]}, "twister must be"), ({"hand": 3}, "hand")],
)
def test_bad_looks_are_explained(looks, message):
    level = Level.from_text(GAME, SEVEN, f"{WALLS}@.bB..*\n{WALLS}")
    with pytest.raises(ValueError, match=message):
        replace(level, looks=looks).state()
