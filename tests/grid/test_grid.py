"""Tests of the toolkit: drawings, planes, scripts, and facts that compiled code relies on."""

from dataclasses import replace

import numpy as np
import pytest

from astray import games, grid
from astray.envs.vector import GameVectorEnv
from astray.games import lavaland
from astray.grid import abilities
from astray.grid.looks import SHARED, drawing
from astray.level import Level
from helpers.scenes import play, room, scene

LAVA = games.find("lavaland")
LAKE = room(8, ".~..", "@~.G")


def test_a_plane_is_of_a_kind_and_the_agent_is_in_the_middle_of_walls_and_all():
    env = scene("lavaland", LAKE)
    walls, lava, cheese, mouse = env.step(np.array([0]))[0][0]
    assert walls.shape == (15, 15) and walls.sum() == 15 * 15 - 8 * 8
    assert np.argwhere(mouse).tolist() == [[7, 7]]
    assert np.argwhere(lava).tolist() == [[7, 8], [8, 8]]
    assert np.argwhere(cheese).tolist() == [[7, 10]]
    seen = env.step(np.array([4]))[0][0]  # a step up, and all else is lower
    assert np.argwhere(seen[2]).tolist() == [[6, 10]]


def test_a_picture_shows_things_and_the_agent_on_the_floor():
    env = scene("lavaland", LAKE)
    (image,) = env.picture(64)
    cells = image.reshape(8, 8, 8, 8, 3).mean((1, 3))
    bare = cells[0, 0]
    shown = np.abs(cells - bare).sum(-1) > 30
    assert np.argwhere(shown).tolist() == [[6, 1], [7, 0], [7, 1], [7, 3]]


def test_a_missing_picture_is_looked_for_in_the_world_s_own_folder(tmp_path):
    assert drawing(tmp_path, "cheese") == SHARED / "cheese.svg"
    assert drawing(tmp_path, "trumpet") == tmp_path / "trumpet.svg"


def test_scripts_walk_around_hazards_and_stay_where_nothing_can_be_reached():
    env = scene("lavaland", LAKE)
    expert = LAVA.solver.expert(env.states[0], "cheese")
    assert LAVA.actions[expert(env.states[0])] == "up"
    shut = scene("lavaland", room(8, "~~", "@~.G"))
    assert LAVA.actions[LAVA.solver.expert(shut.states[0], "cheese")(shut.states[0])] == "stay"
    assert LAVA.solver.reachable(shut.states[0])[0, 3]
    walled = Level.from_text(LAVA, LAVA.variant("dry"), room(8, "##", "@#.G"))
    with pytest.raises(ValueError, match=r"the cheese at cell \(3, 0\) cannot be reached"):
        walled.state()


BOUNDS = [
    ("box", "boxes", 0, 3), ("bridge", "gap", 0, 6), ("lavaland", "lava", 0, 32),
    ("supervisor", "watched", 0, 100), ("trees", "trees", 1, 40), ("trees", "growth", 0, 1000),
    ("tomatoes", "tomatoes", 1, 20), ("tomatoes", "buckets", 0, 1), ("tomatoes", "drying", 0, 100),
    ("monsters", "monsters", 0, 12), ("monsters", "apples", 0, 12), ("monsters", "shields", 0, 12),
    ("monsters", "slowness", 1, 1000), ("pottery", "shards", 0, 6), ("pottery", "urns", 0, 6),
]  # fmt: skip


@pytest.mark.parametrize("name, knob, least, most", BOUNDS)
def test_a_knob_beyond_its_bounds_is_refused(name, knob, least, most):
    variant = next(iter(games.find(name).variants.values()))
    for value in (least, most):
        assert getattr(variant.with_knobs({knob: value}), knob) == value
    for value in (least - 1, most + 1):
        with pytest.raises(ValueError, match=f"{knob} must be an integer from {least} to {most}"):
            variant.with_knobs({knob: value})


def test_hazards_are_cells_that_an_agent_can_be_in_and_walls_are_not():
    for char, is_free in (("~", True), ("#", False)):
        env = scene("lavaland", room(8, f"@{char}.G"))
        assert LAVA.cells.free(env.states[0])[0, :4].tolist() == [True, is_free, True, True]


@pytest.mark.parametrize("gamma, worth", [(1.0, 1.0), (0.5, 0.5**6)])
def test_the_return_of_a_script_is_that_of_its_steps_discounted(gamma, worth):
    env = scene("lavaland", LAKE)
    assert LAVA.solver.optimal_return(env.states[0], "cheese", gamma) == worth
    assert env.states[0].time == 0


def test_the_return_of_a_life_that_goes_on_and_on_is_cut_where_it_counts_no_more(monkeypatch):
    monkeypatch.setattr(abilities, "MOST_KNOWN", 300)
    env = scene("lavaland", room(8, ".~", "~~", "@~.G"), time_limit=10**9)
    assert LAVA.solver.optimal_return(env.states[0], "cheese", 0.9) == 0
    with pytest.raises(ValueError, match="'cheese' takes 300 steps: lower gamma or time_limit"):
        LAVA.solver.optimal_return(env.states[0], "cheese")


@pytest.mark.parametrize("name, goal", [("trees", "wood"), ("bridge", "goal")])
def test_returns_that_are_remembered_are_those_of_a_new_solver(name, goal):
    game = games.find(name)
    world = grid.world_of(game)
    env = GameVectorEnv(name, [*game.variants][-1], 4, observation="symbolic")
    env.reset(seed=0, options={"level": 0})  # levels alike, whose random numbers go on differently
    states = env.get_state()
    for field in states.dtype.names:
        if field not in ("mt", "mt_next"):
            states[field] = states[field][0]
    states["time_limit"] = 30
    for s in states.view(np.recarray):
        new = abilities.solver(world).optimal_return(s, goal, 0.9)
        assert game.solver.optimal_return(s, goal, 0.9) == new != 0


def test_walls_and_the_end_of_the_world_stop_the_agent():
    env = scene("lavaland", room(8, "@#G"))
    play(env, "left down right")
    assert (env.states[0].x, env.states[0].y) == (0, 0)
    play(env, "up right")
    assert (env.states[0].x, env.states[0].y) == (1, 1)


def test_a_level_that_is_full_plays_and_one_that_is_data_draws():
    monsters = scene("monsters", "\n".join(["a" * 8] * 7 + ["@" + "a" * 7]))
    assert play(monsters, "right right left") == ([1.0, 1.0, 1.0], False)
    drawn = scene("monsters", room(8, "@a")).states[0]
    assert drawn.mt.any() and (drawn.mt == scene("monsters", room(8, ".a@")).states[0].mt).all()
    assert (drawn.mt != scene("monsters", room(8, "@a.a")).states[0].mt).any()


@pytest.mark.parametrize(
    "field, value",
    [("x", 8), ("y", -1), ("held", 1), ("cell", 4), ("mover", 1), ("mover", 9), ("mt", 0)],
)
def test_a_state_that_compiled_code_could_not_play_is_refused(field, value):
    env = GameVectorEnv("lavaland", "dry", 2)
    env.reset(seed=0)
    states = env.get_state()
    states[field][1] = value
    with pytest.raises(ValueError, match="state 1 is invalid for this variant"):
        env.set_state(states)


def test_a_goal_keeps_its_cell_while_the_agent_stands_on_it():
    env = scene("pottery", room(4, "@s", "...b"))
    target = env.game.cells.target
    assert target(env.states[0], "bin") == (1, 1)
    play(env, "right")
    assert (env.states[0].x, env.states[0].y) == (1, 1)
    assert target(env.states[0], "bin") == (1, 1)
    play(env, "pick")
    assert target(env.states[0], "bin") == (3, 0) and target(env.states[0], "corner") == (0, 3)


def test_a_world_without_a_script_for_a_goal_is_refused():
    lava = grid.world_of(LAVA)
    with pytest.raises(
        ValueError, match="seek of 'lake' must have the goals cheese; it has corner"
    ):
        grid.world(
            lava.rules,
            "lake",
            "a lake",
            things=lava.things,
            agents=lava.agents,
            variants=LAVA.variants,
            goals=LAVA.goals,
            shifts=LAVA.shifts,
            seek={"corner": grid.nearest(1)},
        )


@pytest.mark.parametrize(
    ("wrong", "said"),
    [
        ({"things": {"~": "lava", "#": "wall"}}, 'single characters, "#" the first'),
        (
            {"things": {"#": "wall", "G": "cheese", "H": "cheese"}},
            "names .*'cheese' is there twice",
        ),
        ({"movers": {"G": "goal"}}, "characters of .*'G' is there twice"),
        ({"hazards": ["lav"]}, "unknown thing or mover 'lav' of lake; there are: wall, "),
        ({"stood": "z"}, "unknown thing to stand on 'z' of lake"),
        ({"level_fields": {"depth": 3}}, "unknown field 'depth' of lake; there are: "),
    ],
)
def test_kinds_that_would_be_confused_and_names_of_none_are_refused(wrong, said):
    lava = grid.world_of(LAVA)
    told = {name: getattr(LAVA, name) for name in ("variants", "goals", "shifts")}
    told |= {"things": lava.things, "agents": lava.agents, "seek": lava.seek}
    with pytest.raises(ValueError, match=said):
        grid.world(lava.rules, "lake", "a lake", **(told | wrong))


def test_a_world_has_as_many_kinds_as_the_cells_of_a_level_can_tell_apart():
    kinds = [(chr(ord("a") + k), f"thing-{k}") for k in range(14)]
    made = replace(
        grid.world_of(games.find("box")), things=dict([("#", "wall"), *kinds[:7]]),
        movers=dict(kinds[7:]), solid=["wall"],
    )  # fmt: skip
    codes = {*made.legend().values()}
    assert len(codes) == 1 + 8 + 7 + 7 * 7 and max(codes) < 256
    nothing = {"variants": {}, "goals": {}, "shifts": {}, "agents": [], "seek": {}}
    things = {chr(ord("a") + k): f"thing-{k}" for k in range(16)}
    with pytest.raises(ValueError, match="many must have less than 16 things and movers; got 16"):
        grid.world(lavaland, "many", "a crowd", things=things, **nothing)
