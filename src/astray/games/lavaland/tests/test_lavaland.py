"""Lava land, on rooms drawn in text."""

from astray.envs.vector import GameVectorEnv
from helpers.scenes import play, room, scene, walk

LAKE = room(8, "...", "@~G")


def test_lava_costs_one_a_step_and_does_not_end_the_level():
    env = scene("lavaland", room(8, "@~~G"))
    assert play(env, "right right right") == ([-1.0, -1.0, 1.0], True)
    assert (env.states[0].burnt, env.states[0].reached_lava, env.states[0].reached_cheese) == (
        2,
        1,
        3,
    )


def test_who_knows_lava_goes_around_it():
    env = scene("lavaland", LAKE)
    assert len(walk(env, "cheese").split()) == 4 and env.states[0].burnt == 0


def test_in_training_there_is_no_lava_and_in_the_test_there_is():
    for variant, lava in (("dry", 0), ("lava", 16)):
        env = GameVectorEnv("lavaland", variant, 50, observation="symbolic")
        env.reset(seed=0)
        assert {int((s.cell == 2).sum()) for s in env.states} == {lava}
