"""Kernels for the rules and levels of grid worlds."""

from collections.abc import Callable, Sequence

import numpy as np

from astray.kernel.jit import kernel, shared
from astray.kernel.rng import below, mix_two, seed_twister
from astray.record import NEVER, state_dtype
from astray.record import first as first

ACTIONS = ("stay", "left", "right", "down", "up")
DX, DY = np.array([0, -1, 1, 0, 0, 0, 0, 0]), np.array([0, 0, 0, -1, 1, 0, 0, 0])  # by action
EMPTY, WALL = 0, 1  # codes; those of other things follow, and those of movers after these
STAY, NOWHERE = 0, -1  # for `mark`: no action but to go there; no target of a script


def state(side: int, events: Sequence[str], *numbers: str) -> np.dtype:
    """Return the record of a grid world: things, movers on them, the agent, numbers and events.

    Args:
        side: Cells a side, 3 to 32.
        events: As `Rules.EVENTS`.
        numbers: Fields of the world's own, int64.

    Returns:
        Dtype with `cell` [side, side] (codes of things), `mover` [side, side] (codes of movers),
        `x` and `y` (the agent's cell), `held` (the number of the thing it holds).
    """
    layers = [(name, np.uint8, (side, side)) for name in ("cell", "mover")]
    return state_dtype(*layers, *[(n, np.int64) for n in ("x", "y", "held", *numbers, *events)])


@kernel
def clear(s):
    """Empty all cells and remove the agent from them."""
    s.cell[:] = EMPTY
    s.mover[:] = EMPTY
    s.x, s.y, s.held = NEVER, NEVER, 0


def plan(drawing: str, chars: str) -> np.ndarray:
    """Parse a room's drawing, top row first, into codes [H, W]: positions in `chars`, from 1 on."""
    rows = drawing.split()[::-1]
    return np.array([[chars.find(char) + 1 for char in row] for row in rows], np.uint8)


@kernel
def lay(s, room):
    """Set all things to those of a parsed room; an array in an array compiles 3 s longer."""
    for y in range(s.cell.shape[0]):
        for x in range(s.cell.shape[1]):
            s.cell[y, x] = room[y, x]


@shared
def any_empty(s):
    """Draw a random empty cell, as its number: y times the side, plus x.

    It is the agent's cell if none is empty, which happens in edited levels.
    """
    side, found = s.cell.shape[0], 0
    cells = np.empty(side * side, np.int64)
    for i in range(side * side):
        x, y = i % side, i // side
        if s.cell[y, x] == EMPTY and s.mover[y, x] == EMPTY and (x != s.x or y != s.y):
            cells[found] = i
            found += 1
    return cells[below(s, found)] if found > 0 else s.y * side + s.x


@kernel
def scatter(s, layer, code, count):
    """Put `count` things or movers of a code into random empty cells of `s.cell` or `s.mover`."""
    side = s.cell.shape[0]
    for _ in range(count):
        i = any_empty(s)
        layer[i // side, i % side] = code


@kernel
def begin_anywhere(s):
    """Put the agent into a random empty cell."""
    i = any_empty(s)
    s.x, s.y = i % s.cell.shape[0], i // s.cell.shape[0]


@kernel
def settle(s):
    """Seed later draws from the cells, so that numbered and drawn levels continue identically.

    Worlds that draw in their steps call it last when they make a level.
    """
    seed_by(s, s.cell, s.mover)


@kernel
def seed_by(s, cell, mover):
    """Seed the twister of `s` from a level's cells."""
    number = np.uint64(0)
    for y in range(cell.shape[0]):
        for x in range(cell.shape[1]):
            number = mix_two(number, np.int64(cell[y, x]) + 256 * np.int64(mover[y, x]))
    seed_twister(s, number)


@kernel
def is_open(s, x, y):
    """Return whether the cell is in the world and not a wall."""
    side = s.cell.shape[0]
    return 0 <= x < side and 0 <= y < side and s.cell[y, x] != WALL


@kernel
def walk(s, action):
    """Move the agent one cell, unless there is a wall."""
    x, y = s.x + DX[action], s.y + DY[action]
    if is_open(s, x, y):
        s.x, s.y = x, y


@kernel
def count(layer, code):
    """Return the number of cells with that code."""
    found = 0
    for y in range(layer.shape[0]):
        for x in range(layer.shape[1]):
            found += layer[y, x] == code
    return found


@kernel
def mark(there, layer, code, action):
    """Mark a layer's cells with that code as a script's targets; return whether there are any.

    Args:
        there: [side, side], the action that the script takes in each of its targets, else NOWHERE.
    """
    found = False
    for y in range(layer.shape[0]):
        for x in range(layer.shape[1]):
            if layer[y, x] == code:
                there[y, x], found = action, True
    return found


def nearest(*codes: int) -> Callable:
    """Make a `seek` of a world: a script goes to the nearest thing of these codes, and stays."""

    @kernel
    def seek(s, there):
        for code in codes:
            mark(there, s.cell, code, STAY)

    return seek
