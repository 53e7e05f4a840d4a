"""Keys and Chests with the original's pictures, exact in every pixel."""

from __future__ import annotations

import functools
from typing import Any

import numpy as np

from astray.art import original
from astray.game import Looks, Variant
from astray.games.keys.rules import CHEST, HALF, HIDDEN, LOWER_LEFT, LOWER_RIGHT, UPPER_LEFT, F
from astray.kernel.canvas import copy_flat
from astray.kernel.cells import OPEN, paint_cells
from astray.kernel.jit import kernel, shared
from astray.kernel.maze import FLOORS, is_wall
from astray.kernel.qt import GENERIC, SPRITE, around, blit, blit_turned, camera
from astray.record import NEVER

FLOOR_PICTURES = (
    "topdown_backgrounds/floortiles.png",
    *(f"topdown_backgrounds/backgrounddetailed{k}.png" for k in range(1, FLOORS)),
)
PICTURES = (
    *FLOOR_PICTURES,
    "kenney/Ground/Dirt/dirtCenter.png",
    "misc_assets/spaceAstronauts_008.png",
    "misc_assets/keyGreen.png",
    "misc_assets/lock_blue.png",
)
WALL_PLACE, THIEF_PLACE, KEY_PLACE, CHEST_PLACE = range(FLOORS, FLOORS + 4)  # among the pictures
KEY_ASPECT = F(84 / 52)  # of the key's picture
KEY_WIDE, CHEST_HALF = F(0.375), F(0.5)  # half the side of their pictures, cells
KEY_HIGH = KEY_WIDE / KEY_ASPECT
ICON = F(0.03)  # half the width of an icon, before it is turned, of the image's side
ICON_DOWN = F(ICON * F(0.75))  # of its centre, from the upper edge
# By action: -arctan2(ay, ax) in eighths of a turn; to the left -4, and without a move 0.
TURNS = np.array([3, -4, -3, 2, 0, -2, 1, 0, -1])


@kernel
def looking(s, side):
    """Return the camera."""
    if s.window:
        return camera(side, s.window, s.x, s.y)
    return camera(side, s.world, F(s.world) * F(0.5), F(s.world) * F(0.5))


@shared
def background(s, art, scene):
    """Draw the world without the thief twice, above with objects, unless a window moves."""
    if s.window == 0:
        side = scene.shape[1]
        paint_walls(s, art, scene[side:])
        paint_objects(s, art, scene)


@shared
def paint_walls(s, art, image):
    """Draw floor and walls of the whole world or of the window around the thief."""
    pixels, places, rule = art
    left, low, columns, rows = np.int64(0), np.int64(0), s.world, s.world
    if s.window:
        half = F(s.window) / F(2) + F(1)
        left, low = int(s.x - half), int(s.y - half)
        columns, rows = int(s.x + half) - left + 1, int(s.y + half) - low + 1
    cells = np.full((rows, columns), OPEN)
    for j in range(rows):
        for i in range(columns):
            if is_wall(s, left + i, low + j):
                cells[j, i] = WALL_PLACE
    background, seen = (s.background, s.background_offset), looking(s, image.shape[0])
    paint_cells(image, pixels, places, cells, seen, left, low, s.world, background, rule[0])


@shared
def paint_objects(s, art, scene):
    """Copy the scene's lower part to its upper part, and draw the remaining objects there."""
    side = scene.shape[1]
    copy_flat(scene[:side], scene[side:])
    draw_objects(s, art, scene[:side])


@shared
def draw_objects(s, art, image):
    """Draw the remaining keys and chests."""
    pixels, places, _ = art
    seen = looking(s, image.shape[0])
    for k in range(s.objects):
        if s.gone[k] == NEVER:
            is_chest = s.what[k] == CHEST
            wide = CHEST_HALF if is_chest else KEY_WIDE
            high = CHEST_HALF if is_chest else KEY_HIGH
            rect = around(seen, s.object_x[k], s.object_y[k], wide, high)
            place = places[CHEST_PLACE] if is_chest else places[KEY_PLACE]
            blit(image, pixels, place, rect, False)


@kernel
def has_one_gone(s):
    """Return whether an object disappeared in the last step."""
    gone = False
    for k in range(s.objects):
        gone = gone or s.gone[k] == s.time
    return gone


@shared
def foreground(s, art, scene, image):
    """Draw the scene or its window around the thief, with the thief and the inventory."""
    pixels, places, _ = art
    if s.window:
        paint_walls(s, art, image)
        draw_objects(s, art, image)
    else:
        if s.taken and has_one_gone(s):
            paint_objects(s, art, scene)
        copy_flat(image, scene[: scene.shape[1]])
    rect = around(looking(s, image.shape[0]), s.x, s.y, HALF, HALF)
    blit_turned(image, pixels, places[THIEF_PLACE], rect, TURNS[s.facing])
    if s.inventory != HIDDEN:
        for slot in range(s.taken - s.opened):
            rect = icon_box(s, image.shape[0], slot)
            blit_turned(image, pixels, places[KEY_PLACE], rect, 2)


@kernel
def icon_box(s, side, slot):
    """Return the pixels of an icon before rotation, counted from the right or left side."""
    unit, view, _, _ = looking(s, side)
    x = F(1 - np.float64(ICON) * (2 * slot + 1.25))
    y, wide, high = ICON_DOWN, ICON, ICON / KEY_ASPECT
    if s.inventory == UPPER_LEFT or s.inventory == LOWER_LEFT:
        x = F(1) - x
    if s.inventory == LOWER_LEFT or s.inventory == LOWER_RIGHT:
        y = F(1) - y
    return (
        np.float64((view * (x - wide)) * unit),
        # The original adds where it means to subtract: icons hang a little lower.
        np.float64((view * (y + high)) * unit),
        np.float64(((F(2) * view) * wide) * unit),
        np.float64(((F(2) * view) * high) * unit),
    )


def scene_shape(variant: Variant, pixels: int) -> tuple[int, ...]:
    p: Any = variant
    return (1, 1, 3) if p.window else (2 * pixels, pixels, 3)


def art(rule: int, variant: Variant, pixels: int) -> tuple[np.ndarray, ...]:
    """Return pixels [N] and places [K, 3] of all pictures, and the rule [1]."""
    return _art(rule)


@functools.cache
def _art(rule: int) -> tuple[np.ndarray, ...]:
    return *original.atlas(PICTURES, FLOORS), np.array([rule])


LOOKS = {
    name: Looks("original", background, foreground, functools.partial(art, rule), scene_shape)
    for name, rule in {"original": GENERIC, "original-5.12": SPRITE}.items()
}
