"""The best order of keys and chests, and the walks between them."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from astray.games.keys import rules
from astray.games.keys.levels import truths
from astray.games.keys.rules import CHEST, CHEST_X, CHEST_Y, KEY, KEY_X, KEY_Y, REWARD, STATE, step
from astray.games.keys.variants import GOALS
from astray.kernel import maze
from astray.kernel.grid import STAY, UNREACHABLE, distances
from astray.kernel.jit import entry, shared
from astray.kernel.maze import WALL
from astray.kernel.thief import F, move, press, touches, towards
from astray.record import NEVER, check_record
from astray.validation import finite, one_of

EXACT = 12  # objects; of more, the nearest are ordered, and all anew after each
PATIENCE = 8  # steps a cell after which a walk is given up
HURRY = 1e-6  # worth of a step: of orders that are worth the same the fastest is best

check = functools.partial(check_record, rules=rules, truths=truths)


@shared
def walk(s, steps, objects, target, most):
    """Walk until `objects[target]` is touched.

    It returns the number of steps, or UNREACHABLE if there are more than `most`, and a bit mask of
    the other objects touched on the way.
    """
    met = 0
    for time in range(1, most + 1):
        move(s, press(s, steps), 0, 0)
        for i in range(objects.size):
            k = objects[i]
            is_key = s.what[k] == KEY
            if (is_key and touches(s, k, KEY_X, KEY_Y)) or (
                not is_key and touches(s, k, CHEST_X, CHEST_Y)
            ):
                if i == target:
                    return time, met
                met |= 1 << i
    return UNREACHABLE, met


@entry
def tables(s, objects, fields):
    """Return walking times from the thief [0] or objects [1 + i] to objects [j], and contacts.

    Times are [1 + n, n] int64 steps, or UNREACHABLE. Contacts are [1 + n, n] int64, a bit mask of
    the objects touched on the way. From an object the thief starts at rest in the middle of its
    cell.

    Args:
        s: State, whose position and speed are overwritten.
        objects: [n], numbers of objects in s.
        fields: [n, world, world], steps to them.
    """
    n = objects.size
    times, met = np.full((n + 1, n), UNREACHABLE), np.zeros((n + 1, n), np.int64)
    x, y, vx, vy = s.x, s.y, s.vx, s.vy
    for i in range(n + 1):
        for j in range(n):
            s.x, s.y, s.vx, s.vy = x, y, vx, vy
            if i > 0:
                s.x = F(np.floor(s.object_x[objects[i - 1]])) + F(0.5)
                s.y = F(np.floor(s.object_y[objects[i - 1]])) + F(0.5)
                s.vx, s.vy = F(0), F(0)
            cells = fields[j, int(s.y), int(s.x)]
            if i != j + 1 and cells != UNREACHABLE:
                times[i, j], met[i, j] = walk(s, fields[j], objects, j, PATIENCE * (cells + 2))
    return times, met


@entry
def best_order(times, met, is_key, hand, to_open, key_worth, chest_worth, step_worth, gamma):
    """Return the most valuable order of objects [n] int64, by dynamic programming over subsets.

    It is exact. After the last object that is worth taking, the order is -1.

    Args:
        times, met: Results of `tables`.
        is_key: [n] bool.
        hand: Number of keys in hand.
        to_open: Number of chests until the end.
    """
    n = is_key.size
    value = np.zeros((1 << n, n + 1))
    first = np.full((1 << n, n + 1), -1)
    for done in range((1 << n) - 1, -1, -1):
        keys, opened, pays = 0, 0, False
        for i in range(n):
            if done >> i & 1:
                keys += is_key[i]
                opened += not is_key[i]
            elif (key_worth if is_key[i] else chest_worth) != 0:
                pays = True
        has_key = hand + keys > opened
        if hand + keys < opened or opened >= to_open or not pays:
            continue
        for last in range(n + 1):
            if (last == 0) != (done == 0) or (last > 0 and not done >> (last - 1) & 1):
                continue
            best = -np.inf
            for j in range(n):
                if done >> j & 1 or times[last, j] == UNREACHABLE or not (is_key[j] or has_key):
                    continue
                # What is taken or opened on the way is a step of its own in another order.
                on_way = met[last, j] & ~done
                direct = True
                for m in range(n):
                    if on_way >> m & 1 and (is_key[m] or has_key):
                        direct = False
                if direct:
                    later = gamma ** times[last, j]
                    worth = key_worth if is_key[j] else chest_worth
                    spent = times[last, j] if gamma == 1 else (1 - later) / (1 - gamma)
                    total = (
                        spent * step_worth
                        - times[last, j] * HURRY
                        + gamma ** (times[last, j] - 1) * worth
                        + later * value[done | 1 << j, j + 1]
                    )
                    if total > best:
                        best, first[done, last] = total, j
            if first[done, last] >= 0:
                value[done, last] = best
    order, done, last = np.full(n, -1), 0, 0
    for i in range(n):
        order[i] = first[done, last]
        if order[i] < 0:
            break
        done, last = done | 1 << order[i], order[i] + 1
    return order


@entry
def leg(s, steps, gamma, time_limit):
    """Play along `steps` until an object is gone or the episode is over.

    It returns the rewards, and 1 for every key, both discounted to the first step.
    """
    rewards, keys, weight, gone = 0.0, 0.0, 1.0, s.taken + s.opened
    while not s.ended and s.taken + s.opened == gone:
        s.time += 1
        taken = s.taken
        reward, done = step(s, press(s, steps))
        rewards, keys = rewards + weight * reward, keys + weight * (s.taken - taken)
        weight *= gamma
        s.ended = done or s.time >= time_limit
    return rewards, keys


class Planner:
    """Scripted player that plans which object to visit next for a goal, and the way there."""

    def __init__(self, s: Any, goal: str, gamma: float):
        one_of("goal", goal, GOALS)
        check(s)
        self.goal, self.gamma = goal, gamma
        self._order: list[int] = []  # as planned, also what of it is gone
        self._gone: set[int] = set()  # what was gone then
        self._asked = -1  # the last step that was asked for
        self._is_open = (s.cell[: s.world, : s.world] != WALL).copy()
        self._fields: dict[int, np.ndarray] = {}

    def steps(self, now: Any) -> np.ndarray | None:
        """Return the steps from every cell to the best next object, [world, world], or None."""
        if now.ended or now[GOALS[self.goal]] != NEVER:
            return None
        gone = set(np.flatnonzero(now.gone[: now.objects] != NEVER).tolist())
        since = len(gone) - len(self._gone)
        as_planned = self._gone <= gone and gone - self._gone == set(self._order[:since])
        if not as_planned or since >= len(self._order):
            self._order, self._gone, since = self._plan(now), gone, 0
        return self._field(now, self._order[since]) if self._order else None

    def action(self, now: Any) -> int:
        """Return the next action; replan if others acted since the last one."""
        check(now)
        if now.time != self._asked + 1:
            self._order = []
        self._asked = int(now.time)
        steps = self.steps(now)
        return STAY if steps is None else int(towards(now, steps))

    def _field(self, now: Any, k: int) -> np.ndarray:
        if k not in self._fields:
            cell = int(now.object_x[k]), int(now.object_y[k])
            self._fields[k] = distances(self._is_open, *cell)
        return self._fields[k]

    def _plan(self, now: Any) -> list[int]:
        """Return objects in the best order; only the first if there are too many to order."""
        there = np.flatnonzero(now.gone[: now.objects] == NEVER).tolist()
        away = {k: int(self._field(now, k)[int(now.y), int(now.x)]) for k in there}
        there = [k for k in there if away[k] != UNREACHABLE]
        chosen = there if len(there) <= EXACT else _nearest(now, there, away)
        if not chosen:
            return []
        objects = np.array(chosen)
        fields = np.stack([self._field(now, k) for k in chosen])
        times, met = tables(np.array([now], STATE)[0], objects, fields)
        needed = min(now.keys, now.chests) - now.opened
        worth = (1.0, 0.0, 0.0)
        if self.goal == "chests":
            worth = (-float(now.key_penalty), REWARD, -float(now.step_penalty))
        order = best_order(
            times,
            met,
            now.what[objects] == KEY,
            int(now.taken - now.opened),
            int(needed),
            *worth,
            self.gamma,
        )
        order = [chosen[i] for i in order if i >= 0]
        return order if len(there) == len(chosen) else order[:1]


def _nearest(now: Any, there: list[int], away: dict[int, int]) -> list[int]:
    """Return the nearest EXACT objects, half of them keys if there are enough."""
    there = sorted(there, key=away.__getitem__)
    keys = [k for k in there if now.what[k] == KEY]
    chests = [k for k in there if now.what[k] == CHEST]
    half = max(EXACT // 2, EXACT - len(chests))
    keys = keys[:half]
    return sorted(keys + chests[: EXACT - len(keys)])


def expert(s: Any, goal: str) -> Callable[[Any], int]:
    """Return a policy that reaches `goal` by the best order of objects, then stays.

    "chests" takes the fewest steps until all possible chests are open, without unneeded keys.
    "keys" ends when all keys are taken, and opens chests on the way.
    """
    return Planner(s, goal, 1.0).action


def optimal_return(s: Any, goal: str, gamma: float = 1.0) -> float:
    """Return the discounted return of the best order from state `s`, as `expert` walks it.

    It can be negative where keys cost more than the chests that they open. The order is exact for
    up to EXACT objects, with walking times from rest. A player who cuts corners can be a few steps
    faster.

    Args:
        goal: "chests" for the game's rewards; "keys" for 1 per key.
    """
    finite("gamma", gamma, 0, 1)
    return max(_played(s, goal, gamma, plan) for plan in {gamma, 1.0})


def _played(s: Any, goal: str, gamma: float, plan: float) -> float:
    """Return the return, discounted by `gamma`, of the best order for the discount `plan`."""
    planner, now, total = Planner(s, goal, plan), np.array([s], STATE)[0], 0.0
    while (steps := planner.steps(now)) is not None:
        weight = gamma ** int(now.time - s.time)
        rewards, keys = leg(now, steps, gamma, int(now.time_limit))
        total += weight * (rewards if goal == "chests" else keys)
    return total


def reachable(s: Any) -> np.ndarray:
    """Return the cells that the thief can walk to, [world, world] bool."""
    check(s)
    return maze.reachable(s)
