"""Mazes with a thief and objects that disappear, drawn with own art and as symbols.

States are those of `kernel.thief`. A scene is drawn twice: above with objects, below without.
"""

import numpy as np

from astray.kernel.canvas import blit, copy_flat, pixel
from astray.kernel.grid import ACTIONS, STAY
from astray.kernel.jit import kernel
from astray.kernel.maze import margin, paint_maze, stamp

STRIPS = 8  # that a cell is cut into by the two planes which say where in it the thief is


@kernel
def paint_bare(s, floors, wall, scene):
    """Draw floor and walls of the whole world and its margin, twice; return the upper part."""
    seen, bare = scene[: scene.shape[1]], scene[scene.shape[1] :]
    paint_maze(s, bare, floors[s.background], wall)
    copy_flat(seen, bare)
    return seen


@kernel
def lay(s, scene, k, sprite):
    """Draw object `k`, clipped to its cell."""
    edge = margin(s)
    cells = s.world + 2 * edge
    scale = scene.shape[0] / cells
    right, down = edge + np.float64(s.object_x[k]), cells - edge - np.float64(s.object_y[k])
    half = sprite.shape[0] / (2 * scale)
    left, top = pixel(np.floor(right), scale), pixel(np.floor(down), scale)
    inside = scene[top : pixel(np.floor(down) + 1, scale), left : pixel(np.floor(right) + 1, scale)]
    blit(inside, sprite, pixel(down - half, scale) - top, pixel(right - half, scale) - left)


@kernel
def clear_gone(s, scene):
    """Erase the objects that disappeared in the last step from the scene."""
    edge = margin(s)
    cells = s.world + 2 * edge
    side = scene.shape[1]
    scale = side / cells
    for k in range(s.objects):
        if s.gone[k] == s.time:
            x, y = edge + int(s.object_x[k]), cells - 1 - edge - int(s.object_y[k])
            for row in range(pixel(y, scale), pixel(y + 1, scale)):
                for column in range(pixel(x, scale), pixel(x + 1, scale)):
                    for c in range(3):
                        scene[row, column, c] = scene[side + row, column, c]


@kernel
def draw_thief(s, turned, height, image, top, left):
    """Draw the thief as its last move turned it; `height` is the scene's."""
    edge = margin(s)
    cells = s.world + 2 * edge
    down, right = cells - edge - np.float64(s.y), edge + np.float64(s.x)
    stamp(image, turned[s.facing], height / cells, top, left, down, right)


@kernel
def mark_thief(s, planes, left, low, thief, across, up):
    """Mark the thief's cell in the plane `thief`, and its place in that cell in two others."""
    edge = margin(s)
    x, y = int(s.x) + edge - left, int(s.y) + edge - low
    planes[thief, y, x] = 1
    planes[across, y, x] = 1 + int((s.x - np.floor(s.x)) * STRIPS)
    planes[up, y, x] = 1 + int((s.y - np.floor(s.y)) * STRIPS)


def turned(right: np.ndarray, right_up: np.ndarray) -> np.ndarray:
    """Return a picture of the thief for each action, [9, S, S, 4]; "stay" faces right.

    The arguments are pictures of the thief facing right, and facing the upper right; all [S, S, 4].
    """
    straight, oblique = (
        ("right", "up", "left", "down"),
        ("right-up", "left-up", "left-down", "right-down"),
    )
    found = np.repeat(right[None], STAY * 2 + 1, 0)
    for quarter in range(4):
        found[ACTIONS.index(straight[quarter])] = np.rot90(right, quarter)
        found[ACTIONS.index(oblique[quarter])] = np.rot90(right_up, quarter)
    return found
