"""Promises of each variant on hundreds of levels, and levels as data."""

import json
from dataclasses import replace

import numpy as np
import pytest

from astray.envs.vector import GameVectorEnv
from astray.games.heist import GAME
from astray.games.heist.rules import DOOR_CODE, EMPTY, GEM, KEY
from astray.games.heist.variants import VARIANTS
from astray.kernel.grid import UNREACHABLE, distances
from astray.kernel.maze import WALL
from astray.level import Level

N = 300


def levels(variant, count=N):
    env = GameVectorEnv("heist", variant, count, observation="symbolic", autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": np.arange(count)})
    return env.states


def reach(s, hand):
    """The cells that the thief comes to with the keys in `hand` alone."""
    grid = GAME.editing.grid(s)
    shut = [WALL, *(DOOR_CODE + k for k in range(3) if not hand >> k & 1)]
    return distances(~np.isin(grid, shut), int(s.x), int(s.y)) != UNREACHABLE


@pytest.mark.parametrize("name", VARIANTS)
def test_mazes_are_spanning_trees_with_doors_on_forks(name):
    variant, states = VARIANTS[name], levels(VARIANTS[name])
    assert set(states["maze_size"]) == set(range(variant.smallest, variant.largest + 1, 2))
    for s in states[:100]:
        free = np.pad(s.cell[: s.world, : s.world] == EMPTY, 1)
        edges = (free[1:] & free[:-1]).sum() + (free[:, 1:] & free[:, :-1]).sum()
        assert free.sum() == (s.maze_size + 1) ** 2 // 2 - 1 == edges + 1
        around = np.roll(free, 1, 0) * 1 + np.roll(free, -1, 0) + np.roll(free, 1, 1)
        around = (around + np.roll(free, -1, 1))[1:-1, 1:-1]
        grid = GAME.editing.grid(s)
        doors = (grid >= DOOR_CODE) & (grid < GEM)
        assert (around[doors] >= 3).all() and GAME.solver.reachable(s)[free[1:-1, 1:-1]].all()
        y, x = int(s.y), int(s.x)
        beside = np.pad(doors, 1)[[y, y + 2, y + 1, y + 1], [x + 1, x + 1, x, x + 2]]
        assert grid[y, x] == EMPTY and not beside.any()


@pytest.mark.parametrize("name", VARIANTS)
def test_there_are_as_many_doors_as_the_variant_says_each_with_a_key(name):
    states = levels(VARIANTS[name])
    what = np.where(np.arange(16) < states["objects"][:, None], states["what"], 0)
    keys = np.stack([(what == KEY + k).sum(1) for k in range(3)], 1)
    assert np.array_equal(keys, np.stack([(what == DOOR_CODE + k).sum(1) for k in range(3)], 1))
    assert (
        keys.max() == 1 and (np.diff(keys, axis=1) <= 0).all() and ((what == GEM).sum(1) == 1).all()
    )
    doors, larger = keys.sum(1), (states["maze_size"] - 5) // 2
    if VARIANTS[name].by_size:
        fits = larger > 0  # the smallest mazes may have no fork
        assert set((doors - np.minimum(larger, 3))[fits & (larger < 3)]) <= {-1, 0, 1}
    assert set(doors) == set(range(min(3, (VARIANTS[name].largest - 5) // 2 + 1) + 1))


@pytest.mark.parametrize("name", ["hard", "easy", "memory", "small"])
def test_each_key_is_before_its_door_and_all_are_needed_for_the_gem(name):
    for s in levels(VARIANTS[name], 100):
        grid, doors = GAME.editing.grid(s), bin(int(s.keys)).count("1")
        (gem,) = np.argwhere(grid == GEM)
        for stage in range(doors):
            (key,) = np.argwhere(grid == KEY + stage)
            before, now = reach(s, (1 << stage) - 1), reach(s, (1 << stage) // 2 - (stage > 0))
            assert before[tuple(key)] and not before[tuple(gem)]
            assert stage == 0 or not now[tuple(key)]
        assert reach(s, int(s.keys))[tuple(gem)]


@pytest.mark.parametrize("near, name", [("near", "hard"), ("near-memory", "memory")])
def test_near_levels_are_the_same_but_for_the_place_of_the_gem(near, name):
    moved = 0
    for one, two in zip(levels(VARIANTS[name], 100), levels(VARIANTS[near], 100), strict=True):
        grids = [GAME.editing.grid(s) for s in (one, two)]
        assert np.isin(grids[0][grids[0] != grids[1]], [EMPTY, GEM]).all()
        assert (one.x, one.y, one.background) == (two.x, two.y, two.background)
        first = reach(two, 0)
        bare = (first & (grids[1] == EMPTY)).sum() - 1 + (first & (grids[1] == GEM)).sum()
        assert (first & (grids[1] == GEM)).any() or bare == 0
        moved += not np.array_equal(*grids)
    assert moved > 60


@pytest.mark.parametrize("name", VARIANTS)
def test_a_described_level_is_built_again_and_played_on_as_it_would_be(name):
    variant = VARIANTS[name]
    one, two = (GameVectorEnv("heist", variant, autoreset_mode="Disabled") for _ in range(2))
    rng = np.random.default_rng(0)
    for level in range(4):
        seen, _ = one.reset(seed=0, options={"level": level})
        told = json.loads(json.dumps(Level.of(GAME, variant, one.states[0]).to_json()))
        assert np.array_equal(two.set_state(Level.from_json(GAME, variant, told).state()), seen)
        for action in rng.integers(9, size=60):
            ours, theirs = one.step(np.array([action])), two.step(np.array([action]))
            assert np.array_equal(ours[0], theirs[0]) and ours[1] == theirs[1]
            assert one.states[0].x == two.states[0].x and one.states[0].y == two.states[0].y
            if ours[2][0]:
                break


def test_a_level_can_be_read_off_in_the_middle_of_an_episode():
    env = GameVectorEnv("heist", "hard", observation="symbolic", autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": 2})
    guide = GAME.solver.expert(env.states[0], "gem")
    while env.states[0].opened_blue < 0:
        env.step(np.array([guide(env.states[0])]))
    level = Level.of(GAME, env.variant, env.states[0])
    assert not level.where("blue key") and not level.where("blue door")
    assert level.looks["hand"][0] == "blue" and level.state().hand == env.states[0].hand


@pytest.mark.parametrize(
    "hand, said", [(["pink"], "'pink'"), ([["red"]], r"\['red'\]"), ("red", "'r'")]
)
def test_a_key_of_an_unknown_colour_in_hand_is_told_with_the_colours(hand, said):
    level = Level.of(GAME, VARIANTS["near"], levels(VARIANTS["near"], 1)[0])
    with pytest.raises(ValueError, match=f"unknown key {said}; there are: blue, green, red"):
        replace(level, looks={**level.looks, "hand": hand}).state()
    assert replace(level, looks={**level.looks, "hand": ["green"]}).state().hand == 2


def test_edited_levels_are_those_that_were_asked_for():
    level = Level.of(GAME, VARIANTS["hard"], levels(VARIANTS["hard"], 3)[2])
    (gem,), (key,) = level.where("gem"), level.where("green key")
    open_ = level.removed("green door").removed("green key").added("red door", key)
    assert open_.state().what.tolist().count(DOOR_CODE + 2) == 2
    assert {one.where("gem")[0] for one in level.splay("gem")} >= {gem}
    with pytest.raises(ValueError, match=r"the gem at cell \(9, 4\) cannot be reached from"):
        level.removed("blue key").state()
    with pytest.raises(ValueError, match="at most 16 things; this has 24"):
        five = replace(VARIANTS["hard"], world=5, largest=5, shifted=None)
        Level.from_text(GAME, five, "\n".join(["bbbbb"] * 4 + ["@bbbb"])).state()
