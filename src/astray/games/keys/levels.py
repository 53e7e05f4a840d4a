"""Levels of Keys and Chests, with the original's random draws in its order, and drawn levels."""

from typing import Any

import numpy as np

from astray.game import Variant
from astray.games.keys import rules
from astray.games.keys.rules import CHEST, EMPTY, HIDDEN, KEY, MOST
from astray.kernel import thief
from astray.kernel.grid import STAY
from astray.kernel.jit import kernel, shared
from astray.kernel.maze import WALL, beside, dig
from astray.kernel.rng import choose, pick
from astray.kernel.thief import F, grid, jittered, settle, start
from astray.record import NEVER, centre, fresh, within

LEGEND = {"#": WALL, ".": EMPTY, "k": KEY, "C": CHEST}
OBJECTS = {"key": "k", "chest": "C"}
STOOD_ON = "kC"  # a key at its edge only: most of its cell is in reach
BY_SIZE = 0  # Keys.fewest: the size of the maze decides


@shared
def generate(s, p):
    """Fill `s` with a new level of the variant `p`."""
    furnish(s, p)
    start(s, p)
    if p.fewest == BY_SIZE:
        groups = (s.maze_size - 5) // 2 + pick(s, 2) + 1
    else:
        groups = p.fewest + pick(s, p.most - p.fewest + 1)

    inside = dig(s, s.maze_size)
    left, low = settle(s, inside, place(s, inside, groups, p))
    s.twister, s.twister_at = s.level, s.mt_next  # fewer than its 624 words are drawn so far
    for x in range(s.maze_size):
        for y in range(s.maze_size):
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
            if inside[y, x] == EMPTY and beside(inside, x, y, WALL) <= 2:  # no dead end
                cells[count] = y * size + x
                count += 1
    each = p.keys + p.chests
    if not p.strict:
        groups = min(groups, count // each)
    chosen = choose(s, cells, count, groups * each)
    for k in range(chosen.size):
        cell = chosen[k]
        inside[cell // size, cell % size] = CHEST if k < groups * p.chests else KEY
    free = np.flatnonzero(inside == EMPTY)
    return free[pick(s, free.size)]


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
        s.object_x[k], s.object_y[k] = jittered(s, x), jittered(s, y)


@kernel
def furnish(s, p):
    """Set the fields that are not random."""
    s.world, s.window, s.inventory, s.strict = p.world, p.window, p.inventory, p.strict
    s.key_penalty, s.step_penalty = p.key_penalty, p.step_penalty
    s.facing = STAY
    s.gone[:] = NEVER


def describe(s: Any) -> dict[str, Any]:
    """Return the level of state `s` as plain data, with the lowest row of `grid` first.

    Without the look "details", the twister draws where in their cells keys lie.
    """
    cells = grid(s)
    return {
        "world": int(s.world),
        "maze_size": int(s.maze_size),
        "grid": cells.tolist(),
        "legend": {"empty": EMPTY, "wall": WALL, "key": KEY, "chest": CHEST},
        "agent": centre(s),
        "keys": int((cells == KEY).sum()),
        "chests": int((cells == CHEST).sum()),
        "looks": thief.looks(s),
    }


def build(cells: np.ndarray, agent: tuple[int, int], looks: Any, variant: Variant) -> Any:
    """Return the state that begins in the level `cells` [world, world], with `variant`'s looks.

    Raises:
        ValueError: If no episode can begin there.
    """
    s, p = fresh(rules)[0], variant.records()[0]
    furnish(s, p)
    thief.begin(s, cells, agent, looks, p, put)
    return s


def truths(states: np.ndarray) -> dict[str, np.ndarray]:
    """Return facts about states [N] of every variant."""
    s = states.view(np.recarray)
    found = thief.truths(states) | {
        "inventory": within(s.inventory, 0, HIDDEN + 1),
        "key_penalty": np.isfinite(s.key_penalty),
        "step_penalty": np.isfinite(s.step_penalty),
    }
    there = np.arange(MOST) < s.objects[:, None]
    real = {
        "what": (s.what == KEY) | (s.what == CHEST),
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
