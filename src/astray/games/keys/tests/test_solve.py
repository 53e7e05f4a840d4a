"""The best order, against all orders; the player that follows it; what is measured by it."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from astray.envs.vector import GameVectorEnv
from astray.games.keys import GAME, measures, solve
from astray.games.keys.rules import CHEST, KEY
from astray.games.keys.variants import VARIANTS, Keys
from astray.level import Level

SMALL = VARIANTS["many-keys-small"]


def worth(order, times, met, is_key, hand, to_open, worths, gamma):
    """Return the worth of an order, step by step; None if it cannot be walked."""
    total, clock, last, done, opened = 0.0, 0, 0, set(), 0
    for j in order:
        if opened == to_open:
            break
        passed = [m for m in range(len(is_key)) if met[last, j] >> m & 1 and m not in done]
        if any(is_key[m] or hand > 0 for m in passed) or not (is_key[j] or hand > 0):
            return None
        for _ in range(times[last, j]):
            total += gamma**clock * worths[2]
            clock += 1
        total += gamma ** (clock - 1) * (worths[0] if is_key[j] else worths[1])
        hand += 1 if is_key[j] else -1
        opened += not is_key[j]
        last, done = j + 1, done | {j}
    return total


@pytest.mark.parametrize("gamma", [1.0, 0.9])
@pytest.mark.parametrize("worths", [(0.0, 1.0, 0.0), (-0.3, 1.0, -0.02), (1.0, 0.0, 0.0)])
def test_no_order_is_worth_more_than_the_best(gamma, worths):
    rng = np.random.default_rng(0)
    for _ in range(4):
        n = 6
        is_key = rng.random(n) < 0.5
        is_key[0] = True
        times = rng.integers(1, 20, (n + 1, n))
        met = np.where(rng.random((n + 1, n)) < 0.3, 1 << rng.integers(n, size=(n + 1, n)), 0)
        met &= ~(1 << np.arange(n))  # what is walked to is not on the way
        hand, to_open = int(rng.integers(2)), max(min(is_key.sum(), (~is_key).sum()), 1)
        problem = (times, met, is_key, hand, int(to_open), *worths)
        order = [k for k in solve.best_order(*problem, gamma) if k >= 0]
        args = (times, met, is_key, hand, to_open, worths, gamma)
        # Orders that are as long as can be: none goes on after the last step of another.
        every = {o[:k] for o in permutations(range(n)) for k in [_length(o, args)] if k}
        values = {o: worth(o, *args) - 1e-6 * _steps(o, times) for o in every}
        best = max(v for v in values.values())
        assert worth(order, *args) - 1e-6 * _steps(order, times) == pytest.approx(best, abs=2e-5)


def _length(order, args):
    """Return the length of an order up to the last gain; 0 if more could be reached."""
    is_key, to_open, worths = args[2], args[4], args[5]
    for k in range(len(order) + 1):
        left = set(range(len(order))) - set(order[:k])
        pays = any(worths[0] if is_key[j] else worths[1] for j in left)
        if not pays or sum(not is_key[j] for j in order[:k]) == to_open:
            return k
        if worth(order[: k + 1], *args) is None:
            stuck = all(worth((*order[:k], j), *args) is None for j in left)
            return k if stuck else 0
    raise AssertionError("nothing is left, and it pays")


def _steps(order, times):
    return sum(times[i, j] for i, j in zip((0, *(j + 1 for j in order[:-1])), order, strict=True))


def begin(variant, level):
    env = GameVectorEnv("keys", variant, observation="symbolic", autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": level})
    return env


def follow(env, goal, gamma=1.0):
    """The discounted return of the player of `goal`."""
    guide, total, s = GAME.solver.expert(env.states[0], goal), 0.0, env.states[0]
    while not s.ended and s[GAME.goals[goal]] < 0:
        total += gamma ** int(s.time) * env.step(np.array([guide(s)]))[1][0]
    return total


@pytest.mark.parametrize("name", ["many-chests", "many-keys", "many-keys-small"])
def test_all_chests_are_opened_in_every_level(name):
    for level in range(15):
        env = begin(VARIANTS[name], level)
        s = env.states[0]
        most = min(s.keys, s.chests)
        assert GAME.solver.optimal_return(s, "chests", 1.0) == most
        assert follow(env, "chests") == most


def test_who_looks_no_step_ahead_gets_nothing_from_afar():
    s = begin(VARIANTS["many-chests"], 0).states[0]
    assert [GAME.solver.optimal_return(s, goal, 0.0) for goal in GAME.goals] == [0, 0]


def test_the_player_of_chests_leaves_keys_that_the_player_of_keys_takes():
    beyond = {goal: [] for goal in GAME.goals}
    for goal, level in [(goal, level) for goal in GAME.goals for level in range(20)]:
        env = begin(VARIANTS["many-keys"], level)
        follow(env, goal)
        beyond[goal].append(measures.keys_beyond_need(env.states)[0])
    assert np.mean(beyond["keys"]) > 3 > 1 > np.mean(beyond["chests"])


def test_a_key_behind_the_thief_is_left_where_it_is():
    variant = Keys(about="", world=7, largest=7)
    walls = "#######\n" * 3
    level = Level.from_text(GAME, variant, walls + "k.@kC..\n" + walls)
    env = GameVectorEnv("keys", variant, observation="symbolic", autoreset_mode="Disabled")
    for goal, taken in (("chests", 1), ("keys", 2)):
        env.set_state(level.state())
        follow(env, goal)
        assert env.states[0].taken == taken


def test_no_random_player_is_faster_than_the_best():
    best = [
        GAME.solver.optimal_return(begin(SMALL, k).states[0], "chests", 0.99) for k in range(20)
    ]
    env = GameVectorEnv("keys", SMALL, 20, observation="symbolic", autoreset_mode="Disabled")
    rng = np.random.default_rng(0)
    for _ in range(10):
        env.reset(seed=0, options={"level": np.arange(20)})
        total, over = np.zeros(20), np.zeros(20, bool)
        while not over.all():
            time = env.states["time"].copy()
            _, reward, terminated, truncated, _ = env.step(rng.integers(9, size=20))
            total += np.where(over, 0, 0.99**time * reward)
            over |= terminated | truncated
            if env.states["ended"].any():  # the rest go on
                env.reset(options={"reset_mask": env.states["ended"].copy()})
        assert (total <= np.array(best) + 1e-9).all()


def test_a_guide_starts_from_the_middle_of_an_episode_too():
    env = begin(VARIANTS["many-keys"], 0)
    for action in np.random.default_rng(0).integers(9, size=200):
        env.step(np.array([action]))
    follow(env, "chests")
    assert env.states[0].all_chests > 200


def test_unknown_goals_are_explained():
    with pytest.raises(ValueError, match="unknown goal 'cheese'; there are: chests, keys"):
        GAME.solver.expert(begin(SMALL, 0).states[0], "cheese")


def test_what_cannot_be_reached_is_not_walked_to():
    variant = Keys(about="", world=5, largest=5)
    level = Level.from_text(GAME, variant, "#####\n#@.C#\n#####\n#k..#\n#####")
    s = level.state(solvable=False)
    assert GAME.solver.optimal_return(s, "chests", 1.0) == 0
    assert GAME.solver.expert(s, "chests")(s) == GAME.actions.index("stay")


def test_measures_tell_what_was_done():
    variant = replace(SMALL, key_penalty=0.25, step_penalty=0.125)
    ended, returns = [], []
    for level, goal in [(1, "chests"), (0, "keys"), (3, "keys")]:
        env = begin(variant, level)
        returns.append(follow(env, goal, 0.9))
        ended.append(env.states[0].copy())
    states = np.array(ended, GAME.state)
    assert measures.discounted_return(states, 0.9) == pytest.approx(returns)
    spare = [(s.gone[s.what == KEY] >= 0).sum() - (s.what == CHEST).sum() for s in ended]
    assert measures.keys_beyond_need(states).tolist() == [max(k, 0) for k in spare] and any(spare)


def test_keys_in_hand_are_told_of_openings():
    variant = Keys(about="", world=7, largest=7)
    walls = "#######\n" * 3
    level = Level.from_text(GAME, variant, walls + "@kkC.C.\n" + walls)
    env = GameVectorEnv("keys", variant, observation="symbolic", autoreset_mode="Disabled")
    env.set_state(level.state())
    assert np.isnan(measures.keys_in_hand(env.states)[0])
    follow(env, "chests")
    assert measures.keys_in_hand(env.states)[0] == 1.5  # two, then one


def small(level):
    env = GameVectorEnv("keys", SMALL, 1, observation="symbolic")
    env.reset(seed=0, options={"level": np.array([level])})
    return env


def walk(env, guide, steps=10**6):
    """Return the actions of an expert until its episode ends, it stays, or for some steps."""
    actions, stay = [], GAME.actions.index("stay")
    while not env.states[0].ended and len(actions) < steps:
        actions.append(guide(env.states[0]))
        if actions[-1] == stay:
            break
        env.step(np.array(actions[-1:]))
    return actions


@pytest.mark.parametrize("goal", ["chests", "keys"])
def test_an_expert_takes_over_as_well_as_one_that_is_asked_there_first(goal):
    handed_over, longer = 0, []
    for level in range(16):
        one, two = small(level), small(level)
        guide = GAME.solver.expert(one.states[0], goal)
        random = np.random.default_rng(level)
        guide(one.states[0])
        for action in random.integers(9, size=60):
            if not one.states[0].ended:
                one.step(np.array([action])), two.step(np.array([action]))
        s = one.states[0]
        if s.ended or s[GAME.goals[goal]] >= 0 or (s.gone[: s.objects] < 0).all():
            continue
        handed_over += 1
        longer.append(len(walk(one, guide)) - len(walk(two, GAME.solver.expert(s.copy(), goal))))
        reached = [env.states[0][GAME.goals[goal]] >= 0 for env in (one, two)]
        assert reached[0] == reached[1], level
    assert handed_over > 4 and not any(longer)


def test_an_expert_begins_a_level_anew_however_its_last_episode_was_left():
    for level in range(8):
        env = small(level)
        guide = GAME.solver.expert(env.states[0], "chests")
        first = walk(env, guide)
        walk(small(level), guide, len(first) // 2)
        assert walk(small(level), guide) == first, level
