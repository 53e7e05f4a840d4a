"""What `astray.testing` tells of a game beside what it checks."""

import logging
import re
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from astray import games, testing
from astray.acting import initial_states
from astray.analysis.outcomes import load_shift
from astray.envs import vector
from astray.envs.compiled import loop_of
from astray.game import Never
from astray.games.maze import GAME
from astray.insight.fields import splay
from astray.kernel.jit import kernel
from astray.lab import agents
from astray.level import Level
from astray.record import NEVER
from helpers import lava

SMALL = GAME.variant("anywhere-small")


def test_a_variant_with_levels_of_another_is_checked_as_any():
    mixed = GAME.variant("corner-small").with_knobs({"shift_probability": 0.5})
    other = replace(mixed.shifted, time_limit=7)
    testing.check_time_limit(GAME, replace(mixed, shifted=other))


def with_places(**others):
    """Maze, where some of what tells where its mouse is or could be is otherwise."""
    own = {name: getattr(GAME.places, name) for name in ("centre", "stand", "put")}
    return replace(GAME, places=SimpleNamespace(**own | others))


def test_how_long_a_game_compiles_is_logged_and_many_seconds_are_warned_of(monkeypatch, caplog):
    monkeypatch.setattr(testing, "compiled_loop", lambda game: sum(range(3_000_000)))
    with caplog.at_level(logging.INFO, "astray"):
        testing.check_game(games.find("maze"), variants=[])
    assert caplog.messages == [
        f"maze: compiled, or taken from the cache, in {caplog.records[0].args[1]:.1f} s"
    ]
    monkeypatch.setattr(testing, "SLOW", 0)
    with pytest.warns(UserWarning, match=r"maze took \d+ s to compile, more than 0: ") as told:
        testing.check_game(games.find("maze"), variants=[])
    page, heading = re.search(r'(docs/\S+), "(.*)"', str(told[0].message)).groups()
    assert f"\n### {heading}\n" in (Path(testing.__file__).parents[2] / page).read_text()


def test_a_measure_that_is_not_one_number_of_each_episode_is_found():
    measures = {"cells": lambda states: states["cell"].reshape(len(states), -1)}
    with pytest.raises(AssertionError, match="cells"):
        testing.check_game(replace(GAME, measures=measures), ["corner-small"])


@pytest.mark.parametrize("part", ["rules", "levels", "symbols", "editing", "solver", "places"])
def test_a_part_that_lacks_a_name_is_refused_with_what_it_lacks(part):
    given = getattr(GAME, part)
    whole = {name: getattr(given, name) for name in dir(given)}
    lacking = {"rules": "EVENTS", "levels": "generate", "symbols": "planes", "editing": "STOOD_ON",
               "solver": "expert", "places": "put"}[part]  # fmt: skip
    few = SimpleNamespace(**{n: x for n, x in whole.items() if n[0] != "_" and n != lacking})
    with pytest.raises(ValueError, match=rf"{part} of the game 'maze' must have {lacking}, as"):
        replace(GAME, **{part: few})


def low(s):
    """The two lowest rows alone."""
    found = GAME.places.stand(s)
    found[2:] = False
    return found


def test_a_game_says_where_its_agent_can_be_put():
    game = with_places(stand=low)
    level = Level.from_text(game, SMALL, "\n".join(["......G", *["......."] * 5, "@......"]))
    expected = [(x, y) for y in range(2) for x in range(7)]
    assert [one.agent for one in level.splay("agent")] == expected
    states = splay(level)
    assert np.floor(GAME.places.centre(states)).astype(int).tolist() == list(map(list, expected))
    assert sorted(map(tuple, agents.places(game, level.state()).tolist())) == sorted(expected)


def stays(states, cells_):
    return states.copy()


def moves_what_is_given(states, cells_):
    states["x"], states["y"] = cells_.T + 0.5
    return states


def loses_the_goal(states, cells_):
    found = GAME.places.put(states, cells_)
    found["goal_x"] = 100
    return found


@pytest.mark.parametrize(
    "wrong, message",
    [
        ({"put": stays}, "it is not where it was put"),
        ({"put": moves_what_is_given}, "the states given were changed"),
        ({"put": loses_the_goal}, "it is not as it was"),
        ({"stand": lambda s: np.zeros((7, 7), bool)}, "it cannot be at"),
        ({"centre": lambda states: GAME.places.centre(states) + 1}, "it cannot be at|it is not"),
    ],
)
def test_what_is_wrong_with_places_is_found(wrong, message):
    testing.check_places(GAME, SMALL)
    with pytest.raises(AssertionError, match=message):
        testing.check_places(with_places(**wrong), SMALL)


@pytest.mark.parametrize("measure", [lambda s: s["x"][:1], lambda s: s["x"].astype(str)])
def test_a_measure_that_is_no_number_of_each_state_is_found(measure):
    wrong = replace(GAME, measures={"far": measure})
    assert testing.check_measures in testing.CHECKS
    with pytest.raises(AssertionError, match="far"):
        testing.check_measures(wrong, SMALL)


@pytest.mark.parametrize("game", games.OWN)
def test_an_agent_is_put_as_a_level_would_begin_with_it_there(game):
    game = games.find(game)
    variant = next(iter(game.variants.values()))
    (begun, *_) = initial_states(game, variant, testing.LEVELS)
    level = Level.of(game, variant, begun)
    chosen = np.argwhere(game.places.stand(begun))[::17, ::-1]
    moved = game.places.put(np.repeat(np.array([level.state()], game.state), len(chosen)), chosen)
    for state, cell in zip(moved, chosen.tolist(), strict=True):
        there = Level(game, variant, level.cells, tuple(cell), level.looks).state(solvable=False)
        events = set(game.events)  # a mouse may begin in its corner
        assert all(np.array_equal(state[n], there[n]) for n in state.dtype.names if n not in events)


@kernel
def sets_nothing(s, p):
    pass


@kernel
def takes_its_turn(s, p):
    lava.generate(s, p)
    s.x += s.turn


@kernel
def draws_alike(s, art, scene, image):
    image[:] = s.x  # each pixel alone would take long, interpreted


@kernel
def draws_and_eats(s, art, scene, image):
    lava.foreground(s, art, scene, image)
    s.apples = 0


@kernel
def shows_and_eats(s, scene, planes):
    lava.foreground_planes(s, scene, planes)
    s.apples += 1


def test_looks_that_would_be_drawn_by_the_functions_of_others_are_refused():
    own = lava.GAME.looks["own"]
    for name in ("own", "dusk"):
        night = replace(own, name=name, foreground=draws_and_eats)
        with pytest.raises(ValueError, match=f"looks 'night' of the game 'lava' .*; got '{name}'"):
            replace(lava.GAME, looks={"own": own, "night": night})


@kernel
def renumbers(s, action):
    s.level += s.time == 2
    return 0.0, False


@kernel
def burns_in_another_episode_before(s, action):
    s.burnt = 1 if s.turn == 2 and s.time == 3 else s.burnt
    return 0.0, s.time == 5


@kernel
def pays_what_is_no_number(s, action):
    return np.nan, s.time == 5


@kernel
def swaps(s, action):
    return False, 1.0


@pytest.mark.parametrize(
    ("check", "wrong", "kind", "said"),
    [
        (testing.check_levels, {"generate": takes_its_turn}, AssertionError, "takes 'x' from"),
        (
            testing.check_observing,
            {"foreground": draws_and_eats},
            AssertionError,
            "planes changes 'apples'",
        ),
        (
            testing.check_observing,
            {"foreground_planes": shows_and_eats},
            AssertionError,
            "planes changes 'apples'",
        ),
        (testing.check_events, {"step": renumbers}, AssertionError, "`step` changes 'level'"),
        (
            testing.check_events,
            {"step": burns_in_another_episode_before},
            AssertionError,
            r"burnt: \[1 1 1",
        ),
        (
            testing.check_batches,
            {"step": pays_what_is_no_number},
            AssertionError,
            "rewards must be finite numbers; got .nan",
        ),
        (testing.check_events, {"step": swaps}, ValueError, r"or_\(float64.*loops\.py\", line"),
    ],
)
def test_what_is_wrong_with_rules_and_levels_is_found(check, wrong, kind, said, monkeypatch):
    if kind is AssertionError:  # interpreted it is found as well, and nothing is compiled
        monkeypatch.setattr(vector, "compiled_loop", lambda *of: loop_of(*of).py_func)
    game = with_parts(**{"foreground": draws_alike, **wrong})
    with pytest.raises(kind, match=said):
        check(game, game.variant("lava"))


def with_parts(**others):
    """Lava land, of whose functions some are others."""
    parts: Any = SimpleNamespace(**{**vars(lava), **others})
    looks = {"own": replace(lava.GAME.looks["own"], foreground=parts.foreground)}
    return replace(lava.GAME, rules=parts, levels=parts, symbols=parts, looks=looks)


def test_fields_that_a_level_does_not_set_are_zero_and_its_events_have_not_happened():
    game = with_parts(generate=sets_nothing)
    testing.check_levels(game, game.variant("lava"))
    (begun,) = initial_states(game, game.variant("lava"), [3])
    assert (begun.x, begun.apples, begun.reached_goal, begun.burnt) == (0, 0, NEVER, NEVER)
    assert begun.level == 3 and begun.time_limit == game.variant("lava").time_limit


def edited(**others):
    """Maze, whose levels are edited in another way."""
    own = {name: getattr(GAME.editing, name) for name in dir(GAME.editing) if name[0] != "_"}
    return replace(GAME, editing=SimpleNamespace(**own | others))


def builds_another(*level):
    s = GAME.editing.build(*level)
    s["faces_right"] ^= True
    return s


def nowhere():
    """Maze, whose solver knows no cell to go to."""
    own = {name: getattr(GAME.solver, name) for name in ("expert", "optimal_return")}
    none = np.zeros((25, 25), bool)
    return replace(GAME, solver=SimpleNamespace(**own, reachable=lambda s: none))


def waiting():
    """Maze, whose expert stands still for a step before it walks the shortest way."""

    def expert(s, goal):
        walk = GAME.solver.expert(s, goal)
        return lambda s: walk(s) if s.time else GAME.actions.index("stay")

    own = {name: getattr(GAME.solver, name) for name in ("reachable", "optimal_return")}
    return replace(GAME, solver=SimpleNamespace(**own, expert=expert))


def mutated(change):
    def mutate(*args):
        made = GAME.mutation.mutate(*args)
        change(made)
        return made

    return replace(GAME, mutation=SimpleNamespace(mutate=mutate))


@pytest.mark.parametrize(
    ("check", "game", "said"),
    [
        (testing.check_editing, edited(build=builds_another), "lose .faces_right. of level 0"),
        (testing.check_editing, edited(OBJECTS={"fly": "Z"}), "the legend lacks Z"),
        (testing.check_solver, nowhere(), "is not reachable"),
        (testing.check_solver, waiting(), r"it takes \d+ steps to cheese, more than are needed"),
        (testing.check_mutation, mutated(lambda made: made["level"].fill(3)), r"\[3 3 3 3 3\]"),
        (
            testing.check_mutation,
            mutated(lambda made: made["x"].put(0, np.random.default_rng().random())),
            "equal seeds give other edits",
        ),
    ],
)
def test_what_is_wrong_with_edits_is_found(check, game, said):
    with pytest.raises(AssertionError, match=said):
        check(game, SMALL)


@kernel
def walks_out(s, action):
    s.x += action - 1
    return PAID[s.x], False


@kernel
def draws_further(s, art, scene, image):
    image[:] = 0
    image[60 + s.x, 0, 0] = 255  # the mouse goes from cell 2 to the right


@kernel
def has_more_planes(s, planes):
    planes[:] = 0
    planes[1, 0, s.x] = 1


PAID = np.zeros(3)


@pytest.mark.parametrize(
    ("parts", "place"),
    [
        ({"step": walks_out}, "index 3 .* size 3 .*test_checks.* return PAID.s.x"),
        ({"foreground": draws_further}, "index 72 .* size 64 .*test_checks.* image.60"),
        ({"foreground_planes": lambda s, scene, planes: has_more_planes(s, planes)}, "index 1 "),
    ],
)
def test_code_that_leaves_its_arrays_is_named_before_it_runs_compiled(parts, place, monkeypatch):
    monkeypatch.setattr(testing, "report_compiling", lambda game: None)
    own: Any = SimpleNamespace(**{**vars(lava), **parts})
    looks = {"own": replace(lava.GAME.looks["own"], foreground=own.foreground)}
    game = replace(lava.GAME, name="outside", rules=own, symbols=own, looks=looks)
    monkeypatch.setattr(vector, "compiled_loop", loop_of)
    with pytest.raises(AssertionError, match=f"outside leaves an array: {place}"):
        testing.check_game(game, ["safe"])


def test_code_that_runs_only_compiled_is_not_refused(caplog, monkeypatch):
    own: Any = SimpleNamespace(**{**vars(lava), "step": lambda s, action: 1 // 0})
    monkeypatch.setattr(vector, "compiled_loop", loop_of)
    game = replace(lava.GAME, name="only-compiled", rules=own)
    testing.check_indices(game, game.variant("safe"))
    assert "no index of only-compiled is checked: interpreted, ZeroDivisionError" in caplog.text


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"measures": {"reached_goal": lambda s: s["x"]}}, "other names than events; got reached_"),
        ({"ends": {"corner": Never("reached_goal")}}, "other names than goals; got corner"),
    ],
)
def test_names_that_would_be_confused_in_a_table_are_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        replace(GAME, **changes)


def test_a_game_without_shifts_says_so():
    with pytest.raises(ValueError, match="unknown shift 'corner' of maze; there are: none"):
        load_shift(replace(GAME, shifts={}), "corner")


def of_states(kind):
    """Maze, whose states have one field, an event of this kind."""
    rules = SimpleNamespace(ACTIONS=("stay",), STATE=np.dtype([("end", kind)]), EVENTS=("end",))
    rules.step = GAME.rules.step
    return replace(GAME, rules=rules, goals={}, shifts={})


@pytest.mark.parametrize(
    ("game", "said"),
    [
        (lambda: "maze", "a game must be a Game, not its name; got 'maze'"),
        (lambda: of_states(np.int32), "the event 'end' must be an int64 of the state"),
        (
            lambda: replace(of_states(np.int64), rules=SimpleNamespace(
                ACTIONS=("stay",), STATE=GAME.state, EVENTS=("lost",), step=GAME.rules.step
            )),
            "the event 'lost' must be an int64 of the state",
        ),
        (lambda: replace(GAME, variants={"a": None}, shifts={}), "of one class; got .*NoneType"),
    ],
)  # fmt: skip
def test_a_game_with_wrong_parts_is_told_before_it_is_compiled(game, said, monkeypatch):
    monkeypatch.setattr(testing, "compiled_loop", lambda game: pytest.fail("compiled"))
    with pytest.raises(AssertionError, match=said):
        testing.check_game(game(), variants=[])
