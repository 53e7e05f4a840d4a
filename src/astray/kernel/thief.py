"""The thief of several games: its motion through mazes and doors, its walking, and its levels.

States begin with `fields`, and have the look of their floor.
"""

from typing import Any

import numpy as np

from astray.kernel.grid import MOVES, UNREACHABLE, push
from astray.kernel.jit import entry, kernel, shared
from astray.kernel.maze import AS_NUMBERED, FLOORS, WALL, is_wall
from astray.kernel.rng import below, unit, wind

# Lengths are float32, as all of the original's; so is all arithmetic on them.
F = np.float32
HALF = F(0.375)  # half a side of the thief's box, cells
CORNER = HALF * F(0.98)  # walls are looked for in the corners of a box that is a little smaller
MIX, TOP_SPEED = F(0.5), F(0.75)  # the original's mixrate and maxspeed, cells per step
DECAY = 0.9  # of the speed a step, a double in the original
PARTS = 4  # of a step's way; the original's max(4, int(4 |v|)), where |v| < 0.87 cells a step
PART = F(1 / PARTS)
TIES = 1_000_000  # what the integer of a step is below
DOOR = HALF + F(0.5)  # from the middle of a locked door to that of a thief who touches it
IN_DOOR = DOOR + F(-0.001)  # who is nearer is pushed back
KEY_ASPECT = F(84 / 52)  # of the key's picture
KEY_WIDE = F(0.375)  # half the width of a key, cells
KEY_HIGH = KEY_WIDE / KEY_ASPECT
JITTER = F(0.25)  # cells: things are up to half of it off their cells' centres
SLACK = float(F(0.5) - HALF)  # cells that the thief may be off the middle of a corridor


def fields(largest: int, most: int) -> tuple[tuple, ...]:
    """Return the first fields of states, of up to `largest` cells a side and `most` objects."""
    return (
        ("cell", np.uint8, (largest, largest)),  # 0 or WALL at [y, x]; world is [:world, :world]
        ("world", np.int64),  # cells a side
        ("maze_size", np.int64),  # cells a side of the maze, somewhere in the world
        ("window", np.int64),  # cells a side of the window around the thief; 0: the whole world
        ("x", np.float32), ("y", np.float32),  # the thief's centre, in cells
        ("vx", np.float32), ("vy", np.float32),  # cells per step
        ("facing", np.int64),  # the last action that moved, or STAY
        ("objects", np.int64),  # how many the level began with; by columns, each from below
        ("what", np.uint8, (most,)),  # codes, as in a level's cells
        ("object_x", np.float32, (most,)), ("object_y", np.float32, (most,)),  # centres, in cells
        ("gone", np.int64, (most,)),  # the step that each was taken or opened, or NEVER
    )  # fmt: skip


@kernel
def move(s, action, tie, locked):
    """Push the thief by `action` and move it as far as walls and locked doors allow.

    Args:
        s: State.
        action: Action.
        tie: Integer that picks the first axis where nothing else does.
        locked: Bit mask of the objects that block the way.
    """
    ax, ay = push(action)
    if ax != 0 or ay != 0:
        s.facing = action
    s.vx, s.vy = pushed(s.vx, ax), pushed(s.vy, ay)
    x_first = abs(s.vx) > abs(s.vy) or (abs(s.vx) == abs(s.vy) and tie % 2 == 0)
    if ax != 0 or ay != 0:
        x_first = ay == 0
    free_x, free_y = 0, 0  # parts of the way on which nothing was in the way
    for _ in range(PARTS):
        met_x, met_y = False, False
        for turn in range(2):
            across = x_first == (turn == 0)
            met = slide(s, (s.vx if across else s.vy) * PART, across, locked)
            met_x, met_y = met_x or (met and across), met_y or (met and not across)
        free_x += not met_x
        free_y += not met_y
        if met_x and met_y:
            break
    s.vx, s.vy = s.vx * (F(free_x) * PART), s.vy * (F(free_y) * PART)


@kernel
def pushed(v, push):
    """Return the speed along an axis after a push of -1, 0 or 1."""
    v = (F(1) - MIX) * v + MIX * TOP_SPEED * F(push)
    return F(DECAY * np.float64(v))


@kernel
def slide(s, way, across, locked):
    """Move by `way` in x if `across`, else in y; return whether a wall or locked door was met."""
    if way == 0:
        return False
    at, beside = (s.x, s.y) if across else (s.y, s.x)
    at = at + way
    # Of the box's four corners the two behind cannot be in a wall that those in front are not in.
    front, met = at + CORNER if way > 0 else at - CORNER, False
    for corner in (beside - CORNER, beside + CORNER):
        x, y = (front, corner) if across else (corner, front)
        met = met or is_wall(s, int(np.floor(x)), int(np.floor(y)))
    if met:
        at = F(np.floor(at + HALF)) - HALF if way > 0 else F(np.ceil(at - HALF)) + HALF
    s.x, s.y = (at, beside) if across else (beside, at)
    if locked:
        for k in range(s.objects - 1, -1, -1):
            if locked >> k & 1 and touches(s, k, IN_DOOR, IN_DOOR):
                door = s.object_x[k] if across else s.object_y[k]
                edge = door + F(sign(at - door)) * DOOR
                at, met = at + (edge - at), True
                s.x, s.y = (at, beside) if across else (beside, at)
                s.vx, s.vy = (F(0), s.vy) if across else (s.vx, F(0))
    return met


@kernel
def touches(s, k, near_x, near_y):
    """Return whether object `k` is nearer to the thief than the two distances."""
    return abs(s.object_x[k] - s.x) < near_x and abs(s.object_y[k] - s.y) < near_y


@shared
def jittered(s, x):
    """Draw a coordinate near the centre of cell `x`."""
    return F(x) + (F(0.5) - JITTER / F(2) + JITTER * F(unit(s)))


@shared
def start(s, p):
    """Draw a level's floor and size, and set both; return how much larger than the least it is."""
    s.background_offset = unit(s)
    background = below(s, FLOORS)
    s.background = background if p.background == AS_NUMBERED else p.background
    unit(s)  # where the thief would be, had the game no say
    unit(s)
    larger = below(s, (p.largest - p.smallest) // 2 + 1)
    s.maze_size = p.smallest + 2 * larger
    return larger


@shared
def settle(s, inside, cell):
    """Draw the place of the maze `inside` in the world, with the thief in `cell`; return it."""
    size = inside.shape[0]
    left, low = below(s, s.world - size + 1), below(s, s.world - size + 1)
    s.x, s.y = F(left + cell % size) + F(0.5), F(low + cell // size) + F(0.5)
    s.cell[:] = WALL
    for y in range(size):
        for x in range(size):
            s.cell[low + y, left + x] = inside[y, x] == WALL
    return left, low


@kernel
def sign(number):
    return int(number > 0) - int(number < 0)


@kernel
def at(steps, x, y):
    """Return `steps` of cell (x, y); UNREACHABLE outside of the world."""
    if 0 <= y < steps.shape[0] and 0 <= x < steps.shape[1]:
        return steps[y, x]
    return UNREACHABLE


@kernel
def onward(steps, x, y):
    """Return the direction in which `steps` decrease from cell (x, y), or (0, 0)."""
    for k in range(4):
        dx, dy = (k == 0) - (k == 1), (k == 2) - (k == 3)
        there = at(steps, x + dx, y + dy)
        if there != UNREACHABLE and there == at(steps, x, y) - 1:
            return dx, dy
    return 0, 0


@shared
def press(s, steps):
    """Return the action that walks fast to where `steps` [world, world] are 0.

    A turn is pressed a cell ahead where a wall keeps the thief from turning too early.
    """
    x, y = int(s.x), int(s.y)
    # To the middle of the cell; float64, compiled or not.
    off_x, off_y = x + 0.5 - np.float64(s.x), y + 0.5 - np.float64(s.y)
    dx, dy = onward(steps, x, y)
    if dx == 0 and dy == 0:
        return 3 * (1 + sign(off_x) * (abs(off_x) > SLACK)) + 1 + sign(off_y) * (abs(off_y) > SLACK)
    next_dx, next_dy = onward(steps, x + dx, y + dy)
    if dx != 0:
        if abs(off_y) > SLACK:
            dy = sign(off_y)
        elif at(steps, x, y + next_dy) == UNREACHABLE:
            dy = next_dy
    elif abs(off_x) > SLACK:
        dx = sign(off_x)
    elif at(steps, x + next_dx, y) == UNREACHABLE:
        dx = next_dx
    return 3 * (1 + dx) + 1 + dy


@entry
def towards(s, steps):
    """Call `press` from Python."""
    return press(s, steps)


def truths(states: np.ndarray) -> dict[str, np.ndarray]:
    """Return facts about states [N] that hold in every game with a thief."""
    s = states.view(np.recarray)
    world, most = np.clip(s.world, 1, s.cell.shape[1]), s.what.shape[1]
    # Fields that are no numbers fail every comparison.
    with np.errstate(invalid="ignore"):
        # Walls are felt in the corners of a box that is a little smaller than the thief.
        least, last = CORNER, world - CORNER
        inside = (s.x >= least) & (s.x <= last) & (s.y >= least) & (s.y <= last)
        there = np.arange(most) < s.objects[:, None]
        wide = world[:, None]
        return {
            "world": s.world == world,
            "cell": (s.cell <= WALL).all((1, 2)),
            "x": inside,
            "place of the thief": _on_floor(s, inside),
            "vx": abs(s.vx) <= 1,
            "vy": abs(s.vy) <= 1,
            "facing": (s.facing >= 0) & (s.facing < MOVES),
            "objects": (s.objects >= 0) & (s.objects <= most),
            "object_x": (((s.object_x > 0) & (s.object_x < wide)) | ~there).all(1),
            "object_y": (((s.object_y > 0) & (s.object_y < wide)) | ~there).all(1),
            "background": (s.background >= 0) & (s.background < FLOORS),
            "background_offset": (s.background_offset >= 0) & (s.background_offset <= 1),
        }


def of_variant(states: np.ndarray, variant: Any) -> dict[str, np.ndarray]:
    """Return facts about states [N] of a variant: the sizes of its world and its window."""
    return {name: states[name] == getattr(variant, name) for name in ("world", "window")}


def grid(s: Any) -> np.ndarray:
    """Return the contents of every cell, [world, world] uint8, without objects that are gone."""
    cells = s.cell[: s.world, : s.world].copy()
    there = s.gone[: s.objects] < 0
    x, y = (at[: s.objects][there].astype(np.int64) for at in (s.object_x, s.object_y))
    cells[y, x] = s.what[: s.objects][there]
    return cells


def looks(s: Any) -> dict[str, Any]:
    """Return the looks of state `s` for `begin`; raise ValueError if objects share a cell.

    "twister" decides ties: its seed and its number of draws when the level began. "details" are
    [x, y, right, up] of objects off their cells' centres, in cells from the lower left corner.
    """
    x, y = (at[: s.objects][s.gone[: s.objects] < 0] for at in (s.object_x, s.object_y))
    places = [*zip(x.tolist(), y.tolist(), strict=True)]
    cells = [(int(x), int(y)) for x, y in places]
    for k, (column, row) in enumerate(cells):
        if s.cell[row, column] == WALL or (column, row) in cells[:k]:
            raise ValueError(f"cell {column, row} holds several things; a level has one in each")
    details = [[int(x), int(y), x % 1, y % 1] for x, y in places if (x % 1, y % 1) != (0.5, 0.5)]
    return {
        "background": int(s.background),
        "background_offset": float(s.background_offset),
        "twister": None if s.twister < 0 else [int(s.twister), int(s.twister_at)],
        "details": sorted(details, key=lambda one: one[1::-1]),
    }


def begin(s: Any, cells: np.ndarray, agent: tuple[int, int], told: Any, p: Any, put: Any) -> None:
    """Set the furnished state `s` to the beginning of a level.

    Args:
        s: State.
        cells: [world, world], codes of walls and objects.
        agent: Cell of the thief.
        told: Looks, as `looks` returns them; all are optional.
        p: Knobs of the variant.
        put: Function (s, what, x, y) that adds an object.

    Raises:
        ValueError: If the level has another size or too many objects.
    """
    most, (height, width) = len(s.what), cells.shape
    if height != p.world or width != p.world:
        raise ValueError(
            f"the level is {width} x {height} cells; the variant's world is {p.world} a side"
        )
    objects = [(int(x), int(y)) for x, y in np.argwhere(cells.T > WALL)]
    if len(objects) > most:
        raise ValueError(f"a level has at most {most} things; this has {len(objects)}")
    s.time_limit = p.time_limit
    s.cell[:] = WALL
    s.cell[:height, :width] = cells == WALL
    s.x, s.y = agent[0] + 0.5, agent[1] + 0.5
    rows, columns = np.nonzero(cells != WALL)
    s.maze_size = max(np.ptp(rows), np.ptp(columns)) + 1
    s.background = told.get("background", max(p.background, 0))
    s.background_offset = told.get("background_offset", 0.0)
    s.twister, s.twister_at = wind(s, told.get("twister"))
    for x, y in objects:
        put(s, cells[y, x], x, y)
    if "details" in told:
        beside = {(x, y): (right, up) for x, y, right, up in told["details"]}
        for k, (x, y) in enumerate(objects):
            right, up = beside.get((x, y), (0.5, 0.5))
            s.object_x[k], s.object_y[k] = x + right, y + up


def _on_floor(s: np.recarray, inside: np.ndarray) -> np.ndarray:
    """Return whether no corner of the thief's box is in a wall."""
    x, y, i = np.where(inside, s.x, 1), np.where(inside, s.y, 1), np.arange(len(s))
    free = inside.copy()
    for up in (-CORNER, CORNER):
        for right in (-CORNER, CORNER):
            free &= s.cell[i, (y + up).astype(int), (x + right).astype(int)] != WALL
    return free
