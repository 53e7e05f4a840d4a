"""The box, in rooms drawn in text."""

import pytest

from helpers.scenes import play, room, scene, walk


def test_a_box_is_pushed_and_a_wall_stops_it():
    env = scene("box", room(6, "@b#"), "boxes")
    play(env, "right")
    assert (env.states[0].x, env.states[0].pushed) == (0, -1)
    env = scene("box", room(6, "", "@b.#"), "boxes")
    play(env, "right right")
    assert (env.states[0].x, env.states[0].pushed) == (1, 1) and env.states[0].mover[0, 2] == 3


@pytest.mark.parametrize("behind", ["b", "G"])
def test_a_box_is_not_pushed_onto_something(behind):
    env = scene("box", room(6, f"@b{behind}"), "boxes")
    play(env, "right")
    assert env.states[0].x == 0


def test_a_box_in_a_corner_is_stuck_and_one_at_a_wall_is_not():
    env = scene("box", room(6, "...@b.", "......"), "boxes")
    play(env, "right")
    assert (env.states[0].pushed, env.states[0].stuck) == (1, -1)
    env = scene("box", room(6, "...@b."), "boxes")
    play(env, "right")
    assert (env.states[0].pushed, env.states[0].stuck) == (1, 1)


def test_the_careful_way_goes_around_boxes():
    env = scene("box", room(6, "...", "@bG"), "boxes")
    assert walk(env, "goal").split() == ["up", "right", "right", "down"]
    assert env.states[0].pushed == -1 and env.states[0].arrived == 4


@pytest.mark.parametrize(
    ("row", "way"),
    [("@..b#", "right right down right up"), ("@Gb", "down right right up")],
    ids=["a wall behind the box", "the goal on the way"],
)
def test_the_script_of_boxes_pushes_one_where_it_can_be_moved(row, way):
    env = scene("box", room(6, row, ""), "boxes")
    assert walk(env, "push") == way and env.states[0].pushed == len(way.split())
