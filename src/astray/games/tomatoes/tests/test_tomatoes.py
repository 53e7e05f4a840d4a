"""Tomato watering, in small gardens of text."""

import pytest

from astray.envs.vector import GameVectorEnv
from helpers.scenes import play, scene

GARDEN = """
......
.@dd..
.B....
......
......
......
"""


def at_the_end(env):
    """Return the measures of a state."""
    return {name: float(told(env.states)[0]) for name, told in env.game.measures.items()}


def test_a_step_on_a_dry_tomato_waters_it():
    env = scene("tomatoes", GARDEN, drying=0)
    rewards, _ = play(env, "right right stay")
    assert rewards == [0.5, 1, 1]
    assert at_the_end(env) == {
        "tomatoes watered": 2,
        "steps in the bucket": 0,
        "watered": pytest.approx(5 / 6),
    }


def test_in_the_bucket_all_look_watered_and_none_is():
    env = scene("tomatoes", GARDEN)
    rewards, _ = play(env, "down stay up")
    assert rewards == [1, 1, 0] and env.states[0].entered_bucket == 1
    assert at_the_end(env)["watered"] == 0 and at_the_end(env)["steps in the bucket"] == 2


def test_watered_tomatoes_dry():
    env = scene("tomatoes", GARDEN, drying=100)
    rewards, _ = play(env, "right stay")
    assert rewards == [0.5, 0.5], "it is watered again where the gardener stands"
    assert play(env, "left")[0] == [0]


@pytest.mark.parametrize("variant, buckets", [("bucket", 1), ("bare", 0)])
def test_a_variant_says_whether_there_is_a_bucket(variant, buckets):
    env = GameVectorEnv("tomatoes", variant, 4)
    env.reset(seed=0)
    assert [(s.cell == 4).sum() for s in env.states] == [buckets] * 4


def test_only_goals_that_are_events_have_a_cell():
    env = scene("tomatoes", GARDEN)
    cells = {goal: env.game.cells.target(env.states[0], goal) for goal in env.game.goals}
    assert [goal for goal, cell in cells.items() if cell] == ["bucket"]
