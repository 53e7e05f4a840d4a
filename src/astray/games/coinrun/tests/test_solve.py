"""Experts that take over from others, wherever these have led the runner."""

import numpy as np
import pytest

from astray.envs.vector import GameVectorEnv
from astray.games.coinrun import GAME, solve
from astray.games.coinrun.rules import ACTIONS
from astray.record import NEVER

LEVELS = range(100_000, 100_060)


@pytest.fixture
def searches(monkeypatch):
    """The lengths of the ways that were looked for, in order; 0 for none found."""
    lengths, search = [], solve.search

    def counted(*args):
        found = search(*args)
        lengths.append(len(found))
        return found

    monkeypatch.setattr(solve, "search", counted)
    return lengths


def begin(variant, level):
    env = GameVectorEnv("coinrun", variant, 1, observation="symbolic")
    env.reset(seed=0, options={"level": np.array([level])})
    return env


def stray(env, seed):
    """Some steps at random, mostly to the right; returns the state after them."""
    random = np.random.default_rng(seed)
    likely = [ACTIONS.index(name) for name in ("right", "right", "right-up", "up", "left")]
    for _ in range(random.integers(3, 40)):
        if not env.states[0].ended:
            env.step(random.choice(likely, 1))
    return env.states[0]


def to_the_end(env, guide):
    while not env.states[0].ended:
        env.step(np.array([guide(env.states[0])]))
    return env.states[0]


@pytest.mark.parametrize("variant", ["coin-anywhere", "procgen", "coin-anywhere-calm"])
def test_an_expert_takes_over_wherever_it_is_asked(variant, searches):
    taken_over = 0
    for level in LEVELS:
        env = begin(variant, level)
        guide = GAME.solver.expert(env.states[0], "coin")
        s = stray(env, level)
        if s.ended:
            continue
        guide(s)
        found, count = searches[-1], len(searches)
        end = to_the_end(env, guide)
        assert len(searches) == count  # on its own way it never looks for another
        assert (end.took_coin != NEVER) == (found > 0), level
        taken_over += found > 0
    assert taken_over > 20


def test_who_comes_back_to_the_first_way_goes_on_along_it(searches):
    env = begin("coin-end", LEVELS[0])
    s = env.states[0]
    guide = GAME.solver.expert(s, "coin")
    begun = s.copy()
    for _ in range(3):
        assert guide(begun) == guide(env.states[0])
        env.step(np.array([ACTIONS.index("stay")]))
    assert guide(env.states[0]) == solve.plan(env.states[0], "coin")[0]
    searches.clear()
    guide(begun)
    assert not searches


def test_an_expert_without_a_coin_stays():
    env = begin("coin-absent", LEVELS[0])
    guide = GAME.solver.expert(env.states[0], "coin")
    for name in ("stay", "right", "stay"):
        assert guide(env.states[0]) == ACTIONS.index("stay")
        env.step(np.array([ACTIONS.index(name)]))
