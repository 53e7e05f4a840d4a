"""Mazes, carved as in the original by Kruskal's algorithm on a shuffled list, and drawn."""

from typing import Any

import numpy as np

from astray.kernel.canvas import blit, copy_flat, copy_window, pixel, tile
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
def dig(s, size):
    """Return a maze carved by `carve`, [size, size] uint8: WALL, or 0 for free cells."""
    is_open = np.zeros((size, size), np.bool_)
    free_x, free_y = np.empty(size * size, np.int64), np.empty(size * size, np.int64)
    carve(s, size, is_open, free_x, free_y)
    inside = np.empty((size, size), np.uint8)
    for k in range(size * size):
        inside[k // size, k % size] = 0 if is_open[k // size, k % size] else WALL
    return inside


@kernel
def beside(inside, x, y, what):
    """Count the neighbours of a cell that hold `what`; the maze is surrounded by WALL."""
    size, count = inside.shape[0], 0
    for k in range(4):
        u, v = x + (k == 0) - (k == 1), y + (k == 2) - (k == 3)
        there = inside[v, u] if 0 <= u < size and 0 <= v < size else np.uint8(WALL)
        count += there == what
    return count


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
def show(s, scene, image):
    """Copy the scene or its window around the agent; return the window's left and upper pixel.

    If the scene is higher than wide, only its upper square is shown.
    """
    side, edge = scene.shape[1], margin(s)
    if not s.window:
        copy_flat(image, scene[:side])
        return 0, 0
    cells = s.world + 2 * edge
    scale = side / cells
    left = pixel(s.x + edge - s.window / 2, scale)
    top = pixel(cells - (s.y + edge) - s.window / 2, scale)
    copy_window(image, scene, top, left)
    return left, top


@kernel
def stamp(image, sprite, scale, top, left, down, right):
    """Blit `sprite` centred `down` and `right` cells from the scene's upper left."""
    half = sprite.shape[0] / (2 * scale)
    blit(image, sprite, pixel(down - half, scale) - top, pixel(right - half, scale) - left)


@kernel
def show_planes(s, scene, planes):
    """Copy the symbolic scene or its window around the agent; return the lower left cell."""
    if not s.window:
        copy_flat(planes, scene)
        return 0, 0
    edge, side = margin(s), planes.shape[1]
    left, low = int(s.x) + edge - side // 2, int(s.y) + edge - side // 2
    for plane in range(planes.shape[0]):
        for row in range(side):
            for column in range(side):
                planes[plane, row, column] = scene[plane, low + row, left + column]
    return left, low


@kernel
def paint_walls(s, plane):
    """Write 1 for walls in the world of `s` and its margin, else 0, on a symbolic plane."""
    edge = margin(s)
    for y in range(s.world + 2 * edge):
        for x in range(s.world + 2 * edge):
            plane[y, x] = is_wall(s, x - edge, y - edge)


def check_sizes(variant: Any, least: int, largest: int) -> None:
    """Check a variant's world, mazes, window and floor.

    Raises:
        ValueError: If one of these is out of range, or unlike in levels that are shifted.
    """
    p, sizes = variant, (variant.smallest, variant.largest)
    if not least <= p.world <= largest:
        raise ValueError(f"world must be from {least} to {largest}; got {p.world} cells a side")
    if not least <= sizes[0] <= sizes[1] <= p.world or not sizes[0] % 2 == sizes[1] % 2 == 1:
        raise ValueError(
            f"smallest and largest must be odd, in order, and from {least} to the world's "
            f"{p.world} cells; got {sizes}"
        )
    if not 0 <= p.window <= 2 * p.world:
        raise ValueError(f"window must be from 0 to {2 * p.world}; got {p.window} cells")
    if not AS_NUMBERED <= p.background < FLOORS:
        raise ValueError(
            f"background must be from 0 to {FLOORS - 1}, or {AS_NUMBERED} for what the "
            f"level's number decides; got {p.background}"
        )
    if p.shift_probability and (p.world, p.window) != (p.shifted.world, p.shifted.window):
        raise ValueError("the shifted variant has another world or window: it looks different")


def cell_pixels(variant: Any, pixels: int) -> float:
    """Return the side of a cell in pixels on an image of `pixels`."""
    return pixels / (variant.window or variant.world)


def scene_cells(variant: Any) -> int:
    """Return the side of the scene in cells, with the margin around the world."""
    return variant.world + 2 * (variant.window // 2 + 1 if variant.window else 0)


def scene_pixels(variant: Any, pixels: int, count: int) -> tuple[int, ...]:
    """Return the shape of `count` scenes below each other, for an image of `pixels` a side."""
    side = round(scene_cells(variant) * cell_pixels(variant, pixels))
    return (count * side, side, 3)


def spread(variant: Any, top: np.ndarray) -> np.ndarray:
    """Broadcast the largest values `top` [C] of symbolic planes to all visible cells, [C, H, W]."""
    # All cells that are at least half in the window.
    side = variant.window // 2 * 2 + 1 if variant.window else variant.world
    return np.broadcast_to(top[:, None, None], (len(top), side, side)).copy()


def reachable(s: Any) -> np.ndarray:
    """Return the cells that the agent can walk to, [world, world] bool."""
    is_open = s.cell[: s.world, : s.world] != WALL
    return distances(is_open, int(s.x), int(s.y)) != UNREACHABLE
