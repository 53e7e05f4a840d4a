"""Keys and Chests as pictures at any scale, and as symbolic planes."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import Any

import numpy as np

from astray.art import own
from astray.game import OWN, Looks, Variant
from astray.games.keys.rules import (
    FIRST_SLOT,
    HALF,
    HIDDEN,
    KEY,
    LOWER_LEFT,
    LOWER_RIGHT,
    SLOT,
    SLOT_DOWN,
    UPPER_LEFT,
)
from astray.kernel.canvas import blit, copy_flat, copy_window, pixel
from astray.kernel.grid import ACTIONS, STAY
from astray.kernel.jit import kernel, shared
from astray.kernel.maze import FLOORS, cell_pixels, margin, paint_maze, paint_walls, scene_cells

ART = Path(__file__).parent / "art"
FLOOR = 256  # pixels of a floor's height; larger pictures repeat them
KEY_SIDE = 0.8  # cells; larger than what touches, to be seen
ICON = (0.06, 0.045)  # height and width of an icon, of the picture's side
# The symbolic planes of 0 and 1: walls, keys, chests, the thief's cell, and as many cells as
# there are keys in hand, row by row; then, in the thief's cell, where in it the thief is.
WALL_PLANE, KEY_PLANE, CHEST_PLANE, THIEF_PLANE, HAND_PLANE, X_PLANE, Y_PLANE, PLANES = range(8)
STRIPS = 8  # that a cell is cut into by X_PLANE and Y_PLANE, from 1 on


@kernel
def background(s, art, scene):
    """Draw floor and walls of the whole world and its margin: twice, above with objects."""
    floors, wall = art[0], art[1]
    seen, bare = scene[: scene.shape[1]], scene[scene.shape[1] :]
    paint_maze(s, bare, floors[s.background], wall)
    copy_flat(seen, bare)
    for k in range(s.objects):
        if s.gone[k] < 0:
            paint_object(s, art, seen, k)


@kernel
def paint_object(s, art, scene, k):
    """Draw object `k`, clipped to its cell."""
    edge = margin(s)
    cells = s.world + 2 * edge
    scale = scene.shape[0] / cells
    right, down = edge + np.float64(s.object_x[k]), cells - edge - np.float64(s.object_y[k])
    sprite = art[2] if s.what[k] == KEY else art[3]
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
def foreground(s, art, scene, image):
    """Draw the scene or its window around the thief, with the thief and the inventory."""
    if s.taken:
        clear_gone(s, scene)
    left, top = 0, 0
    if s.window:
        edge = margin(s)
        cells = s.world + 2 * edge
        scale = scene.shape[1] / cells
        left = pixel(s.x + edge - s.window / 2, scale)
        top = pixel(cells - (s.y + edge) - s.window / 2, scale)
        copy_window(image, scene, top, left)
    else:
        copy_flat(image, scene[: scene.shape[1]])
    draw_thief(s, art, scene.shape[1], image, top, left)


@shared
def draw_thief(s, art, height, image, top, left):
    """Draw the thief, and over it its keys; `height` is the scene's."""
    edge = margin(s)
    cells = s.world + 2 * edge
    scale = height / cells
    thief, icon = art[4][s.facing], art[5]
    half = thief.shape[0] / (2 * scale)
    down, right = cells - edge - np.float64(s.y), edge + np.float64(s.x)
    blit(image, thief, pixel(down - half, scale) - top, pixel(right - half, scale) - left)
    if s.inventory == HIDDEN:
        return
    side = image.shape[0]
    for slot in range(s.taken - s.opened):
        down, right = SLOT_DOWN, 1 - FIRST_SLOT - slot * SLOT
        if s.inventory == LOWER_RIGHT or s.inventory == LOWER_LEFT:
            down = 1 - down
        if s.inventory == UPPER_LEFT or s.inventory == LOWER_LEFT:
            right = 1 - right
        top = pixel(down, side) - icon.shape[0] // 2
        blit(image, icon, top, pixel(right, side) - icon.shape[1] // 2)


@kernel
def background_planes(s, scene):
    """Write walls, keys and chests of the whole world, and its margin."""
    edge = margin(s)
    scene[:] = 0
    paint_walls(s, scene[WALL_PLANE])
    for k in range(s.objects):
        if s.gone[k] < 0:
            scene[object_plane(s, k), edge + int(s.object_y[k]), edge + int(s.object_x[k])] = 1


@kernel
def object_plane(s, k):
    return KEY_PLANE if s.what[k] == KEY else CHEST_PLANE


@kernel
def foreground_planes(s, scene, planes):
    """Write the scene or its window around the thief, with the thief and its keys."""
    edge = margin(s)
    if s.taken:
        for k in range(s.objects):
            if s.gone[k] == s.time:
                scene[object_plane(s, k), edge + int(s.object_y[k]), edge + int(s.object_x[k])] = 0
    x, y = int(s.x), int(s.y)
    side = planes.shape[1]
    if s.window:
        left, low = x + edge - side // 2, y + edge - side // 2
        for plane in range(PLANES):
            for row in range(side):
                for column in range(side):
                    planes[plane, row, column] = scene[plane, low + row, left + column]
        x, y = side // 2, side // 2
    else:
        copy_flat(planes, scene)
    planes[THIEF_PLANE, y, x] = 1
    planes[X_PLANE, y, x] = 1 + int((s.x - np.floor(s.x)) * STRIPS)
    planes[Y_PLANE, y, x] = 1 + int((s.y - np.floor(s.y)) * STRIPS)
    if s.inventory != HIDDEN:
        for k in range(min(s.taken - s.opened, side * side)):
            planes[HAND_PLANE, k // side, k % side] = 1


def planes(variant: Variant) -> np.ndarray:
    """Return the largest value of each symbolic plane, [C, H, W] uint8."""
    p: Any = variant
    side = p.window // 2 * 2 + 1 if p.window else p.world  # all cells at least half seen
    top = np.ones(PLANES, np.uint8)
    top[[X_PLANE, Y_PLANE]] = STRIPS
    return np.broadcast_to(top[:, None, None], (PLANES, side, side)).copy()


def planes_scene_shape(variant: Variant) -> tuple[int, ...]:
    return (PLANES, scene_cells(variant), scene_cells(variant))


def scene_shape(variant: Variant, pixels: int) -> tuple[int, ...]:
    side = round(scene_cells(variant) * cell_pixels(variant, pixels))
    return (2 * side, side, 3)  # with the objects that are left, and below without


def art(variant: Variant, pixels: int) -> tuple[np.ndarray, ...]:
    """Return floors [9, h, 2h, 3], wall [S, S, 3], key, chest, thief by action [9, ...], icon.

    S is a cell's side, rounded up; all but floors and wall are [height, width, 4].
    """
    scale = cell_pixels(variant, pixels)
    p: Any = variant
    return _art(scale, min(max(round(p.world * scale), 1), FLOOR), pixels)


@functools.cache
def _art(scale: float, height: int, pixels: int) -> tuple[np.ndarray, ...]:
    def load(name: str, height: int, width: int) -> np.ndarray:
        return own.resize(own.load(ART, name), height, width)

    cell, key = int(np.ceil(scale)), int(np.ceil(KEY_SIDE * scale))
    body = int(np.ceil(2 * HALF * scale))
    floors = [load(f"floor-{k}", height, 2 * height)[..., :3] for k in range(FLOORS)]
    wall = load("wall-brick", cell, cell)[..., :3]
    icon = load("icon", *(max(round(share * pixels), 1) for share in ICON))
    thief = _turned(load("thief-right", body, body), load("thief-right-up", body, body))
    made = (floors, wall, load("key", key, key), load("chest", cell, cell), thief, icon)
    # All contiguous, or compiled code would be compiled anew for another layout.
    return tuple(map(np.ascontiguousarray, made))


def _turned(right: np.ndarray, right_up: np.ndarray) -> np.ndarray:
    """Return the thief's picture after each action, [9, S, S, 4]; "stay" faces right."""
    straight, oblique = (
        ("right", "up", "left", "down"),
        ("right-up", "left-up", "left-down", "right-down"),
    )
    turned = np.repeat(right[None], STAY * 2 + 1, 0)
    for quarter in range(4):
        turned[ACTIONS.index(straight[quarter])] = np.rot90(right, quarter)
        turned[ACTIONS.index(oblique[quarter])] = np.rot90(right_up, quarter)
    return turned


LOOKS = {OWN: Looks(OWN, background, foreground, art, scene_shape)}
