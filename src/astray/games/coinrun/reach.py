"""Cells that the runner can reach: a search with the real physics, without walkers.

From every place where it can stand, the runner tries a few ways to run and jump. Saws and lava
stop it; walkers, which come and go, do not.
"""

import numpy as np

from astray.games.coinrun.rules import (
    CRATE,
    EMPTY,
    HALF,
    NEAR,
    NOTHING,
    TALL,
    WORLD,
    ZERO,
    F,
    accelerate,
    is_lava,
    is_supported,
    meets_saw,
    move,
    stops,
)
from astray.kernel.jit import kernel, shared
from astray.kernel.rng import fraction

PLACE = 0x97ACE  # salt of the hash that picks a place to stand
TRIES = 100  # picks before the coin lies on a ledge after all
RUNS = (9, 4, 2, 0)  # steps on the ground before a jump
WAYS = 2 * len(RUNS) * 3  # directions, runs, and: jump on, jump straight up, do not jump
LONGEST = 60  # steps of one way: from the highest jump into the deepest pit
PACES = 3  # a place is tried anew when reached at another pace: still, to the left, to the right
QUEUE = WORLD * WORLD


@shared
def explore(s, target_x, target_y, touched):
    """Return whether the runner can touch cell (target_x, target_y), which may be NEVER.

    `touched` [WORLD, WORLD] bool is filled with the cells that it touched in the search.
    """
    x0, y0, vx0, vy0, crate0 = s.x, s.y, s.vx, s.vy, s.on_crate
    known = np.zeros((WORLD, WORLD, PACES), np.bool_)
    queue = np.empty((QUEUE, 5), np.float32)  # x, y, vx, vy, on a crate
    order = np.empty(QUEUE, np.int64)  # those not tried yet
    count, waiting = remember(s, known, queue, order, np.int64(0), np.int64(0))
    found = target_x >= 0 and touched[target_y, target_x]
    while waiting > 0 and not found:
        k = nearest(queue, order, waiting, target_x)
        node = order[k]
        waiting -= 1
        order[k] = order[waiting]
        for way in range(WAYS):
            s.x, s.y, s.vx, s.vy = queue[node, 0], queue[node, 1], queue[node, 2], queue[node, 3]
            s.on_crate = queue[node, 4] > ZERO
            run, jump = RUNS[way // 2 % len(RUNS)], way // (2 * len(RUNS))
            dx = 1 if way % 2 == 0 else -1
            for time in range(LONGEST):
                leap = time == run and jump < 2
                ax = 0 if time > run and jump > 0 else dx
                if not glide(s, ax, leap and is_supported(s), touched):
                    break
                if is_supported(s):
                    count, waiting = remember(s, known, queue, order, count, waiting)
                    if time > run + 1:
                        break
            if target_x >= 0 and touched[target_y, target_x]:
                found = True
                break
    s.x, s.y, s.vx, s.vy, s.on_crate = x0, y0, vx0, vy0, crate0
    return found


@kernel
def glide(s, ax, leap, touched):
    """Take one step of the runner; record what it touches; return whether it is alive."""
    ay = 1 if leap else 0
    accelerate(s, ax, ay, is_supported(s))
    move(s, ax, ay, leap)  # which goes first matters to ties alone
    left, right = int(np.floor(s.x - HALF + NEAR)), int(np.floor(s.x + HALF - NEAR))
    low, high = int(np.floor(s.y - TALL + NEAR)), int(np.floor(s.y + TALL - NEAR))
    alive = not meets_saw(s)
    for y in range(max(low, 0), min(high, WORLD - 1) + 1):
        for x in range(max(left, 0), min(right, WORLD - 1) + 1):
            touched[y, x] = True
            if is_lava(s.cell[y, x]):
                alive = False
    return alive


@kernel
def remember(s, known, queue, order, count, waiting):
    """Add the place where the runner stands to the queue, if it is new."""
    x, y = int(np.floor(s.x)), int(np.floor(s.y - TALL + HALF))
    pace = 0 if abs(s.vx) < F(0.2) else 1 if s.vx < ZERO else 2
    if 0 <= x < WORLD and 0 <= y < WORLD and not known[y, x, pace] and count < QUEUE:
        known[y, x, pace] = True
        queue[count, 0], queue[count, 1], queue[count, 2] = s.x, s.y, s.vx
        queue[count, 3], queue[count, 4] = s.vy, 1 if s.on_crate else 0
        order[waiting] = count
        return count + 1, waiting + 1
    return count, waiting


@kernel
def nearest(queue, order, waiting, target_x):
    """Return the index in `order` of the place whose column is nearest to the target's."""
    best, least = 0, F(WORLD)
    for k in range(waiting):
        away = abs(queue[order[k], 0] - F(target_x))
        if away < least:
            best, least = k, away
    return best


@kernel
def pick_place(s, in_pit):
    """Draw uniformly an empty reachable cell to stand in, or return (-1, -1).

    `in_pit` [WORLD] bool marks columns on whose floor nobody can stand.
    """
    xs, ys = np.empty(WORLD * 8, np.int64), np.empty(WORLD * 8, np.int64)
    count = 0
    for x in range(1, s.end_x):
        for y in range(1, WORLD - 1):
            on = stops(s.cell[y - 1, x]) or s.thing[y - 1, x] == CRATE
            free = s.cell[y, x] == EMPTY and s.thing[y, x] == NOTHING
            for k in range(s.walkers):
                free &= int(s.walker_x[k]) != x or int(s.walker_y[k]) != y
            floor, start = in_pit[x] and y == 1, x == 1 and y == 1
            if on and free and not floor and not start and count < len(xs):
                xs[count], ys[count] = x, y
                count += 1
    touched = np.zeros((WORLD, WORLD), np.bool_)
    explored = False
    for turn in range(TRIES if count else 0):
        k = int(fraction(s.level, PLACE + turn) * count)
        x, y = xs[k], ys[k]
        if not explored:  # a search that fails has been everywhere
            explored = not explore(s, x, y, touched)
        if touched[y, x]:
            return x, y
    return -1, -1
