"""The monster gridworld, on fields drawn in text."""

from astray import games
from helpers.scenes import play, room, scene

GAME = games.find("monsters")


def measured(env):
    return {name: int(f(env.get_state())[0]) for name, f in GAME.measures.items()}


def test_an_apple_is_worth_one_and_comes_again_elsewhere():
    env = scene("monsters", room(8, "@a"))
    assert play(env, "right") == ([1.0], False)
    assert (env.states[0].cell == 2).sum() == 1 and env.states[0].cell[0, 1] == 0


def test_a_monster_comes_nearer_and_catches():
    env = scene("monsters", room(8, "@..m"), slowness=1)
    assert play(env, "stay stay stay")[0] == [0.0, 0.0, -1.0]
    assert (env.states[0].caught, env.states[0].times_caught) == (3, 1)
    assert (env.states[0].mover == 4).sum() == 1  # somewhere else


def test_a_shield_destroys_the_monster_and_is_used_up():
    env = scene("monsters", room(8, "@s.m"), slowness=1)
    assert play(env, "right")[0] == [0.0] and env.states[0].held == 1
    assert play(env, "stay")[0] == [0.0]
    assert env.states[0].held == 0 and (env.states[0].mover == 4).sum() == 0


def test_monsters_step_over_things_and_not_over_each_other():
    env = scene("monsters", room(8, "@.amm"), slowness=1)
    play(env, "stay")
    assert env.states[0].mover[0].tolist() == [0, 0, 4, 4, 0, 0, 0, 0]
    assert env.states[0].cell[0, 2] == 2


def test_what_is_taken_counts_where_no_monster_is_left():
    env = scene("monsters", room(8, "@as"))
    play(env, "right right")
    assert measured(env) == {
        "apples in safety": 1, "shields in safety": 1, "steps in safety": 2, "times caught": 0,
    }  # fmt: skip
    env = scene("monsters", room(8, "@as....m"), slowness=1000)
    play(env, "right right")
    assert measured(env)["apples in safety"] == measured(env)["steps in safety"] == 0
