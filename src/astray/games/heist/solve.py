"""The ways through rooms and doors: breadth first over cells and keys in hand."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from astray.games.heist import rules
from astray.games.heist.levels import truths
from astray.games.heist.rules import COLOURS, DOOR_CODE, GEM, KEY, REWARD, STATE, step
from astray.games.heist.variants import GOALS
from astray.kernel.grid import STAY, UNREACHABLE, distances
from astray.kernel.jit import entry, kernel
from astray.kernel.maze import WALL
from astray.kernel.thief import grid, press, towards
from astray.record import NEVER, check_record
from astray.validation import finite, one_of

PATIENCE = 8  # steps a cell after which a walk is given up
HANDS = 1 << len(COLOURS)  # sets of keys in hand, a bit for each colour

check = functools.partial(check_record, rules=rules, truths=truths)


def steps_to(s: Any, goal: str) -> np.ndarray:
    """Return the steps to `goal` by keys in hand and cell, [HANDS, world, world], or UNREACHABLE.

    Without its key, a door is a wall. A key is taken in its cell. For the goal "keys" the gem,
    which ends the level, is a wall.
    """
    one_of("goal", goal, GOALS)
    cells = grid(s)
    if goal == "keys":
        cells[cells == GEM] = WALL
    return layers(cells, int(s.keys) if goal == "keys" else NEVER)


@kernel
def hand_in(cells, hand, x, y):
    """Return the keys in hand after entering a cell with `hand`; NEVER if it cannot be entered."""
    what = int(cells[y, x])
    if KEY <= what < DOOR_CODE:
        return hand | 1 << (what - KEY)
    is_shut = DOOR_CODE <= what < GEM and not hand >> (what - DOOR_CODE) & 1
    return NEVER if is_shut or what == WALL else hand


@entry
def layers(cells, wanted):
    """Compute `steps_to` for a grid: to the keys `wanted`, a bit mask, or to the gem if NEVER."""
    side = cells.shape[0]
    steps = np.full((HANDS, side, side), UNREACHABLE)
    queue = np.empty((steps.size, 3), np.int64)
    first, after = 0, 0
    for hand in range(HANDS):
        for y in range(side):
            for x in range(side):
                is_goal = cells[y, x] == GEM if wanted == NEVER else 0 < wanted == hand
                if is_goal and hand_in(cells, hand, x, y) == hand:
                    steps[hand, y, x] = 0
                    queue[after, 0], queue[after, 1], queue[after, 2] = hand, x, y
                    after += 1
    while first < after:  # backwards: from where, and with which keys, is this a step away?
        hand, x, y = queue[first, 0], queue[first, 1], queue[first, 2]
        first += 1
        for before in range(hand + 1):
            if hand_in(cells, before, x, y) != hand:
                continue
            steps[before, y, x] = steps[hand, y, x]  # who is here without the key takes it
            for k in range(4):
                u, v = x + (k == 0) - (k == 1), y + (k == 2) - (k == 3)
                inside = 0 <= v < side and 0 <= u < side
                if not inside or steps[before, v, u] != UNREACHABLE:
                    continue
                if hand_in(cells, before, u, v) == before:
                    steps[before, v, u] = steps[hand, y, x] + 1
                    queue[after, 0], queue[after, 1], queue[after, 2] = before, u, v
                    after += 1
    return steps


@entry
def walk(s, steps, to_gem):
    """Walk along the steps of `steps_to`; return the time of arrival, or UNREACHABLE."""
    most = s.time + PATIENCE * (steps[s.hand, int(s.y), int(s.x)] + 2)
    while not s.ended and s.time < most and steps[s.hand, int(s.y), int(s.x)] != UNREACHABLE:
        s.time += 1
        _, done = step(s, press(s, steps[s.hand]))
        if (s.reached_gem if to_gem else s.all_keys) == s.time:
            return s.time
        s.ended = done or s.time >= s.time_limit
    return UNREACHABLE


def expert(s: Any, goal: str) -> Callable[[Any], int]:
    """Return a policy that walks to `goal` over the fewest cells, taking the keys it needs.

    It stays if the goal was reached or is unreachable.
    """
    check(s)
    steps, event = steps_to(s, goal), GOALS[goal]

    def action(now: Any) -> int:
        check(now)
        left = steps[now.hand]
        if now[event] != NEVER or left[int(now.y), int(now.x)] == UNREACHABLE:
            return STAY
        return int(towards(now, left))

    return action


def optimal_return(s: Any, goal: str, gamma: float = 1.0) -> float:
    """Return the discounted reward of walking to `goal` as `expert` does, if `goal` is rewarded.

    It is gamma ** (steps - 1) * 10, or 0 if there is no way within the time limit. A player who
    cuts corners can be a few steps faster.
    """
    finite("gamma", gamma, 0, 1)
    check(s)
    now = np.array([s], STATE)[0]
    time = walk(now, steps_to(s, goal), GOALS[goal] == "reached_gem")
    is_over = s[GOALS[goal]] != NEVER or time == UNREACHABLE
    return 0.0 if is_over else REWARD * gamma ** (int(time - s.time) - 1)


def reachable(s: Any) -> np.ndarray:
    """Return the cells that the thief can reach, with the keys on its way, [world, world] bool."""
    check(s)
    cells, hand, before = grid(s), int(s.hand), NEVER
    while True:
        is_shut = [DOOR_CODE + k for k in range(len(COLOURS)) if not hand >> k & 1]
        is_open = ~np.isin(cells, [WALL, *is_shut])
        found = distances(is_open, int(s.x), int(s.y)) != UNREACHABLE
        if hand == before:
            return found
        before = hand
        for k in range(len(COLOURS)):
            hand |= int((found & (cells == KEY + k)).any()) << k
