"""Levels of Keys and Chests, with the original's random draws in its order, and drawn levels."""

from __future__ import annotations

from typing import Any

import numpy as np

from astray.game import Variant
from astray.games.keys.rules import CHEST, CORNER, EMPTY, HIDDEN, KEY, LARGEST, MOST, STATE, F
from astray.kernel.grid import MOVES, STAY
from astray.kernel.jit import kernel, shared
from astray.kernel.maze import AS_NUMBERED, FLOORS, WALL, carve
from astray.kernel.rng import WORDS, below, seed_twister, unit
from astray.record import NEVER, centre, within

LEGEND = {"#": WALL, ".": EMPTY, "k": KEY, "C": CHEST}
OBJECTS = {"key": "k", "chest": "C"}
STOOD_ON = "C"
BY_SIZE = 0  # Keys.fewest: the size of the maze decides
JITTER = F(0.25)  # cells: keys are up to half of it off their cells' centres


# Drawn so often in the code below that inlining them would double its compile time.
@shared
def pick(s, n):
    return below(s, n)


@shared
def real(s):
    return unit(s)


@shared
def generate(s, p):
    """Fill `s` with a new level of the variant `p`."""
    offset = real(s)
    background = pick(s, FLOORS)
    real(s)  # where the thief would be, had the game no say
    real(s)
    larger = pick(s, (p.largest - p.smallest) // 2 + 1)
    size = p.smallest + 2 * larger
    if p.fewest == BY_SIZE:
        groups = (size - 5) // 2 + pick(s, 2) + 1
    else:
        groups = p.fewest + pick(s, p.most - p.fewest + 1)

    is_open = np.zeros((size, size), np.bool_)
    free_x, free_y = np.empty(size * size, np.int64), np.empty(size * size, np.int64)
    carve(s, size, is_open, free_x, free_y)
    inside = np.empty((size, size), np.uint8)
    for k in range(size * size):
        inside[k // size, k % size] = EMPTY if is_open[k // size, k % size] else WALL
    place(s, inside, groups, p)

    furnish(s, p)
    s.maze_size, s.background_offset = size, offset
    s.background = background if p.background == AS_NUMBERED else p.background
    left, low = pick(s, s.world - size + 1), pick(s, s.world - size + 1)
    s.x, s.y = s.x + F(left), s.y + F(low)
    s.twister, s.twister_at = s.level, s.mt_next  # fewer than its 624 words are drawn so far
    s.cell[:] = WALL
    for x in range(size):
        for y in range(size):
            s.cell[low + y, left + x] = inside[y, x] == WALL
            if inside[y, x] > WALL:
                put(s, inside[y, x], left + x, low + y)


@kernel
def place(s, inside, groups, p):
    """Put `groups` of keys and chests, and the thief, into cells of the maze `inside`."""
    size = inside.shape[0]
    cells = np.empty(size * size, np.int64)
    count = 0
    for y in range(size):
        for x in range(size):
            if inside[y, x] == EMPTY and ways(inside, x, y) >= 2:  # no dead end
                cells[count] = y * size + x
                count += 1
    each = p.keys + p.chests
    if not p.strict:
        groups = min(groups, count // each)
    too_few = groups * each > count  # then all are taken, without a draw
    for k in range(min(groups * each, count)):
        which = k if too_few else pick(s, count - k)
        cell = cells[which]
        if not too_few:
            for j in range(which, count - k - 1):
                cells[j] = cells[j + 1]
        inside[cell // size, cell % size] = CHEST if k < groups * p.chests else KEY
    count = 0
    for y in range(size):
        for x in range(size):
            if inside[y, x] == EMPTY:
                cells[count] = y * size + x
                count += 1
    cell = cells[pick(s, count)]
    s.x, s.y = F(cell % size) + F(0.5), F(cell // size) + F(0.5)


@kernel
def ways(inside, x, y):
    """Return the free neighbours of a cell, whatever objects are in them."""
    size, count = inside.shape[0], 0
    for k in range(4):
        u, v = x + (k == 0) - (k == 1), y + (k == 2) - (k == 3)
        if 0 <= u < size and 0 <= v < size and inside[v, u] != WALL:
            count += 1
    return count


@shared
def put(s, what, x, y):
    """Add an object in cell (x, y); keys are drawn slightly off its centre."""
    k = s.objects
    s.objects = k + 1
    s.what[k], s.gone[k], s.had[k] = what, NEVER, 0
    s.object_x[k], s.object_y[k] = F(x) + F(0.5), F(y) + F(0.5)
    if what == CHEST:
        s.chests += 1
        return
    s.keys += 1
    if s.twister != NEVER:
        low = F(0.5) - JITTER / F(2)
        s.object_x[k] = F(x) + (low + JITTER * F(real(s)))
        s.object_y[k] = F(y) + (low + JITTER * F(real(s)))


@kernel
def furnish(s, p):
    """Set the fields that no draw decides."""
    s.world, s.window, s.inventory, s.strict = p.world, p.window, p.inventory, p.strict
    s.key_penalty, s.step_penalty = p.key_penalty, p.step_penalty
    s.vx, s.vy, s.facing = F(0), F(0), STAY
    s.objects, s.keys, s.chests = 0, 0, 0
    s.taken, s.opened, s.passed, s.touched, s.at_inventory = 0, 0, 0, 0, 0
    s.first_key, s.all_keys, s.keys_before_last = NEVER, NEVER, NEVER
    s.first_chest, s.all_chests, s.passed_chest = NEVER, NEVER, NEVER
    s.what[:], s.gone[:], s.had[:] = 0, NEVER, 0
    s.object_x[:], s.object_y[:] = F(0), F(0)


def grid(s: Any) -> np.ndarray:
    """Return the contents of every cell, [world, world] uint8, without objects that are gone."""
    cells = s.cell[: s.world, : s.world].copy()
    there = s.gone[: s.objects] == NEVER
    x, y = (at[: s.objects][there].astype(np.int64) for at in (s.object_x, s.object_y))
    cells[y, x] = s.what[: s.objects][there]
    return cells


def describe(s: Any) -> dict[str, Any]:
    """Return the level of state `s` as plain data, with the lowest row of `grid` first.

    The look "twister" decides ties: the twister's seed, and its number of draws before the keys'.
    "details" are [x, y, right, up] of keys off their cells' centres, in cells from the lower left
    corner. Without them, the twister draws these offsets.
    """
    cells = grid(s)
    off = None if s.twister == NEVER else [int(s.twister), int(s.twister_at)]
    return {
        "world": int(s.world),
        "maze_size": int(s.maze_size),
        "grid": cells.tolist(),
        "legend": {"empty": EMPTY, "wall": WALL, "key": KEY, "chest": CHEST},
        "agent": centre(s),
        "keys": int((cells == KEY).sum()),
        "chests": int((cells == CHEST).sum()),
        "looks": {
            "background": int(s.background),
            "background_offset": float(s.background_offset),
            "twister": off,
            "details": _details(s),
        },
    }


def _details(s: Any) -> list[list[Any]]:
    """Return the look of that name."""
    found = []
    for k in range(s.objects):
        right, up = float(s.object_x[k]) % 1, float(s.object_y[k]) % 1
        if s.what[k] == KEY and s.gone[k] == NEVER and (right, up) != (0.5, 0.5):
            found.append([int(s.object_x[k]), int(s.object_y[k]), right, up])
    return sorted(found, key=lambda one: one[1::-1])


def build(cells: np.ndarray, agent: tuple[int, int], looks: Any, variant: Variant) -> Any:
    """Return the state that begins in the level `cells` [world, world], with `variant`'s looks.

    Raises:
        ValueError: If no episode can begin there.
    """
    p, (height, width) = variant.records()[0], cells.shape
    if height != p.world or width != p.world:
        raise ValueError(
            f"the level is {width} x {height} cells; the variant's world is {p.world} a side"
        )
    objects = [(int(x), int(y)) for x, y in np.argwhere(cells.T > WALL)]
    if len(objects) > MOST:
        raise ValueError(f"a level has at most {MOST} keys and chests; this has {len(objects)}")
    state = np.zeros(1, STATE)
    s = state.view(np.recarray)[0]
    furnish(s, p)
    s.time_limit = variant.time_limit
    s.cell[:] = WALL
    s.cell[:height, :width] = cells == WALL
    s.x, s.y = agent[0] + 0.5, agent[1] + 0.5
    rows, columns = np.nonzero(cells != WALL)
    s.maze_size = max(np.ptp(rows), np.ptp(columns)) + 1
    s.background = looks.get("background", max(p.background, 0))
    s.background_offset = looks.get("background_offset", 0.0)
    s.twister, s.twister_at = _twister(looks.get("twister"))
    seed_twister(s, max(s.twister, 0))
    for _ in range(s.twister_at):
        unit(s)
    for x, y in objects:
        put(s, cells[y, x], x, y)
    if "details" in looks:
        beside = {(x, y): (right, up) for x, y, right, up in looks["details"]}
        for k, (x, y) in enumerate(objects):
            if s.what[k] == KEY:
                right, up = beside.get((x, y), (0.5, 0.5))
                s.object_x[k], s.object_y[k] = x + right, y + up
    return s


def _twister(given: Any) -> tuple[int, int]:
    """Return the twister's seed and its number of draws from the look `given`."""
    if given is None:
        return NEVER, 0
    whole = isinstance(given, list | tuple) and all(type(n) is int for n in given)
    if not whole or len(given) != 2 or not (0 <= given[0] < 2**31 and 0 <= given[1] < WORDS):
        raise ValueError(
            f"a level's twister must be [a number from 0 to {2**31 - 1}, draws from 0 to "
            f"{WORDS - 1}], or null; got {given!r}"
        )
    return given[0], given[1]


def invariants(states: np.ndarray, variant: Variant) -> dict[str, np.ndarray]:
    """Return facts about states [N] of `variant` that compiled code relies on."""
    p = variant.records()[0]
    return truths(states) | {
        "world": states["world"] == p.world,
        "window": states["window"] == p.window,
    }


def truths(states: np.ndarray) -> dict[str, np.ndarray]:
    """Return facts about states [N] of every variant."""
    s = states.view(np.recarray)
    world = np.clip(s.world, 1, LARGEST)
    # Fields that are no numbers fail every comparison.
    with np.errstate(invalid="ignore"):
        # Walls are felt in the corners of a box that is a little smaller than the thief.
        least, most = CORNER, world - CORNER
        inside = (s.x >= least) & (s.x <= most) & (s.y >= least) & (s.y <= most)
        found = {
            "world": s.world == world,
            "cell": (s.cell <= WALL).all((1, 2)),
            "x": inside,
            "place of the thief": _on_floor(s, inside),
            "vx": abs(s.vx) <= 1,
            "vy": abs(s.vy) <= 1,
            "facing": within(s.facing, 0, MOVES),
            "objects": within(s.objects, 0, MOST + 1),
            "inventory": within(s.inventory, 0, HIDDEN + 1),
            "background": within(s.background, 0, FLOORS),
            "background_offset": (s.background_offset >= 0) & (s.background_offset <= 1),
            "key_penalty": np.isfinite(s.key_penalty),
            "step_penalty": np.isfinite(s.step_penalty),
        }
        there = np.arange(MOST) < s.objects[:, None]
        real = {
            "what": (s.what == KEY) | (s.what == CHEST),
            "object_x": (s.object_x > 0) & (s.object_x < world[:, None]),
            "object_y": (s.object_y > 0) & (s.object_y < world[:, None]),
            "gone": (s.gone >= NEVER) & (s.gone <= s.time[:, None]),
            "had": within(s.had, 0, MOST + 1),
        }
    found |= {name: (holds | ~there).all(1) for name, holds in real.items()}
    gone = there & (s.gone != NEVER)
    counts = {"keys": (there, KEY), "chests": (there, CHEST),
              "taken": (gone, KEY), "opened": (gone, CHEST)}  # fmt: skip
    found |= {n: s[n] == (which & (s.what == what)).sum(1) for n, (which, what) in counts.items()}
    found["keys in hand"] = s.taken >= s.opened
    return found


def _on_floor(s: Any, inside: np.ndarray) -> np.ndarray:
    """Return whether no corner of the thief's box is in a wall."""
    x, y, i = np.where(inside, s.x, 1), np.where(inside, s.y, 1), np.arange(len(s))
    free = inside.copy()
    for up in (-CORNER, CORNER):
        for right in (-CORNER, CORNER):
            free &= s.cell[i, (y + up).astype(int), (x + right).astype(int)] != WALL
    return free
