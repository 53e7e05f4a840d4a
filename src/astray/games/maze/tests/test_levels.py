"""Promises of every variant about its levels, on a thousand of them."""

from dataclasses import replace

import numpy as np
import pytest

from astray.envs.vector import GameVectorEnv
from astray.games.maze import GAME
from astray.games.maze.rules import BOTH, OTHER
from astray.games.maze.variants import VARIANTS, Maze
from astray.kernel.maze import WALL
from astray.level import Level
from astray.record import NEVER

N = 1000


def levels(variant, count=N):
    env = GameVectorEnv("maze", variant, count, observation="symbolic", autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": np.arange(count)})
    return env.states


@pytest.mark.parametrize("name", VARIANTS)
def test_mazes_are_spanning_trees_in_the_middle_of_the_world(name):
    variant = VARIANTS[name]
    assert isinstance(variant, Maze)
    states = levels(variant)
    assert set(states["maze_size"]) == set(range(variant.smallest, variant.largest + 1, 2))
    for s in states[:200]:
        size, margin = s.maze_size, (s.world - s.maze_size) // 2
        free = s.cell[: s.world, : s.world] != WALL
        inside = free[margin : margin + size, margin : margin + size]
        assert free.sum() == inside.sum() == (size + 1) ** 2 // 2 - 1
        assert inside[::2, ::2].all() and not inside[1::2, 1::2].any()
        # A connected graph with one edge fewer than cells is a tree.
        edges = (free[1:] & free[:-1]).sum() + (free[:, 1:] & free[:, :-1]).sum()
        assert edges == free.sum() - 1
        if s.goal_x != NEVER or not variant.strict:
            assert GAME.solver.optimal_return(s, "cheese", 1.0) == 10


def test_the_cheese_is_in_the_corner_or_in_its_region():
    s = levels(VARIANTS["corner"])
    assert (s["goal_x"] == s["corner_x"]).all() and (s["goal_y"] == s["corner_y"]).all()
    for side in (2, 5, 16):
        s = levels(VARIANTS[f"region-{side}"])
        away = np.maximum(s["corner_x"] - s["goal_x"], s["corner_y"] - s["goal_y"])
        assert away.min() >= 0 and away.max() == min(side, 25) - 1


def test_an_anywhere_cheese_is_never_where_the_mouse_is_and_often_not_in_the_corner():
    for name in ("anywhere", "anywhere-small"):
        s = levels(VARIANTS[name])
        assert not ((s["goal_x"] + 0.5 == s["x"]) & (s["goal_y"] + 0.5 == s["y"])).any()
    rate = (s["goal_x"] == s["corner_x"]) & (s["goal_y"] == s["corner_y"])
    assert 0 < rate.mean() < 0.2


def test_the_original_leaves_some_levels_without_a_goal_and_the_default_does_not():
    knobs = {"smallest": 25, "placement": "region", "region": 1}
    # 337 free cells, 2,500 draws: (1 - 1/337)^2500 = 6 levels in 10,000
    strict = levels(Maze(about="", strict=True, **knobs), 10_000)
    default = levels(Maze(about="", **knobs), 10_000)
    missing = strict["goal_x"] == NEVER
    assert 1 <= missing.sum() <= 16
    assert (default["goal_x"] == default["corner_x"]).all()
    assert np.array_equal(strict["cell"][~missing], default["cell"][~missing])


def test_the_share_of_shifted_levels_is_the_probability_and_layouts_do_not_depend_on_it():
    plain, mixed, more = (
        levels(replace(VARIANTS["corner"], shift_probability=p), 6000) for p in (0.0, 0.02, 0.5)
    )
    assert abs(mixed["shifted"].mean() - 0.02) < 0.003
    assert not plain["shifted"].any()
    assert (more["shifted"] | ~mixed["shifted"]).all()  # the same levels, and more
    same = ~mixed["shifted"]
    assert plain[same].tobytes() == mixed[same].tobytes()
    assert np.array_equal(plain["cell"] == WALL, more["cell"] == WALL)
    moved = (more["goal_x"] != more["corner_x"]) | (more["goal_y"] != more["corner_y"])
    assert more["shifted"][moved].all()


@pytest.mark.parametrize("size", ["", "-easy", "-small"])
def test_the_cheese_is_on_its_dish_and_in_the_test_at_the_same_place_without_it(size):
    on, apart = levels(VARIANTS[f"dish{size}"]), levels(VARIANTS[f"dish-apart{size}"])
    assert all((on[f"goal_{axis}"] == on[f"other_{axis}"]).all() for axis in "xy")
    assert ((on["cell"] == BOTH).sum((1, 2)) == 1).all() and not (on["cell"] == OTHER).any()
    assert all((on[f"goal_{axis}"] == apart[f"goal_{axis}"]).all() for axis in "xy")
    assert ((apart["goal_x"] != apart["other_x"]) | (apart["goal_y"] != apart["other_y"])).all()
    assert np.array_equal(on["cell"] == WALL, apart["cell"] == WALL)


def test_a_goal_lies_on_no_object_but_a_dish():
    with pytest.raises(ValueError, match="needs other_shape 'dish', on which the goal is seen"):
        Maze(about="", placement="other", other_shape="gem", other_colour="red")
    gem = VARIANTS["red-line-yellow-gem-small"]
    drawn = "#######\n#@...O#" + 5 * "\n#######"
    with pytest.raises(ValueError, match="only where that is a dish"):
        Level.from_text(GAME, gem, drawn).state()
    s = Level.from_text(GAME, VARIANTS["dish-small"], drawn).state()
    assert (s.goal_x, s.goal_y) == (s.other_x, s.other_y) == (5, 5)


def test_a_mouse_that_starts_anywhere_starts_in_every_kind_of_place():
    s = levels(replace(VARIANTS["anywhere"], start="anywhere", smallest=3, largest=3))
    assert len(set(zip(s["x"], s["y"], strict=True))) == 8  # 7 free cells, 2 shapes of them


def test_two_objects_are_on_two_free_cells():
    s = levels(VARIANTS["red-line-yellow-gem"])
    apart = (s["goal_x"] != s["other_x"]) | (s["goal_y"] != s["other_y"])
    at_start = (s["other_x"] + 0.5 == s["x"]) & (s["other_y"] + 0.5 == s["y"])
    assert apart.all() and not at_start.any()


def test_a_guide_stays_once_it_was_there_wherever_it_is_led():
    env = GameVectorEnv("maze", "anywhere", observation="symbolic", autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": 1})
    level = Level.of(GAME, env.variant, env.states[0]).removed("goal")
    env.reset(options={"level": level})
    guide = GAME.solver.expert(env.states[0], "corner")
    while env.states[0].reached_corner == NEVER:
        env.step(np.array([guide(env.states[0])]))
    for name in ("left", "down"):  # one of which leads away
        env.step(np.array([GAME.actions.index(name)]))
    s = env.states[0]
    assert (int(s.x), int(s.y)) != (s.corner_x, s.corner_y)
    assert GAME.actions[guide(s)] == "stay"


@pytest.mark.parametrize("goal", ["cheese", "corner"])
def test_a_guide_takes_the_solvers_steps(goal):
    env = GameVectorEnv("maze", "anywhere", observation="symbolic", autoreset_mode="Disabled")
    for level in range(10):
        env.reset(seed=0, options={"level": level})
        s = env.states[0]
        worth, guide = GAME.solver.optimal_return(s, goal, 0.5), GAME.solver.expert(s, goal)
        while s[GAME.goals[goal]] == NEVER and not s.ended:
            env.step(np.array([guide(s)]))
        if s[GAME.goals[goal]] != NEVER:  # or the cheese was on the way to the corner
            assert worth == pytest.approx(10 * 0.5 ** (int(s.time) - 1))


def test_a_goal_does_not_move_to_a_corner_that_is_cut_off():
    variant, legend = GAME.variant("corner"), GAME.editing.LEGEND
    cells = np.full((variant.world, variant.world), legend["#"], np.uint8)
    cells[3, 2:4], cells[3, 4], cells[5, 6] = legend["."], legend["G"], legend["."]
    state = Level(GAME, variant, cells, (2, 3), {}).state()
    assert (state["corner_x"], state["corner_y"]) == (6, 5)
    states = np.array([state] * 8, GAME.state)
    mutated = GAME.mutation.mutate(states, variant, np.arange(8, dtype=np.uint32), 1, "constant")
    for s in mutated.view(np.recarray):
        assert GAME.solver.reachable(s)[s.goal_y, s.goal_x]


@pytest.mark.parametrize("is_first", [True, False])
def test_edits_leave_a_level_with_the_object_of_its_kind_alone(is_first):
    """A level that became one of the other kind kept an object nobody sees, or lacked its own."""
    bare, gem = VARIANTS["anywhere-small"], VARIANTS["red-line-yellow-gem-small"]
    one, other = (gem, bare) if is_first else (bare, gem)
    variant = replace(one, shift_probability=0.5, shifted=other)
    seeds = np.arange(200, dtype=np.uint32)
    for kind in ("constant", "binomial"):
        edited = GAME.mutation.mutate(levels(variant, 200), variant, seeds, 20, kind)
        assert set(edited["shifted"]) == {False, True}
        assert ((edited["other_x"] == NEVER) == (edited["shifted"] == is_first)).all()
        assert ((edited["other_shape"] == 0) == (edited["shifted"] == is_first)).all()
