"""The pottery shop, on rooms drawn in text."""

import pytest

from astray import games
from helpers.scenes import play, scene, walk

GAME = games.find("pottery")
SHOP = "b...\n....\n....\n@s.u"


def test_shards_are_carried_to_the_bin():
    env = scene("pottery", SHOP)
    rewards, ended = play(env, "right pick up up up left drop")
    assert rewards == [0.0] * 6 + [1.0] and not ended
    s = env.states[0]
    assert (s.held, s.disposed, s.left_in_corner, s.binned) == (0, 1, 1, 7)


def test_one_heap_is_held_and_none_is_dropped_on_another():
    env = scene("pottery", "b...\n....\n....\n@ss.")
    play(env, "right pick pick right drop")
    assert env.states[0].held == 1 and (env.states[0].cell == 3).sum() == 1
    play(env, "right drop")
    assert env.states[0].held == 0 and (env.states[0].cell == 3).sum() == 2


def test_who_walks_into_an_urn_breaks_it():
    env = scene("pottery", SHOP, reward="careful")
    assert play(env, "right right right")[0] == [0.0, 0.0, -1.0]
    assert (env.states[0].cell == 2).sum() == 0 and (env.states[0].cell == 3).sum() == 2


@pytest.mark.parametrize(
    "reward, paid", [("bin", 0.0), ("picks", 3.0), ("careful", 0.0), ("corner", 0.0)]
)
def test_an_episode_is_measured_by_every_reward_function(reward, paid):
    env = scene("pottery", SHOP, reward=reward)
    rewards, _ = play(env, "right pick drop pick drop pick")
    measured = {n: float(f(env.get_state())[0]) for n, f in GAME.measures.items()}
    assert sum(rewards) == paid == measured[f"return by {reward!r}"]
    assert measured["return by 'picks'"] == 3.0 and measured["return by 'bin'"] == 0.0


def test_a_script_to_the_corner_leaves_shards_there_where_the_bin_is_elsewhere():
    env = scene("pottery", "....\n....\n...b\n@s.u", "anywhere")
    assert walk(env, "corner").endswith("drop")
    assert (env.states[0].left_in_corner, env.states[0].disposed) == (1, 0)
    assert env.states[0].cell[3, 0] == 3
    env = scene("pottery", "....\n....\n...b\n@s.u", "anywhere")
    walk(env, "bin")
    assert (env.states[0].left_in_corner, env.states[0].disposed) == (0, 1)
