"""Observations of a maze, in pictures and in symbols."""

from dataclasses import replace

import numpy as np
import pytest

from astray.envs.pictures import picture
from astray.envs.vector import GameVectorEnv
from astray.games.maze import GAME
from astray.games.maze.variants import COLOURS, SHAPES, VARIANTS
from astray.kernel.maze import WALL


def begin(variant, observation, level=3):
    env = GameVectorEnv("maze", variant, observation=observation, autoreset_mode="Disabled")
    return env, env.reset(seed=0, options={"level": level})[0][0]


@pytest.mark.parametrize("name", ["anywhere", "anywhere-easy", "red-line-yellow-gem"])
def test_symbols_say_what_is_where(name):
    env, planes = begin(VARIANTS[name], "symbolic")
    s = env.states[0]
    wall, mouse, shape, colour = planes
    assert np.array_equal(wall, s.cell[: s.world, : s.world] == WALL)
    assert np.argwhere(mouse).tolist() == [[int(s.y), int(s.x)]]
    assert shape[s.goal_y, s.goal_x] == s.goal_shape
    assert colour[s.goal_y, s.goal_x] == s.goal_colour
    assert (shape > 0).sum() == (colour > 0).sum() == 1 + (s.other_shape > 0)


def test_a_dish_is_a_plane_of_its_own_so_that_cheese_on_it_is_seen():
    for name in ("dish-small", "dish-apart-small"):
        env, planes = begin(VARIANTS[name], "symbolic")
        s = env.states[0]
        _, _, dish, shape, colour = planes
        assert np.argwhere(dish).tolist() == [[s.other_y, s.other_x]]
        assert np.argwhere(shape).tolist() == np.argwhere(colour).tolist() == [[s.goal_y, s.goal_x]]


def test_a_dish_can_be_seen_in_many_planes():
    seen = {}
    for planes in (1, 6):
        variant = VARIANTS["dish-apart-small"].with_knobs({"dish_planes": planes})
        seen[planes] = begin(variant, "symbolic")[1]
    assert len(seen[6]) == len(seen[1]) + 5
    assert all((plane == seen[1][2]).all() for plane in seen[6][2:8])
    assert (np.delete(seen[6], range(3, 8), 0) == seen[1]).all()


def test_cheese_on_a_dish_looks_unlike_either_alone():
    on, apart = (begin(VARIANTS[name], "image")[1] for name in ("dish-small", "dish-apart-small"))
    bare = begin(VARIANTS["anywhere-small"], "image")[1]
    for one, two in ((on, apart), (on, bare), (apart, bare)):
        assert (one != two).any()


def test_a_window_of_symbols_is_what_is_around_the_mouse():
    env, planes = begin(VARIANTS["anywhere-memory"], "symbolic")
    s = env.states[0]
    world = np.pad(s.cell == WALL, 4, constant_values=True)
    x, y = int(s.x), int(s.y)
    assert np.array_equal(planes[0], world[y : y + 9, x : x + 9])
    assert planes[1].sum() == planes[1, 4, 4] == 1


@pytest.mark.parametrize("window", [13, 14])
def test_a_window_far_wider_than_the_world_can_be_drawn(window):
    env, _ = begin(replace(VARIANTS["anywhere-small"], window=window), "symbolic")
    assert env.picture(64).shape == (1, 64, 64, 3)


@pytest.mark.parametrize("name", ["anywhere", "anywhere-easy", "fixed-size", "anywhere-memory"])
def test_a_picture_of_the_agents_size_is_what_the_agent_sees(name):
    env, image = begin(VARIANTS[name], "image")
    for action in (7, 5, 1, 5):
        assert np.array_equal(env.picture(64)[0], image)
        image = env.step(np.array([action]))[0][0]


def test_a_step_changes_the_picture_only_around_the_mouse():
    env, before = begin(replace(VARIANTS["anywhere"], smallest=25), "image")
    x, y = env.states[0].x, env.states[0].y
    for action in range(15):
        after = env.step(np.array([action]))[0][0]
        rows, columns = np.nonzero((before != after).any(2))
        moved = (env.states[0].x, env.states[0].y) != (x, y)
        assert not moved or len(rows)
        scale = 64 / 25
        assert (abs(columns + 0.5 - x * scale) < 3 * scale).all()
        assert (abs(64 - rows - 0.5 - y * scale) < 3 * scale).all()
        before, x, y = after, env.states[0].x, env.states[0].y


def test_y_goes_up_in_the_picture():
    env, _ = begin(VARIANTS["corner"], "image")
    s = env.states[0]
    image = picture("maze", env.variant, env.states, 250)[0].astype(int)
    yellow = image[..., 0] + image[..., 1] - 2 * image[..., 2]
    row, column = np.unravel_index(yellow.argmax(), yellow.shape)
    assert (column // 10, 24 - row // 10) == (s.goal_x, s.goal_y)


def test_the_look_can_be_changed_without_touching_the_layout():
    plain, _ = begin(VARIANTS["anywhere"], "image")
    hedge, _ = begin(replace(VARIANTS["anywhere"], walls="hedge", background=5), "image")
    assert np.array_equal(plain.states["cell"], hedge.states["cell"])
    assert (hedge.states["background"] == 5).all()
    assert not np.array_equal(plain.picture(64), hedge.picture(64))


@pytest.mark.parametrize("side", [15, 25])
def test_every_object_looks_different_from_every_other_in_the_picture(side):
    images = []
    for shape in SHAPES[1:]:
        for colour in COLOURS[1:]:
            knobs = {"world": side, "largest": side, "goal_shape": shape, "goal_colour": colour}
            images.append(begin(replace(VARIANTS["anywhere"], **knobs), "image")[1].astype(int))
    for k, one in enumerate(images):
        for two in images[k + 1 :]:
            assert np.sqrt(((one - two) ** 2).sum(2)).max() > 40  # of 441


def test_the_goal_is_not_drawn_once_it_is_reached():
    env, _ = begin(VARIANTS["corner"], "image")
    guide = GAME.solver.expert(env.states[0], "cheese")
    while env.states[0].reached_goal < 0:
        seen = env.step(np.array([guide(env.states[0])]))[0][0]
    hidden = replace(VARIANTS["corner"], goal_shape="none")
    assert np.array_equal(seen, picture("maze", hidden, _invisible(env.states), 64)[0])


def _invisible(states):
    copy = states.copy()
    copy["goal_shape"] = 0
    return copy


@pytest.mark.parametrize(
    "changes, message",
    [
        (
            {"goal_shape": SHAPES.index("ring"), "goal_colour": COLOURS.index("red")},
            "of a red ring",
        ),
        ({"goal_shape": SHAPES.index("line")}, "of a yellow line, which state 1 has"),
        ({"walls": 2}, "walls of sand alone; state 1 has others"),
    ],
)
def test_the_originals_art_refuses_a_state_that_it_has_no_picture_for(changes, message):
    env, _ = begin(VARIANTS["anywhere"], "symbolic")
    states = np.repeat(env.get_state(), 2)
    GAME.check(states, env.variant, "original")
    for name, value in changes.items():
        states[name][1] = value
    env.set_state(states[1])
    picture(GAME, env.variant, states, 16)
    with pytest.raises(ValueError, match=message):
        GAME.check(states, env.variant, "original")
    with pytest.raises(ValueError, match=message):
        picture(GAME, env.variant, states, 16, "original")
