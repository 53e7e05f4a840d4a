"""Heist as pictures, at any scale, and as symbolic planes."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from astray.art import own
from astray.game import OWN, Variant
from astray.games.heist.rules import COLOURS, DOOR_CODE, GEM, KEY
from astray.kernel.canvas import blit, pixel
from astray.kernel.jit import kernel
from astray.kernel.maze import margin, paint_walls, scene_cells, show, show_planes, spread
from astray.kernel.stage import STRIPS, clear_gone, draw_thief, lay, mark_thief, paint_bare

ART = Path(__file__).parent / "art"
ICON_RIGHT, ICON_DOWN, SLOT = 0.0375, 0.0597, 0.06  # of the first one's centre; to the next one's
# The symbolic planes, those of 0 and 1 first: walls, the gem, the thief's cell, and in the first
# cells the keys in hand, a cell for each colour; then keys and doors, of each colour its number, 1
# for blue; then, in the thief's cell, where in it the thief is.
WALL_PLANE, GEM_PLANE, THIEF_PLANE, HAND_PLANE = range(4)
KEY_PLANE, DOOR_PLANE, X_PLANE, Y_PLANE, PLANES = range(4, 9)


@kernel
def background(s, art, scene):
    """Draw floor and walls of the whole world and its margin: twice, above with objects."""
    seen = paint_bare(s, art[0], art[1], scene)
    for k in range(s.objects):
        if s.gone[k] < 0:
            lay(s, seen, k, art[3][s.what[k] - KEY])


@kernel
def foreground(s, art, scene, image):
    """Draw the scene or its window around the thief, with the thief and the keys in hand."""
    clear_gone(s, scene)
    left, top = show(s, scene, image)
    draw_thief(s, art[2], scene.shape[1], image, top, left)
    side, icons = image.shape[0], art[4]
    for k in range(icons.shape[0]):
        if s.hand >> k & 1:
            right = 1 - ICON_RIGHT - k * SLOT
            top = pixel(ICON_DOWN, side) - icons.shape[1] // 2
            blit(image, icons[k], top, pixel(right, side) - icons.shape[2] // 2)


@kernel
def background_planes(s, scene):
    """Draw walls and objects of the whole world and its margin."""
    edge = margin(s)
    scene[:] = 0
    paint_walls(s, scene[WALL_PLANE])
    for k in range(s.objects):
        if s.gone[k] < 0:
            x, y = edge + int(s.object_x[k]), edge + int(s.object_y[k])
            if s.what[k] == GEM:
                scene[GEM_PLANE, y, x] = 1
            elif s.what[k] >= DOOR_CODE:
                scene[DOOR_PLANE, y, x] = s.what[k] - DOOR_CODE + 1
            else:
                scene[KEY_PLANE, y, x] = s.what[k] - KEY + 1


@kernel
def foreground_planes(s, scene, planes):
    """Draw the scene or its window around the thief, with the thief and its keys."""
    edge = margin(s)
    for k in range(s.objects):
        if s.gone[k] == s.time:
            x, y = edge + int(s.object_x[k]), edge + int(s.object_y[k])
            scene[:, y, x] = 0  # nothing else is in an object's cell
    left, low = show_planes(s, scene, planes)
    mark_thief(s, planes, left, low, THIEF_PLANE, X_PLANE, Y_PLANE)
    for k in range(len(COLOURS)):
        planes[HAND_PLANE, 0, k] = s.hand >> k & 1


def planes(variant: Variant) -> np.ndarray:
    """Return the largest value of each symbolic plane, [C, H, W] uint8."""
    top = np.ones(PLANES, np.uint8)
    top[[KEY_PLANE, DOOR_PLANE]], top[[X_PLANE, Y_PLANE]] = len(COLOURS), STRIPS
    return spread(variant, top)


def planes_scene_shape(variant: Variant) -> tuple[int, ...]:
    return (PLANES, scene_cells(variant), scene_cells(variant))


def things(load: Callable, cells: Callable, icon: tuple[int, int]) -> tuple[list, list]:
    """Return keys and doors by colour and the gem, [7, S, S, 4], and icons of keys by colour."""

    def coloured(name: str, *size: int) -> list[np.ndarray]:
        return [own.tint(load(name, *size), own.COLOURS[colour]) for colour in COLOURS]

    cell = cells(1)
    objects = [*coloured("key", *cell), *coloured("door", *cell), load("gem", *cell)]
    return objects, coloured("icon", *icon)


LOOKS = {OWN: own.thief_looks(ART, background, foreground, things)}
