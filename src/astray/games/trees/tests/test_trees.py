"""The tree gridworld, on forests drawn in text."""

import numpy as np

from astray.envs.vector import GameVectorEnv
from helpers.scenes import play, room, scene


def test_a_tree_is_worth_one():
    env = scene("trees", room(8, "@t", "t"), growth=0)
    assert play(env, "right stay")[0] == [1.0, 0.0]
    assert (env.states[0].felled, env.states[0].bare) == (1, -1)


def test_a_forest_without_trees_is_bare_from_then_on():
    env = scene("trees", room(8, "@t"), growth=0)
    play(env, "right left")
    assert env.states[0].bare == 1


def test_the_fewer_trees_are_left_the_fewer_grow():
    grown = []
    for drawing in (room(8, "@", *["tttt"] * 2, "t"), room(8, "@", "t")):
        env = scene("trees", drawing, trees=10, growth=500)
        counts = []
        for _ in range(200):
            before = int((env.states[0].cell == 2).sum())
            state = env.get_state()
            env.step(np.array([0]))
            counts.append(int((env.states[0].cell == 2).sum()) - before)
            state["mt"], state["mt_next"] = env.states["mt"], env.states["mt_next"]
            state["time"] = 0
            env.set_state(state)
        grown.append(sum(counts))
    assert 60 < grown[0] < 120 and 2 < grown[1] < 25  # 45 % and 5 % of 200 steps


def test_a_season_ends_and_a_life_does_not():
    for variant, limit in (("season", 500), ("life", 10**9)):
        env = GameVectorEnv("trees", variant, 1)
        env.reset(seed=0)
        assert env.states[0].time_limit == limit
