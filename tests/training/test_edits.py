"""Edits of levels: what comes out is a level of its variant, and follows from its seed."""

from dataclasses import replace

import numpy as np
import pytest

from astray.acting import initial_states
from astray.games.maze import GAME
from astray.games.maze.variants import GOALS
from astray.kernel.maze import WALL
from astray.level import Level
from astray.record import NEVER

EDITED = replace(GAME.variant("corner-small"), shift_probability=0.3)


def edited(kind, variant=EDITED, edits=12, count=300):
    before = initial_states(GAME, variant, range(count))
    seeds = np.random.default_rng(0).integers(2**32, size=count)
    return before, GAME.mutation.mutate(before, variant, seeds, edits, kind)


@pytest.mark.parametrize("kind", ["constant", "identity", "binomial"])
@pytest.mark.parametrize("variant", [EDITED, GAME.variant("dish-small"), GAME.variant("corner")])
def test_an_edited_level_is_one_of_its_variant_and_can_be_solved(kind, variant):
    before, after = edited(kind, variant, count=100)
    GAME.check(after, variant)
    assert (after["level"] == NEVER).all() and (after["time"] == 0).all()
    for one, two in zip(before, after.view(np.recarray), strict=True):
        for goal in ("cheese", "corner"):
            is_there = two[GOALS[goal]] != NEVER  # the mouse begins at it
            assert GAME.solver.optimal_return(two, goal) == (0 if is_there else 10)
        assert ((one["cell"] == 1) != (two["cell"] == 1)).sum() <= 12
    assert ((before["cell"] == 1) != (after["cell"] == 1)).any((1, 2)).mean() > 0.9


def test_identity_leaves_the_goal_where_it_was_and_constant_places_it_anew():
    before, after = edited("identity")
    assert all((before[f"goal_{axis}"] == after[f"goal_{axis}"]).all() for axis in "xy")
    assert (before["shifted"] == after["shifted"]).all() and 0 < after["shifted"].mean() < 1
    _, after = edited("constant")
    assert abs(after["shifted"].mean() - 0.3) < 0.08
    at_corner = (after["goal_x"] == after["corner_x"]) & (after["goal_y"] == after["corner_y"])
    assert at_corner[~after["shifted"]].all() and not at_corner[after["shifted"]].all()


def test_a_cheese_on_a_dish_is_moved_with_it_and_stays_on_it():
    before, after = edited("identity", GAME.variant("dish-small"))
    for axis in "xy":
        assert (after[f"goal_{axis}"] == after[f"other_{axis}"]).all()
    assert ((before["goal_x"] != after["goal_x"]) | (before["goal_y"] != after["goal_y"])).any()


@pytest.mark.parametrize("kind", ["constant", "binomial"])
def test_a_cheese_is_not_placed_on_an_object_that_is_no_dish(kind):
    gem = {"other_shape": "gem", "other_colour": "red", "shift_probability": 0.5}
    variant = GAME.variant("corner-small").with_knobs(gem)
    _, after = edited(kind, variant, count=80)
    for _ in range(3):
        after = GAME.mutation.mutate(after, variant, np.arange(len(after)), 12, kind)
        for s in after.view(np.recarray):
            again = Level.of(GAME, variant, s).state()  # which refuses such a level
            assert (again["goal_x"], again["other_y"]) == (s.goal_x, s.other_y)


def test_edits_follow_from_their_seeds_and_leave_the_levels_they_came_from():
    before, after = edited("binomial", count=20)
    again, same = edited("binomial", count=20)
    assert before.tobytes() == again.tobytes() and after.tobytes() == same.tobytes()


@pytest.mark.parametrize("corner", [".", "#"])
def test_a_maze_off_the_middle_of_its_world_is_edited_where_it_is(corner):
    rows = [f"..{corner}####", "..G####", "@..####", *["#######"] * 4]
    level = Level.from_text(GAME, GAME.variant("anywhere-small"), "\n".join(rows))
    states = np.repeat(np.array([level.state()], GAME.state), 200)
    seeds = np.arange(200)
    after = GAME.mutation.mutate(states, level.variant, seeds, 12, "binomial")
    changed = (states["cell"] == WALL) != (after["cell"] == WALL)
    rows, columns = np.nonzero(changed.any(0))
    assert rows.min() == 4  # 3 x 3 cells in the upper left; without a corner, their edges stay
    assert (rows.max(), columns.max()) == ((6, 2) if corner == "." else (5, 1))


@pytest.mark.parametrize("corner", [".", "#"])
@pytest.mark.parametrize("drawn", [["@{}", "..", ".G", "..", ".."], [".....{}", "@...G."]])
def test_edits_leave_a_maze_its_corner_or_none(drawn, corner):
    rows = [row.format(corner).ljust(7, "#") for row in drawn]
    lines = "\n".join([*["#######"] * (7 - len(rows)), *rows])
    level = Level.from_text(GAME, GAME.variant("anywhere-small"), lines)
    states = np.repeat(np.array([level.state()], GAME.state), 80)
    for s in GAME.mutation.mutate(states, level.variant, np.arange(80), 12, "binomial"):
        again = Level.of(GAME, level.variant, s).state()
        for name in ("corner_x", "corner_y"):
            assert again[name] == s[name] == states[0][name]


def otherwise(name, value):
    """Levels of `EDITED` with one of their fields as no level has it."""
    states = initial_states(GAME, EDITED, range(2))
    states[name] = value
    return states


UNEDITABLE = {
    "a maze larger than its world": ({"states": otherwise("maze_size", 10**6)}, "its maze_size"),
    "a maze of no cells": ({"states": otherwise("maze_size", 0)}, "its maze_size"),
    "a world that is larger": ({"states": otherwise("world", 10**6)}, "its world"),
    "a goal outside": ({"states": otherwise("goal_x", 10**9)}, "its goal_x"),
    "a mouse nowhere": ({"states": otherwise("x", np.nan)}, "its x"),
    "rows of states": ({"states": initial_states(GAME, EDITED, range(2))[None]}, r"\[N\] records"),
    "no states": ({"states": b"abc"}, r"\[N\] records"),
    "a variant of another size": ({"variant": GAME.variant("corner")}, "its world"),
    "the name of a variant": ({"variant": "corner-small"}, "variant must be a Maze"),
    "too few seeds": ({"seeds": [1]}, "seeds must be 2, one for each state"),
    "seeds that are no integers": ({"seeds": [0.5, 1.5]}, "seeds must be integers"),
    "a seed that would be another": ({"seeds": np.uint64([7, 2**63])}, "to 4294967295; got"),
    "a seed of too many bits": ({"seeds": [2**32, 0]}, "to 4294967295; got 4294967296"),
    "a seed below 0": ({"seeds": [0, -5]}, "seeds must be an integer from 0 to .*; got -5"),
    "edits without end": ({"edits": 10**18}, "edits must be an integer from 0 to 10000"),
    "half an edit": ({"edits": 1.5}, "edits must be an integer"),
    "a kind misspelt": ({"kind": "walls"}, "unknown kind 'walls'"),
}


@pytest.mark.parametrize("change, said", UNEDITABLE.values(), ids=UNEDITABLE)
def test_what_cannot_be_edited_never_reaches_compiled_code(change, said):
    given = {
        "states": initial_states(GAME, EDITED, range(2)),
        "variant": EDITED,
        "seeds": [0, 1],
        "edits": 5,
        "kind": "constant",
    } | change
    with pytest.raises(ValueError, match=said):
        GAME.mutation.mutate(**given)
