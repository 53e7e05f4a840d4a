"""Levels of Maze, with the original's random draws in its order, and levels drawn in text."""

from typing import Any

import numpy as np

from astray.game import Variant
from astray.games.maze import rules
from astray.games.maze.rules import BOTH, EMPTY, GOAL, LARGEST, OTHER, note_arrivals
from astray.games.maze.variants import COLOURS, OTHERS, SHAPES, WALLS
from astray.kernel.jit import kernel, shared
from astray.kernel.maze import AS_NUMBERED, FLOORS, WALL, carve
from astray.kernel.rng import below, fraction, unit
from astray.record import NEVER, centre, fresh, within

CORNER, REGION, ANYWHERE, ON_OTHER = 0, 1, 2, 3  # Maze.placement, in the order of its choices
DISH = OTHERS.index("dish")
DRAWS_PER_CELL = 100  # of the maze's side, before the original gives up on a region
START = 0x57A27  # salt of the hash that decides where a mouse starts that starts anywhere
LEGEND = {"#": WALL, ".": EMPTY, "G": GOAL, "o": OTHER, "O": BOTH}
OBJECTS = {"goal": "G", "other": "o", "goal on other": "O"}
STOOD_ON = "o"


@shared
def generate(s, p):
    """Fill `s` with a new level of the variant `p`."""
    offset = unit(s)
    background = below(s, FLOORS)
    size, sizes = p.smallest, (p.largest - p.smallest) // 2 + 1
    if sizes > 1:
        size += 2 * below(s, sizes)

    is_open = np.zeros((size, size), np.bool_)
    free_x, free_y = np.empty(size * size, np.int64), np.empty(size * size, np.int64)
    free = carve(s, size, is_open, free_x, free_y)

    furnish(s, p)
    s.maze_size, s.background_offset = size, offset
    s.background = background if p.background == AS_NUMBERED else p.background
    margin = (s.world - size) // 2
    s.corner_x, s.corner_y = margin + size - 1, margin + size - 1
    s.cell[:] = WALL
    for k in range(free):
        s.cell[margin + free_y[k], margin + free_x[k]] = EMPTY

    goal = place_goal(s, p, size, free, free_x, free_y)
    s.goal_x, s.goal_y = put(s, GOAL, goal, margin, free_x, free_y)
    other = NEVER
    if p.placement == ON_OTHER:
        other = goal
    elif p.other_shape != 0:
        other = below(s, free)
        while other == goal or is_start(other, free_x, free_y):
            other = below(s, free)
    s.other_x, s.other_y = put(s, BOTH if other == goal else OTHER, other, margin, free_x, free_y)

    s.x, s.y = margin + 0.5, margin + 0.5
    if p.start != 0:
        turn, start = 0, goal
        while start in (goal, other):  # a hash: the same start wherever the goal was drawn
            start = int(fraction(s.level, START + turn) * free)
            turn += 1
        s.x, s.y = margin + free_x[start] + 0.5, margin + free_y[start] + 0.5
    note_arrivals(s)


@kernel
def furnish(s, p):
    """Set the fields that are not random."""
    s.world, s.window, s.walls = p.world, p.window, p.walls
    s.goal_shape, s.goal_colour = p.goal_shape, p.goal_colour
    s.other_shape, s.other_colour = p.other_shape, p.other_colour


@kernel
def place_goal(s, p, size, free, free_x, free_y):
    """Return the index of the free cell for the goal, or NEVER."""
    if p.placement == CORNER:
        for k in range(free):
            if free_x[k] == size - 1 and free_y[k] == size - 1:
                return k
    if p.placement == ANYWHERE or p.placement == ON_OTHER:
        goal = below(s, free)
        while is_start(goal, free_x, free_y):
            goal = below(s, free)
        return goal

    edge = size - min(p.region, size)
    below(s, free)  # the original wastes one draw
    for _ in range(DRAWS_PER_CELL * size):
        goal = below(s, free)
        if is_inside(goal, edge, free_x, free_y):
            return goal
    if p.strict:
        return NEVER
    inside = [k for k in range(free) if is_inside(k, edge, free_x, free_y)]
    return inside[below(s, len(inside))]  # never 0 cells: the upper right one is a node


@kernel
def is_start(k, free_x, free_y):
    """Return whether free cell `k` is the lower left one."""
    return free_x[k] == 0 and free_y[k] == 0


@kernel
def is_inside(k, edge, free_x, free_y):
    """Return whether free cell `k` is in the region from `edge` on, and not the start."""
    return free_x[k] >= edge and free_y[k] >= edge and not is_start(k, free_x, free_y)


@kernel
def put(s, what, k, margin, free_x, free_y):
    """Put `what` in free cell `k`, if any; return the cell's x and y in the world."""
    if k == NEVER:
        return NEVER, NEVER
    x, y = margin + free_x[k], margin + free_y[k]
    s.cell[y, x] = what
    return x, y


def grid(s: Any) -> np.ndarray:
    """Return the contents of every cell, [world, world] uint8."""
    side = s["world"]  # read as attributes, fields of a record take four times as long
    return s["cell"][:side, :side].copy()


def describe(s: Any) -> dict[str, Any]:
    """Return the level of state `s` as plain data, with the lowest row of `grid` first."""

    def cell(x: int, y: int) -> list[int] | None:
        return None if x == NEVER else [int(x), int(y)]

    return {
        "world": int(s.world),
        "maze_size": int(s.maze_size),
        "grid": grid(s).tolist(),
        "legend": {"empty": EMPTY, "wall": WALL, "goal": GOAL, "other": OTHER}
        | ({"goal on other": BOTH} if (s.cell == BOTH).any() else {}),
        "agent": centre(s),
        "goal": cell(s.goal_x, s.goal_y),
        "other": cell(s.other_x, s.other_y),
        "corner": cell(s.corner_x, s.corner_y),
        "looks": {"background": int(s.background), "background_offset": float(s.background_offset)},
    }


def invariants(s: np.ndarray, variant: Variant) -> dict[str, np.ndarray]:
    """Return facts [N] about states `s` [N] of `variant` that compiled code relies on."""
    p = variant.records()[0]
    return truths(s) | {
        "world": s["world"] == p.world,
        "window": s["window"] == p.window,
        "dish": (s["other_shape"] == DISH) == (p.other_shape == DISH),
    }


def truths(s: np.ndarray) -> dict[str, np.ndarray]:
    """Return facts [N] about states `s` [N] of every variant."""
    x, y = (np.clip(np.nan_to_num(s[axis]), 0, LARGEST - 1).astype(int) for axis in "xy")
    found: dict[str, Any] = {
        "world": within(s["world"], 3, LARGEST + 1),
        "cell": (s["cell"] <= BOTH).all((1, 2)),
        "x": (s["x"] > 0) & (s["x"] < s["world"]),
        "y": (s["y"] > 0) & (s["y"] < s["world"]),
        "cell of the mouse": s["cell"][np.arange(len(s)), y, x] != WALL,
        "maze_size": within(s["maze_size"], 1, s["world"] + 1),
        "walls": within(s["walls"], 0, len(WALLS)),
        "background": within(s["background"], 0, FLOORS),
        "background_offset": (s["background_offset"] >= 0) & (s["background_offset"] <= 1),
    }
    for place in ("goal", "other", "corner"):
        for axis in "xy":
            found[f"{place}_{axis}"] = within(s[f"{place}_{axis}"], NEVER, s["world"])
        found[place] = (s[f"{place}_x"] == NEVER) == (s[f"{place}_y"] == NEVER)
    for one, shapes in (("goal", SHAPES), ("other", OTHERS)):  # invisible without colour
        hidden = (one == "other") & (s["other_x"] != NEVER)  # a goal may be invisible, no other
        found[f"{one}_shape"] = within(s[f"{one}_shape"], hidden, len(shapes))
        found[f"{one}_colour"] = within(s[f"{one}_colour"], s[f"{one}_shape"] > 0, len(COLOURS))
    return found


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
    s = fresh(rules)[0]
    furnish(s, p)
    s.time_limit = variant.time_limit
    s.cell[:] = WALL
    s.cell[:height, :width] = cells
    s.x, s.y = agent[0] + 0.5, agent[1] + 0.5
    s.goal_x, s.goal_y = _only(cells, (GOAL, BOTH), "goal")
    s.other_x, s.other_y = _only(cells, (OTHER, BOTH), "other")
    if s.other_x != NEVER and p.other_shape == 0:
        raise ValueError("the other object would be invisible: the variant's other_shape is 'none'")
    if (cells == BOTH).any() and p.other_shape != DISH:
        raise ValueError("a goal lies on the other object only where that is a dish")
    rows, columns = np.nonzero(cells != WALL)
    s.maze_size = max(np.ptp(rows), np.ptp(columns)) + 1
    corner_x, corner_y = columns.max(), rows.max()
    is_open = cells[corner_y, corner_x] != WALL
    s.corner_x, s.corner_y = (corner_x, corner_y) if is_open else (NEVER, NEVER)
    s.background = looks.get("background", max(p.background, 0))
    s.background_offset = looks.get("background_offset", 0.0)
    note_arrivals(s)
    return s


def _only(cells: np.ndarray, values: tuple[int, int], name: str) -> tuple[int, int]:
    """Return the single cell (x, y) with one of `values`, or (NEVER, NEVER)."""
    found = [(int(x), int(y)) for y, x in np.argwhere(np.isin(cells, values))]
    if len(found) > 1:
        raise ValueError(f"a level has at most one {name}; this has one at each of {found}")
    return found[0] if found else (NEVER, NEVER)
