"""Keys and Chests as pictures at any scale, and as symbolic planes."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from astray.art import own
from astray.game import OWN, Variant
from astray.games.keys.rules import (
    FIRST_SLOT,
    HIDDEN,
    KEY,
    LOWER_LEFT,
    LOWER_RIGHT,
    SLOT,
    SLOT_DOWN,
    UPPER_LEFT,
)
from astray.kernel.canvas import blit, pixel
from astray.kernel.jit import kernel, shared
from astray.kernel.maze import margin, paint_walls, scene_cells, show, show_planes, spread
from astray.kernel.stage import STRIPS, clear_gone, draw_thief, lay, mark_thief, paint_bare

ART = Path(__file__).parent / "art"
KEY_SIDE = 0.8  # cells; larger than what touches, to be seen
# The symbolic planes of 0 and 1: walls, keys, chests, the thief's cell, and as many cells as
# there are keys in hand, row by row; then, in the thief's cell, where in it the thief is.
WALL_PLANE, KEY_PLANE, CHEST_PLANE, THIEF_PLANE, HAND_PLANE, X_PLANE, Y_PLANE, PLANES = range(8)


@kernel
def background(s, art, scene):
    """Draw floor and walls of the whole world and its margin: twice, above with objects."""
    seen = paint_bare(s, art[0], art[1], scene)
    for k in range(s.objects):
        if s.gone[k] < 0:
            lay(s, seen, k, art[3] if s.what[k] == KEY else art[4])


@kernel
def foreground(s, art, scene, image):
    """Draw the scene or its window around the thief, with the thief and the inventory."""
    if s.taken:
        clear_gone(s, scene)
    left, top = show(s, scene, image)
    draw_thief(s, art[2], scene.shape[1], image, top, left)
    draw_hand(s, art[5], image)


@shared
def draw_hand(s, icon, image):
    """Draw the icons of the keys in hand."""
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
    left, low = show_planes(s, scene, planes)
    mark_thief(s, planes, left, low, THIEF_PLANE, X_PLANE, Y_PLANE)
    side = planes.shape[1]
    if s.inventory != HIDDEN:
        for k in range(min(s.taken - s.opened, side * side)):
            planes[HAND_PLANE, k // side, k % side] = 1


def planes(variant: Variant) -> np.ndarray:
    """Return the largest value of each symbolic plane, [C, H, W] uint8."""
    top = np.ones(PLANES, np.uint8)
    top[[X_PLANE, Y_PLANE]] = STRIPS
    return spread(variant, top)


def planes_scene_shape(variant: Variant) -> tuple[int, ...]:
    return (PLANES, scene_cells(variant), scene_cells(variant))


def things(load: Callable, cells: Callable, icon: tuple[int, int]) -> tuple[np.ndarray, ...]:
    """Return key, chest and icon, each [height, width, 4]."""
    return load("key", *cells(KEY_SIDE)), load("chest", *cells(1)), load("icon", *icon)


LOOKS = {OWN: own.thief_looks(ART, background, foreground, things)}
