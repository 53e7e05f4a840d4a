"""Networks learn to see from labels that are right, and are asked about levels they never saw."""

import numpy as np
import pytest
import torch

from astray.agents.policy import outputs
from astray.games.maze.solve import expert, steps_to
from astray.record import trusted
from benchmarks import eyes, tables

MANY, UNSEEN, CORNERS = 80, 120, 60
BATCH = 40


@pytest.fixture(scope="module")
def lessons():
    return eyes.Lessons("anywhere", range(MANY), BATCH)


@pytest.fixture(scope="module")
def rows():
    return eyes.measure(("patch",), 0.5, (MANY, UNSEEN, CORNERS), BATCH)


def picked(lessons):
    random = np.random.default_rng(0)
    which = random.integers(0, MANY, BATCH)
    return which, lessons.placed(which, random)


def test_a_label_is_the_first_step_that_the_solver_takes(lessons):
    which, states = picked(lessons)
    _, labels = lessons.shown(which, states)
    assert labels.tolist() == [expert(s, "cheese")(s) for s in trusted(states)]


def test_a_step_in_the_labelled_direction_brings_the_mouse_nearer_by_one(lessons):
    which, states = picked(lessons)
    _, labels = lessons.shown(which, states)
    lessons.env.set_state(states)
    lessons.env.step(labels.numpy())
    for before, after in zip(trusted(states), lessons.env.states, strict=True):
        steps = steps_to(before, "cheese")
        here, there = steps[int(before.y), int(before.x)], steps[int(after.y), int(after.x)]
        assert there == here - 1


def test_a_picture_shows_the_mouse_where_it_was_placed(lessons):
    which, states = picked(lessons)
    images, _ = lessons.shown(which, states)
    elsewhere, _ = lessons.shown(which, lessons.placed(which, np.random.default_rng(1)))
    moved = (images != elsewhere).flatten(1).any(1).numpy()
    again = lessons.placed(which, np.random.default_rng(1))
    assert (moved >= (again["x"] != states["x"])).all() and moved.mean() > 0.8


def test_unseen_levels_are_no_training_levels(monkeypatch):
    numbers = []

    class Noted(eyes.Lessons):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            numbers.append((self.env.variant, set(self.states["level"].tolist())))

    monkeypatch.setattr(eyes, "Lessons", Noted)
    eyes.measure((), 0, (MANY, UNSEEN, CORNERS), BATCH)
    (_, learned), (_, unseen), (corner, starts) = numbers
    assert [len(learned), len(unseen), len(starts)] == [MANY, UNSEEN, CORNERS]
    assert not learned & unseen and not learned & starts
    assert corner.placement == corner.start == "corner"
    assert eyes.LEVELS[0] <= eyes.UNSEEN


def test_a_row_says_what_guessing_gets_and_what_a_network_learned(rows):
    guess, learned = rows
    assert guess.pictures == 0 and 0.25 <= guess.right < 0.4 and 0.5 <= guess.start < 0.75
    assert learned.pictures > 0 and learned.pictures % BATCH == 0
    assert learned.largest == 7  # cells of the largest mazes at first
    assert set(learned.by_size) == set(eyes.SIZES)
    assert tables.markdown(rows).count("| patch |") == 1


def test_larger_mazes_come_once_it_is_right_in_the_largest(lessons, monkeypatch):
    monkeypatch.setattr(eyes, "ENOUGH", -10.0)  # also just after growth
    _, pictures, largest = eyes.learn("patch", lessons, 0.5, np.random.default_rng(0))
    updates = pictures // BATCH
    assert largest == min(7 + 2 * updates, 25)


def test_a_network_learns_first_that_no_other_action_is_a_direction(lessons, monkeypatch):
    monkeypatch.setattr(eyes, "WARM", 1)
    which, states = picked(lessons)
    images, labels = lessons.shown(which, states)
    torch.manual_seed(0)
    network, *_ = eyes.learn("patch", lessons, 1.0, np.random.default_rng(0))
    said = outputs(network, images, BATCH)[0].argmax(-1)
    assert set(said.tolist()) <= set(labels.tolist())
