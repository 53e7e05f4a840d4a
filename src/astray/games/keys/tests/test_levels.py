"""Promises of every variant about its levels, on hundreds of them; and levels as data."""

import json
from dataclasses import replace

import numpy as np
import pytest

from astray.envs.vector import GameVectorEnv
from astray.games.keys import GAME
from astray.games.keys.rules import CHEST, EMPTY, KEY
from astray.games.keys.variants import VARIANTS, Keys
from astray.kernel.maze import WALL
from astray.level import Level
from astray.record import NEVER

N = 500


def levels(variant, count=N):
    env = GameVectorEnv("keys", variant, count, observation="symbolic", autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": np.arange(count)})
    return env.states


@pytest.mark.parametrize("name", VARIANTS)
def test_mazes_are_spanning_trees_somewhere_in_the_world(name):
    variant = VARIANTS[name]
    assert isinstance(variant, Keys)
    states = levels(variant)
    assert set(states["maze_size"]) == set(range(variant.smallest, variant.largest + 1, 2))
    for s in states[:200]:
        free = s.cell[: s.world, : s.world] == EMPTY
        edges = (free[1:] & free[:-1]).sum() + (free[:, 1:] & free[:, :-1]).sum()
        assert free.sum() == (s.maze_size + 1) ** 2 // 2 - 1 == edges + 1
        assert GAME.solver.reachable(s)[free].all()


@pytest.mark.parametrize("name", VARIANTS)
def test_there_are_as_many_chests_a_key_as_the_variant_says(name):
    variant, s = VARIANTS[name], levels(VARIANTS[name])
    if not name.endswith("memory"):  # where the original's mazes are too small now and then
        assert np.array_equal(s["keys"] * variant.chests, s["chests"] * variant.keys)
    groups = s["keys"] // variant.keys
    if variant.fewest:
        assert set(groups) == set(range(variant.fewest, variant.most + 1))
    else:
        extra = groups - (s["maze_size"] - 5) // 2
        assert set(extra) == {1, 2} and 0.4 < (extra == 1).mean() < 0.6


@pytest.mark.parametrize("name", ["many-chests", "many-keys-small", "many-keys-memory"])
def test_objects_are_in_cells_of_their_own_and_not_in_dead_ends(name):
    for s in levels(VARIANTS[name])[:200]:
        x, y = s.object_x[: s.objects].astype(int), s.object_y[: s.objects].astype(int)
        cells = set(zip(x.tolist(), y.tolist(), strict=True))
        assert len(cells) == s.objects and (int(s.x), int(s.y)) not in cells
        free = np.pad(s.cell[: s.world, : s.world] == EMPTY, 1)
        around = [free[y + 1 + j, x + 1 + i] for j, i in ((1, 0), (-1, 0), (0, 1), (0, -1))]
        assert free[y + 1, x + 1].all() and (np.sum(around, 0) >= 2).all()
        is_key = s.what[: s.objects] == KEY
        off = np.abs(np.stack([s.object_x[: s.objects] - x, s.object_y[: s.objects] - y]) - 0.5)
        assert (off <= 0.125).all() and (off[:, is_key] > 0).all() and not off[:, ~is_key].any()


def test_many_chests_and_many_keys_are_one_maze_with_a_third_of_the_objects_changed():
    one, two = levels(VARIANTS["many-chests"]), levels(VARIANTS["many-keys"])
    for field in ("cell", "x", "y", "objects", "background"):
        assert np.array_equal(one[field], two[field])
    changed = (one["what"] != two["what"]).sum(1)
    assert np.array_equal(changed * 3, one["objects"])


def test_groups_that_do_not_fit_are_left_out_but_in_the_original_keys_alone():
    crowded = Keys(about="", largest=5, keys=1, chests=2, fewest=5, most=5)
    loose, strict = levels(crowded), levels(replace(crowded, strict=True))
    assert (loose["chests"] == 2 * loose["keys"]).all() and (loose["keys"] < 5).any()
    # Of 15 objects 10 are chests, which come first; 8 to 17 cells are no dead ends.
    short = strict["objects"] < 15
    assert short.any() and (strict["keys"] < 5)[short].all()
    assert (strict["chests"][strict["keys"] > 0] == 10).all()


def test_the_shifted_variant_has_the_share_that_was_asked_for():
    mixed = levels(replace(VARIANTS["many-chests"], shift_probability=0.1), 5000)
    assert abs(mixed["shifted"].mean() - 0.1) < 0.02
    assert np.array_equal(mixed["keys"] > mixed["chests"], mixed["shifted"])


@pytest.mark.parametrize("name", VARIANTS)
def test_a_described_level_is_built_again_and_played_on_as_it_would_be(name):
    variant = VARIANTS[name]
    options = {"observation": "image", "autoreset_mode": "Disabled"}
    one, two = (GameVectorEnv("keys", variant, **options) for _ in range(2))
    rng = np.random.default_rng(0)
    for level in range(5):
        seen, _ = one.reset(seed=0, options={"level": level})
        told = json.loads(json.dumps(Level.of(GAME, variant, one.states[0]).to_json()))
        built = Level.from_json(GAME, variant, told)
        assert str(built) == str(Level.of(GAME, variant, one.states[0]))
        assert np.array_equal(two.set_state(built.state()), seen)
        for action in rng.integers(9, size=60):
            ours, theirs = one.step(np.array([action])), two.step(np.array([action]))
            assert np.array_equal(ours[0], theirs[0]) and ours[1] == theirs[1]
            assert one.states[0].x == two.states[0].x and one.states[0].y == two.states[0].y
            if ours[2][0]:
                break


def test_a_level_can_be_read_off_in_the_middle_of_an_episode():
    env = GameVectorEnv("keys", "many-keys", observation="symbolic", autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": 1})
    guide = GAME.solver.expert(env.states[0], "chests")
    while env.states[0].opened < 2:
        env.step(np.array([guide(env.states[0])]))
    s = env.states[0]
    level = Level.of(GAME, env.variant, s)
    assert level.agent == (int(s.x), int(s.y))
    assert len(level.where("key")) == s.keys - s.taken
    assert len(level.where("chest")) == s.chests - s.opened
    assert set(np.unique(level.cells)) == {EMPTY, WALL, KEY, CHEST}


def test_edited_levels_are_those_that_were_asked_for():
    s = levels(VARIANTS["many-keys"], 1)[0]
    level = Level.of(GAME, VARIANTS["many-keys"], s)
    key, chest = level.where("key")[0], level.where("chest")[0]
    fewer = level.removed("key", key).removed("chest", chest).added("key", chest)
    again = fewer.state()
    assert (again.keys, again.chests) == (s.keys, s.chests - 1)
    assert Level.of(GAME, VARIANTS["many-keys"], again).where("key") == fewer.where("key")
    free = (GAME.editing.grid(s) == EMPTY).sum()
    assert len(level.splay("key", key)) == free  # its own, and all but the thief's


def test_drawings_are_levels_with_their_keys_in_the_middle_of_cells():
    five = Keys(about="", world=5, largest=5)
    drawing = "#####\n#@kC#\n#.###\n#kk.#\n#####"
    level = Level.from_text(GAME, five, drawing)
    s = level.state()
    assert str(level) == drawing and (s.keys, s.chests) == (3, 1)
    assert set(s.object_x[:4] % 1) == {0.5}
    with pytest.raises(ValueError, match="at most 36 things; this has 48"):
        Level.from_text(
            GAME, replace(five, world=7), "\n".join(["kkkkkkk"] * 6 + ["@kkkkkk"])
        ).state()


def beside(s):
    """Where the keys that are there are in their cells, by cell."""
    there = (s.what[: s.objects] == KEY) & (s.gone[: s.objects] == NEVER)
    at = [(float(s.object_x[k]), float(s.object_y[k])) for k in np.flatnonzero(there)]
    return {(int(x), int(y)): (x % 1, y % 1) for x, y in at}


def test_an_edit_of_one_object_leaves_the_others_where_they_are():
    s = levels(VARIANTS["many-keys"], 3)[2]
    level, before = Level.of(GAME, VARIANTS["many-keys"], s), beside(s)
    assert len(set(before.values())) == len(before) > 3
    for edited in (
        level.removed("key", min(before)),
        level.removed("chest", level.where("chest")[0]),
        level.moved("chest", free_cells(level)[0], level.where("chest")[0]),
        level.added("key", free_cells(level)[0]),
    ):
        after = beside(edited.state(solvable=False))
        assert all(after[cell] == where for cell, where in before.items() if cell in after)
    to = free_cells(level)[-1]
    moved = beside(level.moved("key", to, min(before)).state(solvable=False))
    assert moved.pop(to) == pytest.approx(before[min(before)], abs=1e-5)
    assert moved == {cell: where for cell, where in before.items() if cell != min(before)}
    for one in level.splay("key", min(before))[:5]:
        (new,) = set(one.where("key")) - set(level.removed("key", min(before)).where("key"))
        there = beside(one.state(solvable=False))[new]
        assert there == pytest.approx(before[min(before)], abs=1e-5)


def free_cells(level):
    """The cells with nothing in them, but for the thief's."""
    found = [(int(x), int(y)) for y, x in np.argwhere(level.cells == EMPTY)]
    return [cell for cell in found if cell != level.agent]


def test_keys_stay_where_they_are_in_the_level_of_an_episode_that_goes_on():
    env = GameVectorEnv("keys", "many-keys", observation="symbolic", autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": 1})
    guide = GAME.solver.expert(env.states[0], "chests")
    while env.states[0].taken < 2:
        env.step(np.array([guide(env.states[0])]))
    level = Level.of(GAME, env.variant, env.states[0])
    assert beside(level.state(solvable=False)) == beside(env.states[0])


def test_levels_that_were_written_without_details_are_as_the_twister_draws_them():
    s = levels(VARIANTS["many-keys"], 1)[0]
    data = Level.of(GAME, VARIANTS["many-keys"], s).to_json()
    data["looks"].pop("details")
    assert beside(Level.from_json(GAME, VARIANTS["many-keys"], data).state()) == beside(s)


def test_a_thief_may_stand_at_the_edge_of_a_keys_cell_without_taking_it():
    variant = VARIANTS["many-keys-small"]
    drawing = "#######\n#@....#\n#.###.#\n#.#k..#\n#.#.#.#\n#k...C#\n#######"
    s = Level.from_text(GAME, variant, drawing).state(solvable=False)
    s.object_y[0], s.y = 1.38, 1.99  # below the middle of its cell; a key is taken within 0.607
    GAME.check(np.array([s]), variant)
    level = Level.of(GAME, variant, s)
    assert level.agent == (1, 1) and level.where("key") == [(1, 1), (3, 3)]
    level.state(solvable=False)


@pytest.mark.parametrize("place", [(5.5, 1.5), (2.5, 2.5)])  # of the chest, of a wall
def test_a_state_whose_things_share_a_cell_is_no_level(place):
    variant = VARIANTS["many-keys-small"]
    drawing = "#######\n#@....#\n#.###.#\n#.#k..#\n#.#.#.#\n#k...C#\n#######"
    s = Level.from_text(GAME, variant, drawing).state(solvable=False)
    s.object_x[1], s.object_y[1] = place
    where = tuple(map(int, place))
    with pytest.raises(ValueError, match=rf"cell \({where[0]}, {where[1]}\) holds several things"):
        Level.of(GAME, variant, s)
