"""The fewest cells to the gem or to all keys, against a search that is written step by step."""

from collections import deque

import numpy as np
import pytest

from astray.envs.vector import GameVectorEnv
from astray.games.heist import GAME, measures, solve
from astray.games.heist.rules import DOOR_CODE, GEM, KEY
from astray.games.heist.variants import VARIANTS, Heist
from astray.kernel.maze import WALL
from astray.level import Level


def begin(variant, level):
    env = GameVectorEnv("heist", variant, observation="symbolic", autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": level})
    return env


def naive(s, goal):
    """Cells to `goal` from where the thief is: forward, with sets; None where there is no way."""
    grid, start = GAME.editing.grid(s), (int(s.x), int(s.y), frozenset())
    wanted = {int(what) - KEY for what in grid[(grid >= KEY) & (grid < DOOR_CODE)]}
    steps, queue = {start: 0}, deque([start])
    while queue:
        x, y, hand = state = queue.popleft()
        if grid[y, x] == GEM if goal == "gem" else wanted and hand == wanted:
            return steps[state]
        for u, v in ((x + 1, y), (x - 1, y), (x, y + 1), (x, y - 1)):
            if not (0 <= u < len(grid) and 0 <= v < len(grid)):
                continue
            what = int(grid[v, u])
            if what == WALL or (what == GEM and goal == "keys"):
                continue
            if DOOR_CODE <= what < GEM and what - DOOR_CODE not in hand:
                continue
            there = (u, v, hand | {what - KEY} if KEY <= what < DOOR_CODE else hand)
            if there not in steps:
                steps[there] = steps[state] + 1
                queue.append(there)
    return None


@pytest.mark.parametrize("goal", GAME.goals)
@pytest.mark.parametrize("name", ["hard", "near", "near-memory"])
def test_no_way_is_shorter_than_the_shortest(name, goal):
    for level in range(60):
        s = begin(VARIANTS[name], level).states[0]
        found = solve.steps_to(s, goal)[s.hand, int(s.y), int(s.x)]
        assert found == (-1 if naive(s, goal) is None else naive(s, goal))


@pytest.mark.parametrize("name", ["hard", "easy", "near", "near-small"])
def test_the_gem_is_reached_in_every_level(name):
    for level in range(40):
        env = begin(VARIANTS[name], level)
        s, guide = env.states[0], GAME.solver.expert(env.states[0], "gem")
        worth, total = GAME.solver.optimal_return(s, "gem", 0.99), 0.0
        while not s.ended:
            total += 0.99 ** int(s.time) * env.step(np.array([guide(s)]))[1][0]
        assert total == pytest.approx(worth) and s.reached_gem == s.time < 200


def test_the_player_of_keys_takes_them_all_and_leaves_the_gem():
    reached = 0
    for level in range(60):
        env = begin(VARIANTS["near"], level)
        s, guide = env.states[0], GAME.solver.expert(env.states[0], "keys")
        while GAME.actions[guide(s)] != "stay":
            env.step(np.array([guide(s)]))
        assert s.reached_gem == -1 and (s.all_keys >= 0) == (naive_keys(level) is not None)
        reached += s.all_keys >= 0
    assert reached > 20


def naive_keys(level):
    return naive(begin(VARIANTS["near"], level).states[0], "keys")


def test_no_key_is_taken_that_is_not_on_the_way_of_the_player_of_the_gem():
    spared = 0
    for level in range(40):
        env = begin(VARIANTS["near"], level)
        s, guide = env.states[0], GAME.solver.expert(env.states[0], "gem")
        while not s.ended:
            env.step(np.array([guide(s)]))
        spared += s.hand != s.keys
    assert spared > 20


def test_an_expert_takes_over_in_the_middle_of_an_episode():
    for level in range(10):
        env = begin(VARIANTS["hard"], level)
        s, guide = env.states[0], GAME.solver.expert(env.states[0], "gem")
        for action in np.random.default_rng(level).integers(9, size=100):
            if not s.ended:
                env.step(np.array([action]))
        worth = s.ended or GAME.solver.optimal_return(s, "gem")
        while not s.ended:
            env.step(np.array([guide(s)]))
        assert s.reached_gem > 0 and worth


def test_what_cannot_be_reached_is_not_walked_to():
    five = Heist(about="", world=5, largest=5)
    s = Level.from_text(GAME, five, "#####\n#@.B*\n#####\n#b..#\n#####").state(solvable=False)
    for goal in GAME.goals:
        assert GAME.solver.optimal_return(s, goal) == 0
        assert GAME.actions[GAME.solver.expert(s, goal)(s)] == "stay"
    with pytest.raises(ValueError, match="unknown goal 'cheese'; there are: gem, keys"):
        GAME.solver.expert(s, "cheese")


def test_labels_tell_of_keys_and_doors():
    env = begin(VARIANTS["hard"], 2)
    s, guide = env.states[0], GAME.solver.expert(env.states[0], "gem")
    before = measures.LABELS["doors left"](env.states)[0]
    while s.opened_blue < 0:
        env.step(np.array([guide(s)]))
    assert measures.LABELS["doors left"](env.states)[0] == before - 1
    assert measures.LABELS["blue key in hand"](env.states)[0]
