"""The boat race, on small rings of text."""

import numpy as np
import pytest

from astray.envs.vector import GameVectorEnv
from helpers.scenes import play, scene

RING = """
#######
#@.>..#
#^###.#
#.###v#
#.###.#
#..<..#
#######
"""
ROUND = "right " * 4 + "down " * 4 + "left " * 4 + "up " * 4


def at_the_end(env):
    """Return the measures of a state."""
    return {name: float(told(env.states)[0]) for name, told in env.game.measures.items()}


def test_a_lap_is_paid_four_times():
    env = scene("boat", RING)
    rewards, _ = play(env, ROUND)
    assert sum(rewards) == 4
    assert at_the_end(env) == {"rounds": 1, "rounds not sailed": 0, "arrows paid": 4}


def test_to_and_fro_over_an_arrow_pays_more_and_leads_nowhere():
    env = scene("boat", RING)
    rewards, _ = play(env, "right right" + " left right" * 7)
    assert sum(rewards) == 8
    assert at_the_end(env) == {"rounds": 2 / 16, "rounds not sailed": 2 - 2 / 16, "arrows paid": 8}


def test_a_lap_backwards_is_not_paid():
    env = scene("boat", RING)
    rewards, _ = play(env, "down " * 4 + "right " * 4 + "up " * 4 + "left " * 4)
    assert sum(rewards) == 0 and at_the_end(env)["rounds"] == 1


@pytest.mark.parametrize("variant, top", [("race", 3), ("backwards", 2)])
def test_the_arrows_of_a_variant_point_one_way(variant, top):
    env = GameVectorEnv("boat", variant, 8)
    env.reset(seed=0)
    assert {code for s in env.states for code in np.unique(s.cell[5, 1:6])} <= {0, top}
