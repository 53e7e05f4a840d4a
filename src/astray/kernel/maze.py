"""Mazes, carved as in the original by Kruskal's algorithm on a shuffled list, and drawn."""

from typing import Any

import numpy as np

from astray.kernel.canvas import pixel, tile
from astray.kernel.grid import UNREACHABLE, distances
from astray.kernel.jit import kernel
from astray.kernel.rng import below

WALL = 1  # in a state's `cell`
FLOORS = 9  # backgrounds
AS_NUMBERED = -1  # the background that the level's number decides


@kernel
def carve(s, size, is_open, free_x, free_y):
    """Carve a spanning tree into `is_open` and return its number of free cells.

    Args:
        s: State whose random generator is used, once per passage.
        size: Side in cells, odd; nodes are the cells with two even coordinates.
        is_open: [size, size] bool, indexed [y, x], all False; filled.
        free_x, free_y: [size * size], the free cells in opening order; filled.
    """
    # A passage is x * size + y. First those that join nodes to the left and right of them.
    passages = np.empty(size * size, np.int16)  # small: the list is moved a lot
    count = 0
    for x in range(1, size, 2):
        for y in range(0, size, 2):
            passages[count] = x * size + y
            count += 1
    for x in range(0, size, 2):
        for y in range(1, size, 2):
            passages[count] = x * size + y
            count += 1
    parent = np.arange(size * size)
    free = 0
    while count > 0:
        pick = below(s, count)
        passage = int(passages[pick])
        x, y = passage // size, passage % size
        count -= 1
        rest = passages[pick : count + 1]  # whose order matters to later draws
        for k in range(count - pick):
            rest[k] = rest[k + 1]
        dx = x % 2
        dy = 1 - dx
        one = root(parent, (x - dx) * size + y - dy)
        two = root(parent, (x + dx) * size + y + dy)
        if one != two:
            parent[one] = two
            for k in range(-1, 2):
                i, j = x + k * dx, y + k * dy
                if not is_open[j, i]:
                    is_open[j, i] = True
                    free_x[free], free_y[free] = i, j
                    free += 1
    return free


@kernel
def root(parent, node):
    """Return the representative of `node`'s tree; halve the path on the way."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node


@kernel
def margin(s):
    """Return the width in cells of the wall around the world, so that windows fit in the scene."""
    return s.window // 2 + 1 if s.window else 0


@kernel
def is_wall(s, x, y):
    """Return whether cell (x, y) is a wall or outside of the world."""
    return not (0 <= x < s.world and 0 <= y < s.world) or s.cell[y, x] == WALL


@kernel
def paint_maze(s, picture, floor, wall):
    """Draw floor and walls of the world of `s` and its margin on a square picture."""
    edge = margin(s)
    cells = s.world + 2 * edge
    scale = picture.shape[1] / cells
    left = pixel(edge, scale)
    width = pixel(edge + s.world, scale) - left
    side = floor.shape[0]
    offset = int(s.background_offset * (floor.shape[1] - side))
    for row in range(width):
        for column in range(width):
            v, u = row * side // width, offset + column * side // width
            for c in range(3):
                picture[left + row, left + column, c] = floor[v, u, c]
    for y in range(cells):
        top, bottom = pixel(cells - 1 - y, scale), pixel(cells - y, scale)
        for x in range(cells):
            if is_wall(s, x - edge, y - edge):
                tile(picture, wall, top, bottom, pixel(x, scale), pixel(x + 1, scale))


@kernel
def paint_walls(s, plane):
    """Write 1 for walls in the world of `s` and its margin, else 0, on a symbolic plane."""
    edge = margin(s)
    for y in range(s.world + 2 * edge):
        for x in range(s.world + 2 * edge):
            plane[y, x] = is_wall(s, x - edge, y - edge)


def cell_pixels(variant: Any, pixels: int) -> float:
    """Return the side of a cell in pixels on an image of `pixels`."""
    return pixels / (variant.window or variant.world)


def scene_cells(variant: Any) -> int:
    """Return the side of the scene in cells, with the margin around the world."""
    return variant.world + 2 * (variant.window // 2 + 1 if variant.window else 0)


def reachable(s: Any) -> np.ndarray:
    """Return the cells that the agent can walk to, [world, world] bool."""
    is_open = s.cell[: s.world, : s.world] != WALL
    return distances(is_open, int(s.x), int(s.y)) != UNREACHABLE
