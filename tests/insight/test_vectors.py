"""Vectors between sets of states, and what steering by them does, beside the same by hand."""

from functools import partial

import numpy as np
import pytest

from astray import games, load_agent
from astray.acting import initial_states
from astray.analysis.critic import observe, policy_and_value
from astray.insight.activations import activations, layers
from astray.insight.fields import cell_of, fields
from astray.insight.interventions import steer
from astray.insight.vectors import (
    Condition,
    Vectors,
    edit_vectors,
    effects,
    object_vectors,
    pair_vectors,
    set_vector,
)
from astray.level import Level
from astray.training import folders

MAZE = games.find("maze")
SMALL = MAZE.variant("anywhere-small")
NUMBERS = range(200_000, 200_006)
LAYER = "features.relu1"


@pytest.fixture(scope="module")
def mouse():
    return load_agent(folders.find("maze-corner"))


@pytest.fixture(scope="module")
def cheese(mouse):
    return object_vectors(mouse, SMALL, NUMBERS, LAYER)


def given(mouse, states):
    return activations(mouse, observe(mouse, SMALL, states), [LAYER])[LAYER]


def test_a_cheese_vector_is_with_less_without(mouse, cheese):
    states = initial_states("maze", SMALL, NUMBERS)
    without = [Level.of(MAZE, SMALL, s).removed("goal").state(solvable=False) for s in states]
    expected = given(mouse, states) - given(mouse, np.array(without, MAZE.state))
    assert (cheese.each == expected).all() and abs(expected).max() > 0.01
    assert cheese.mean == pytest.approx(expected.mean(0))


def test_a_vector_between_two_edits_is_with_the_corner_open_less_walled_up(mouse):
    def filled(char, level):
        (x, y), cells = cell_of(level, "corner"), level.cells.copy()  # pyrefly: ignore
        cells[y, x] = MAZE.editing.LEGEND[char]
        return Level(MAZE, SMALL, cells, level.agent, level.looks)

    closed, opened = (partial(filled, char) for char in "#.")
    level = Level.of(MAZE, SMALL, initial_states("maze", SMALL, [200_003])[0])
    states = [edit(level).state(solvable=False) for edit in (opened, closed)]
    one, other = given(mouse, np.array(states, MAZE.state))
    found = edit_vectors(mouse, SMALL, [200_003], LAYER, closed, opened)
    assert (found.each[0] == one - other).all()


def test_the_vector_between_two_sets_is_that_of_their_means(mouse):
    states = initial_states("maze", SMALL, NUMBERS)
    found = set_vector(mouse, SMALL, LAYER, states[:5], states[5:])
    expected = given(mouse, states[:5]).mean(0) - given(mouse, states[5:]).mean(0)
    assert found.each.shape == (1, 256) and found.mean == pytest.approx(expected, abs=1e-6)
    with pytest.raises(ValueError, match=r"states must be pairs; got \(5,\) and \(1,\)"):
        pair_vectors(mouse, SMALL, LAYER, states[:5], states[5:])


def test_norms_cosines_and_random_controls():
    each = np.array([[3.0, 4.0], [0.0, 2.0], [-6.0, -8.0]], np.float32)
    vectors = Vectors("layer", each)
    assert vectors.norms.tolist() == [5, 2, 10]
    assert vectors.cosines == pytest.approx(
        np.array([[1, 0.8, -1], [0.8, 1, -0.8], [-1, -0.8, 1]]), abs=1e-6
    )
    assert vectors.alike() == pytest.approx((0.8 - 1 - 0.8) / 3)
    random = vectors.random(3)
    assert random.norms == pytest.approx(vectors.norms)
    assert (random.each == vectors.random(3).each).all()
    assert (random.each != vectors.random(4).each).any()


def test_random_directions_are_equally_likely():
    many = Vectors("layer", np.ones((4000, 3), np.float32)).random(0)
    assert abs(many.each.mean(0)).max() < 0.06
    assert many.each.var(0) == pytest.approx(1, abs=0.08)


def test_effects_are_what_fields_say(mouse, cheese):
    conditions = {
        "plain": Condition(),
        "own": Condition([cheese], -2.0),
        "mean": Condition([cheese], -2.0, own=False),
        "without": Condition(edit=lambda level: level.removed("goal")),
    }
    rows = effects(mouse, SMALL, NUMBERS, "cheese", conditions, places=100)
    states = initial_states("maze", SMALL, NUMBERS)
    level = Level.of(MAZE, SMALL, states[4])
    to = cell_of(level, "cheese")

    def expected(changed, vector=None):
        if vector is None:
            (field,) = fields(mouse, SMALL, {"one": changed})
        else:
            with steer(mouse, {LAYER: vector}, -2.0):
                (field,) = fields(mouse, SMALL, {"one": changed})
        return np.nanmean(field.towards(to)), field.towards(to)[field.places.number[level.agent]]

    gone = level.removed("goal")
    for name, (mean, start) in {
        "plain": expected(level),
        "own": expected(level, cheese.each[4]),
        "mean": expected(level, cheese.mean),
        "without": expected(gone),
    }.items():
        row = rows.filter(condition=name, level=4).row(0, named=True)
        assert row["towards"] == pytest.approx(mean), name
        assert row["start"] == pytest.approx(start), name
    assert rows["towards"].n_unique() > len(NUMBERS)


def test_vectors_of_one_layer_add_up(mouse, cheese):
    other = cheese.random(5)
    both = Vectors(LAYER, cheese.each + other.each)
    conditions = {"apart": Condition([cheese, other], 2.0), "summed": Condition([both], 2.0)}
    rows = effects(mouse, SMALL, NUMBERS, "cheese", conditions, places=4)
    apart, summed = (rows.filter(condition=name)["value"].to_numpy() for name in conditions)
    assert apart == pytest.approx(summed, abs=1e-4)


def test_fewer_places_are_drawn_from_all_and_the_beginning_is_first(mouse):
    few = effects(mouse, SMALL, NUMBERS, "cheese", {"plain": Condition()}, places=1)
    assert (few["towards"] == few["start"]).all() and (few["places"] == 1).all()
    some = effects(mouse, SMALL, NUMBERS, "cheese", {"plain": Condition()}, places=5)
    assert some["start"].to_list() == few["start"].to_list()
    again = effects(mouse, SMALL, NUMBERS, "cheese", {"plain": Condition()}, places=5, seed=1)
    assert (some["towards"] != again["towards"]).any()


def test_the_level_of_no_goal_is_left_out_and_none_is_told(mouse):
    level = Level.of(MAZE, SMALL, initial_states("maze", SMALL, [200_003])[0])
    both = {"with": level, "without": level.removed("goal")}
    rows = effects(mouse, SMALL, both, "cheese", {"plain": Condition()})
    assert rows["level"].to_list() == [0]
    with pytest.raises(ValueError, match="no level has a way from its beginning to the goal"):
        effects(mouse, SMALL, {"none": both["without"]}, "cheese", {"plain": Condition()})


def test_steering_by_its_vector_changes_value_and_policy(mouse, cheese):
    states = initial_states("maze", SMALL, NUMBERS)
    shown = observe(mouse, SMALL, states)
    before = policy_and_value(mouse, shown)
    with steer(mouse, {LAYER: cheese.mean}, 5.0):
        after = policy_and_value(mouse, shown)
    assert abs(after[0] - before[0]).max() > 0.01 and layers(mouse)[LAYER] == (256,)
