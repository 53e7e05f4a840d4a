"""Goal-directedness of agents in levels: which cell a policy is directed to."""

import numpy as np
import pytest

import astray
from astray import games
from astray.insight.directedness import directedness, process_of
from astray.insight.fields import Field, fields

MAZE = games.find("maze")
VARIANT = MAZE.variant("anywhere-small")
LEVEL = 200_007  # the mouse begins in (2, 1): down and right is the cheese, up the corner
GOALS = {"cheese": (5, 0), "corner": (6, 6)}


@pytest.fixture(scope="module")
def field():
    (found,) = fields(astray.load_agent("maze-corner"), VARIANT, [LEVEL])
    return found


def changed(field, policy):
    return Field(field.places, policy, field.value)


def test_cheese_ends_the_episode_and_actions_of_one_effect_are_one(field):
    process, states = process_of(field.places)
    assert not process.possible[states[GOALS["cheese"]]].any()
    begin = states[2, 1]
    assert process.start == begin and process.possible[begin].sum() == 3  # up, down, or stay
    leads = set(process.after[begin][process.possible[begin]].tolist())
    assert leads == {begin, states[2, 2], states[2, 0]}


def test_a_walk_to_the_corner_is_directed_to_it_and_not_to_the_cheese(field):
    taken = field.places.advancing(GOALS["corner"])
    taken |= ~taken.any(1, keepdims=True)
    measured = directedness(changed(field, taken / taken.sum(1, keepdims=True)), GOALS)
    assert measured["corner"].fraction == pytest.approx(1, abs=1e-6)
    assert measured["cheese"].nats == 0


def test_random_actions_are_directed_to_nothing_and_the_mouse_to_its_corner(field):
    alike = np.full(field.policy.shape, 1 / field.policy.shape[1])
    assert all(one.fraction < 0.1 for one in directedness(changed(field, alike), GOALS).values())
    mouse = directedness(field, GOALS)
    assert mouse["corner"].fraction > 0.5 > mouse["cheese"].fraction


def test_a_wall_is_no_goal(field):
    with pytest.raises(ValueError, match=r"no action leads to the cell of wall, \(3, 1\)"):
        directedness(field, {"wall": (3, 1)})
