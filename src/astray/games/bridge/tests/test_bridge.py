"""The lava bridge, on rooms drawn in text."""

import numpy as np
import pytest

from astray.envs.vector import GameVectorEnv
from helpers.scenes import play, room, scene, walk


def test_lava_ends_the_level_and_so_does_the_goal():
    env = scene("bridge", room(8, "@~.G"))
    assert play(env, "right") == ([-1.0], True) and env.states[0].burnt == 1
    env = scene("bridge", room(8, "@G"))
    assert play(env, "right") == ([1.0], True) and env.states[0].arrived == 1


@pytest.mark.parametrize("variant, gap", [("middle", {3, 4}), ("up", {5, 6}), ("down", {1, 2})])
def test_the_gap_is_where_the_variant_says_and_scripts_find_it(variant, gap):
    env = GameVectorEnv("bridge", variant, 1, autoreset_mode="Disabled")
    for level in range(10):
        env.reset(seed=0, options={"level": level})
        lava = env.states[0].cell == 2
        assert set(np.flatnonzero(~lava.any(1)).tolist()) == gap and lava.sum() == 12
        walk(env, "goal")
        assert env.states[0].arrived > 0 and env.states[0].crossed > 0
