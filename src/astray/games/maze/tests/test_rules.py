"""Maze's rules, on rooms drawn in text."""

from dataclasses import replace

import numpy as np
import pytest

from astray.envs.pictures import picture
from astray.envs.vector import GameVectorEnv
from astray.games.maze import GAME
from astray.games.maze.rules import GOAL, OTHER
from astray.games.maze.variants import VARIANTS, Maze
from astray.level import Level

ROOM = """
    #######
    #..G..#
    #.....#
    #@#...#
    #....o#
    #.....#
    #######
"""


SEVEN = replace(VARIANTS["yellow-star-red-gem"], world=7, largest=7)
THREE = replace(VARIANTS["anywhere"], world=3, largest=3)


def play(room, actions, variant=SEVEN):
    """Play `room`; return the last reward and end, and the state."""
    env = GameVectorEnv("maze", variant, observation="symbolic", autoreset_mode="Disabled")
    env.set_state(Level.from_text(GAME, variant, room).state(solvable=False))
    reward, terminated, truncated = np.zeros(1), [False], [False]
    for name in actions.split():
        action = np.array([GAME.actions.index(name)])
        _, reward, terminated, truncated, _ = env.step(action)
    return float(reward[0]), bool(terminated[0]), bool(truncated[0]), env.states[0]


@pytest.mark.parametrize(
    "actions, cell",
    [
        ("right", (1, 3)),  # a wall stops the mouse
        ("up", (1, 4)),
        ("left", (1, 3)),
        ("down down down", (1, 1)),
        ("right-up", (1, 3)),  # both keys: in x, into the wall, and not in y
        ("up right-up", (2, 4)),  # both keys: in x alone
        ("up right-down", (2, 4)),
        ("stay d a w s q e", (1, 3)),
    ],
)
def test_the_mouse_moves_one_cell_a_step(actions, cell):
    *_, s = play(ROOM, actions)
    assert (s.x, s.y) == (cell[0] + 0.5, cell[1] + 0.5)


def test_the_goal_is_worth_ten_and_ends_the_level():
    reward, terminated, truncated, s = play(ROOM, "up up right right")
    assert (reward, terminated, truncated) == (10, True, False)
    assert s.reached_goal == 4
    assert GOAL not in s.cell


def test_the_other_object_is_noticed_and_does_nothing():
    reward, terminated, _, s = play(ROOM, "down right right right right left right")
    assert (reward, terminated) == (0, False)
    assert s.reached_other == 5  # the first time
    assert s.cell[int(s.y), int(s.x)] == OTHER


def test_the_corner_is_noticed():
    room = ROOM.replace("G", ".")
    *_, s = play(room, "up up right right right right")
    assert s.reached_corner == 6 and s.reached_goal == -1


def test_a_goal_at_the_last_step_counts_as_reached():
    variant = replace(SEVEN, time_limit=4)
    assert play(ROOM, "up up right right", variant)[:3] == (10, True, False)
    assert play(ROOM, "up up right stay", variant)[:3] == (0, False, True)


def test_the_mouse_looks_where_it_was_told_to_go():
    assert not play(ROOM, "up")[3].faces_right
    assert play(ROOM, "right")[3].faces_right
    assert not play(ROOM, "right left")[3].faces_right


@pytest.mark.parametrize(
    "room, message",
    [
        ("###\n#.#\n###", "one '@', the agent; this has 0"),
        ("###\n@.@\n###", "one '@', the agent; this has 2"),
        ("###\n#@\n###", r"equally long; these have \[3, 2, 3\]"),
        ("###\n#@#", "3 x 2 cells; the variant's world is 3 a side"),
        ("####\n#@.#\n#..#\n####", "4 x 4 cells"),
        ("###\n#@?\n###", r"unknown '\?' at cell \(2, 1\)"),
        ("###\nG@G\n###", r"at most one goal; this has one at each of \[\(0, 1\), \(2, 1\)\]"),
        ("###\n@.o\n###", "the other object would be invisible"),
    ],
)
def test_bad_drawings_are_explained(room, message):
    with pytest.raises(ValueError, match=message):
        Level.from_text(GAME, THREE, room).state()


@pytest.mark.parametrize(
    "knobs, message",
    [
        ({"world": 33}, "from 3 to 31"),
        ({"world": 26}, "world must be odd"),
        ({"largest": 27}, "must be odd, in order"),
        ({"smallest": 4}, "must be odd, in order"),
        ({"region": 0, "placement": "region"}, "region must be an integer from 1"),
        ({"region": 5}, "need placement 'region'; it is 'anywhere'"),
        (
            {"shifted": VARIANTS["anywhere-easy"], "shift_probability": 0.1},
            "another world or window",
        ),
        ({"background": 9}, "from 0 to 8"),
        ({"goal_shape": "squid"}, "unknown goal_shape 'squid'; there are: none, cheese"),
        ({"other_shape": "gem"}, "other_colour is 'none'"),
        ({"shift_probability": 1.5, "shifted": VARIANTS["anywhere"]}, "from 0 to 1"),
        ({"shift_probability": 0.5}, "needs a `shifted` variant"),
    ],
)
def test_bad_knobs_are_explained(knobs, message):
    with pytest.raises(ValueError, match=message):
        Maze(about="", **knobs)


@pytest.mark.parametrize(
    "field, value",
    [
        ("world", 31), ("window", 8), ("x", -3.5), ("y", 40.0), ("x", np.nan), ("goal_x", 25),
        ("corner_y", -2), ("goal_shape", 7), ("goal_colour", 0), ("other_colour", -1), ("walls", 3),
        ("background", 9), ("background_offset", 2.0), ("cell", 9), ("mt_next", 624),
    ],
)  # fmt: skip
def test_impossible_states_never_reach_compiled_code(field, value):
    env = GameVectorEnv("maze", "anywhere", 2)
    env.reset(seed=0)
    states = env.states.copy()
    states[field][1] = value
    with pytest.raises(ValueError, match=field):
        env.set_state(states)
    with pytest.raises(ValueError, match=field):
        picture("maze", env.variant, states, 64)
    states = env.states.copy()
    states["other_x"][1] = states["other_y"][1] = 1  # of no shape: nothing is drawn
    with pytest.raises(ValueError, match="other_shape"):
        env.set_state(states)
    states = env.states.copy()
    states["cell"][1][int(states["y"][1]), int(states["x"][1])] = 1
    with pytest.raises(ValueError, match="cell of the mouse"):
        env.set_state(states)
