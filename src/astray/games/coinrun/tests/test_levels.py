"""Promises of every variant about its levels, on hundreds of them."""

import json
from dataclasses import replace

import numpy as np
import pytest

from astray.envs.vector import GameVectorEnv
from astray.games.coinrun import GAME
from astray.games.coinrun.rules import COIN, CRATE, INVISIBLE, LAVA, PERMEABLE, SAW, TOP, WALL
from astray.games.coinrun.solve import plan
from astray.games.coinrun.variants import VARIANTS
from astray.level import Level
from astray.record import NEVER

N = 1000


def levels(variant, count=N, first=0):
    env = GameVectorEnv("coinrun", variant, count, observation="symbolic")
    env.reset(seed=0, options={"level": np.arange(first, first + count)})
    return env.states


@pytest.mark.parametrize("name", VARIANTS)
def test_coins_and_invisible_coins_are_where_the_variant_says(name):
    variant, s = VARIANTS[name], levels(VARIANTS[name], 300)
    coins, invisible = (s["cell"] == COIN).sum((1, 2)), (s["cell"] == INVISIBLE).sum((1, 2))
    assert set(coins) == {{"one": 1, "two": 2, "none": 0}[variant.coins]}
    # The released game has no random place, and so no invisible coin; ours with one has.
    released = variant.numbering == "procgen" and not variant.random_coin
    assert (coins + invisible == (1 if released else 2)).all()
    k = np.arange(len(s))
    at_end = s["cell"][k, s["end_y"], s["end_x"]]
    expected = variant.random_coin if variant.coins == "one" else variant.coins == "none"
    assert abs((at_end == INVISIBLE).mean() - expected) < 0.1
    assert ((s["coin_x"] == NEVER) == (coins == 0)).all()


def test_the_layout_does_not_depend_on_where_the_coin_is():
    bare = [
        np.where(np.isin(s["cell"], (COIN, INVISIBLE)), 0, s["cell"])
        for s in map(
            levels, (replace(VARIANTS["coin-ledge"], random_coin=p) for p in (0.0, 0.013, 0.5, 1.0))
        )
    ]
    assert all(np.array_equal(bare[0], other) for other in bare[1:])


def test_more_probability_keeps_the_coins_that_were_random():
    rare, often = (
        levels(replace(VARIANTS["coin-ledge"], random_coin=p), 5000) for p in (0.005, 0.3)
    )
    moved = [s["coin_x"] != s["end_x"] for s in (rare, often)]
    assert abs(moved[0].mean() - 0.005) < 0.002 and abs(moved[1].mean() - 0.3) < 0.015
    assert (moved[1] | ~moved[0]).all()


def test_the_originals_random_coin_is_mostly_near_and_anywhere_is_not():
    ledge, anywhere = levels(VARIANTS["coin-ledge"]), levels(VARIANTS["coin-anywhere"])
    assert abs((ledge["coin_x"] == 5).mean() - 0.559) < 0.05
    assert (anywhere["coin_x"] <= 5).mean() < 0.4
    fraction = (anywhere["coin_x"] - 1) / anywhere["end_x"]
    # Over places to stand: about as often in each quarter of the way.
    assert np.histogram(fraction, 4, (0, 1))[0].min() > 0.15 * N


@pytest.mark.parametrize("name", ["coin-anywhere", "coin-anywhere-long", "coin-twice-anywhere"])
def test_a_coin_anywhere_can_be_taken(name):
    """Uses the solver, which avoids walkers, too."""
    for s in levels(VARIANTS[name], 40, first=500):
        assert GAME.solver.optimal_return(s, "coin", 1.0) == 10


def test_every_end_can_be_reached():
    for s in levels(VARIANTS["coin-end"], 60, first=100):
        assert GAME.solver.optimal_return(s, "coin", 1.0) == 10


def test_the_way_to_the_end_is_blind_to_the_coin():
    absent = replace(VARIANTS["coin-ledge"], coins="none", random_coin=0.0)
    pairs = zip(levels(VARIANTS["coin-ledge"], 20), levels(absent, 20), strict=True)
    assert all((plan(one, "end") == plan(other, "end")).all() for one, other in pairs)


def test_a_wall_that_does_not_fit_ends_with_the_world():
    s = levels(replace(VARIANTS["coin-end-permeable"], permeable=64), 200)
    assert (s["permeable"] == 63 - s["end_x"]).all()
    for one in s[:20]:
        assert (one.cell[:, one.end_x + 1 :] == PERMEABLE).all()
    narrow = levels(replace(VARIANTS["coin-end-permeable"], permeable=2), 50)
    for one in narrow[:20]:
        assert (one.cell == PERMEABLE).any(0).sum() == 2
        assert GAME.solver.optimal_return(one, "beyond", 1.0) == 10


def test_without_hazards_there_are_none_and_no_pits():
    s = levels(replace(VARIANTS["coin-end"], hazards=False))
    assert s["walkers"].max() == 0 and not (s["thing"] == SAW).any()
    walls = np.isin(s["cell"], (WALL, TOP))
    for one, solid in zip(s[:200], walls, strict=False):
        column = solid[: one.end_y + 20, 5 : one.end_x]
        assert (np.diff(column.astype(int), axis=0) <= 0).all()  # nothing hollow


def test_sections_and_difficulty_are_as_told():
    one = levels(replace(VARIANTS["coin-end"], sections=1, difficulty=1))
    assert set(one["end_x"]) == {8, 9}
    five = levels(replace(VARIANTS["coin-end"], sections=5, difficulty=3))
    assert five["end_x"].min() >= 25 and five["end_x"].max() <= 50


def test_easy_levels_look_alike_and_have_walkers_in_pits_alone():
    s = levels(VARIANTS["coin-end-easy"])
    assert not s["background"].any() and not s["ground"].any() and not s["runner_look"].any()
    assert 0 < (s["walkers"] > 0).mean() < 0.15
    assert (s["walker_y"][s["walkers"] > 0, 0] == 1.5).all()


@pytest.mark.parametrize("name", ["coin-end", "coin-anywhere", "coin-end-permeable", "coin-twice"])
def test_a_described_level_plays_on_as_the_original(name):
    variant, played = VARIANTS[name], 0
    one, two = (GameVectorEnv("coinrun", variant, autoreset_mode="Disabled") for _ in range(2))
    for number in range(10):
        one.reset(seed=0, options={"level": number})
        data = json.loads(json.dumps(GAME.editing.describe(one.states[0])))
        two.set_state(Level.from_json(GAME, variant, data).state(solvable=False))
        for action in np.random.default_rng(number).choice([7, 8, 8, 7, 4, 2], (60, 1)):
            ours, theirs = one.step(action), two.step(action)
            assert np.array_equal(ours[0], theirs[0]) and ours[1:3] == theirs[1:3]
            played += 1
            if one.states["ended"][0]:
                break
    assert played > 200


def test_a_level_survives_being_drawn_and_edited():
    level = Level.of(GAME, VARIANTS["coin-end"], levels(VARIANTS["coin-end"], 1)[0])
    again = Level.from_text(GAME, level.variant, str(level))
    assert np.array_equal(again.cells, level.cells) and again.agent == level.agent
    moved = level.moved("coin", (6, 20)).state(solvable=False)
    assert (moved.coin_x, moved.coin_y) == (6, 20)
    fewer = level.removed("walker to the left").state()
    assert fewer.walkers == 0
    with pytest.raises(ValueError, match="coin at cell"):
        level.moved("coin", (6, 60)).state()


@pytest.mark.parametrize("beneath", ["crate", "coin", "invisible coin", "walker to the left"])
def test_what_a_walker_walked_over_is_still_in_the_level(beneath):
    env = GameVectorEnv("coinrun", "coin-end", observation="symbolic")
    level = Level.of(GAME, env.variant, levels(env.variant, 1)[0]).added(beneath, (10, 30))
    state = np.array([level.state(solvable=False)], GAME.state)
    k = state["walkers"][0]
    state["walkers"], state["walker_x"][0, k], state["walker_y"][0, k] = k + 1, 10.3, 30.5
    state["walker_vx"][0, k], state["walker_look"][0, k] = 0.1, 7
    met = Level.of(GAME, env.variant, state[0])
    assert (10, 30) in met.where(beneath)
    again = met.state(solvable=False)
    assert again.walkers == k + 1
    assert (again.walker_x[k], again.walker_y[k], again.walker_look[k]) == (10.5, 30.5, 7)
    assert (
        again.walker_vx[k] > 0
        and again.detail[30, 10] == level.state(solvable=False).detail[30, 10]
    )
    assert (
        Level.from_json(GAME, env.variant, json.loads(json.dumps(met.to_json())))
        .state(solvable=False)
        .tobytes()
        == again.tobytes()
    )
    with pytest.raises(ValueError, match=r"walkers \[70, 30, 0, 7\] are in no cell or no look"):
        Level(GAME, env.variant, level.cells, level.agent, {"walkers": [[70, 30, 0, 7]]}).state()


@pytest.mark.parametrize("beneath", ["crate", "coin", "invisible coin"])
def test_a_walker_stays_where_the_object_that_it_came_to_is_gone(beneath):
    variant = VARIANTS["coin-end"]
    level = Level.of(GAME, variant, levels(variant, 1)[0]).added(beneath, (10, 30))
    walker = [[10, 30, 0, 7]]  # to the right
    met = replace(level, looks={**level.looks, "walkers": walker})
    fewer, moved = met.removed(beneath, (10, 30)), met.moved(beneath, (12, 30), (10, 30))
    assert (10, 30) in fewer.where("walker to the right") and (12, 30) in moved.where(beneath)
    for one in (fewer, moved):
        s = one.state(solvable=False)
        k = s.walkers - 1
        assert s.walkers == met.state(solvable=False).walkers and "walkers" not in one.looks
        assert [10, 30, 7] in one.looks["details"] and (one.cells == GAME.editing.grid(s)).all()
        assert 10.5 in s.walker_x[s.walker_y == 30.5] and k >= 0
    by_hand = met.to_json()
    by_hand["grid"][30][10] = GAME.editing.LEGEND["."]
    by_hand = {name: by_hand[name] for name in ("grid", "agent", "looks")}
    again = Level.from_json(GAME, variant, by_hand)
    assert again.state(solvable=False).tobytes() == fewer.state(solvable=False).tobytes()


def test_a_moved_crate_or_walker_looks_as_it_did_and_leaves_no_look_behind():
    level = Level.of(GAME, VARIANTS["coin-end"], levels(VARIANTS["coin-end"], 1)[0])
    level = level.added("crate", (6, 30)).added("walker to the left", (8, 30))
    looks = {**level.looks, "details": [*level.looks["details"], [6, 30, 3], [8, 30, 7]]}
    level = replace(level, looks=looks)
    moved = level.moved("crate", (7, 40), (6, 30)).moved("walker to the left", (6, 30), (8, 30))
    s = moved.state(solvable=False)
    assert s.detail[40, 7] == 3 and s.detail[30, 8] == 0 and s.detail[30, 6] == 7
    assert moved.removed("crate", (7, 40)).state(solvable=False).detail[40, 7] == 0
    for one in level.splay("crate", (6, 30))[:3]:
        ((x, y),) = set(one.where("crate")) - set(level.removed("crate", (6, 30)).where("crate"))
        assert one.state(solvable=False).detail[y, x] == 3


@pytest.mark.parametrize(("cell", "thing"), [(COIN, CRATE), (WALL, CRATE), (LAVA, SAW)])
def test_a_state_with_a_thing_on_another_is_no_level(cell, thing):
    variant = VARIANTS["coin-end"]
    s = Level.from_text(GAME, variant, "......o.\n@..c....\n########").state(solvable=False)
    s.cell[1, 5], s.thing[1, 5] = cell, thing
    with pytest.raises(ValueError, match=r"cell \(5, 1\) holds several things; a level has one"):
        Level.of(GAME, variant, s)
