"""Keys and Chests as the original draws it, pixel by pixel, with its pictures."""

import numpy as np

from astray.art import original
from astray.games.keys.rules import CHEST, HIDDEN, KEY, LOWER_LEFT, LOWER_RIGHT, UPPER_LEFT
from astray.kernel import overhead
from astray.kernel.jit import shared
from astray.kernel.thief import KEY_HIGH, KEY_WIDE, F

PICTURES = (
    *original.FLOORS,
    "kenney/Ground/Dirt/dirtCenter.png",
    "misc_assets/spaceAstronauts_008.png",
    "misc_assets/keyGreen.png",
    "misc_assets/lock_blue.png",
)
# By the code of an object: its picture, and half its width and height in cells.
THINGS, HALVES = np.zeros(CHEST + 1, np.int64), np.zeros((CHEST + 1, 2), np.float32)
THINGS[[KEY, CHEST]] = overhead.FIRST_PLACE, overhead.FIRST_PLACE + 1
HALVES[[KEY, CHEST]] = (KEY_WIDE, KEY_HIGH), (0.5, 0.5)


@shared
def foreground(s, art, scene, image):
    """Draw the scene or its window around the thief, with the thief and the inventory."""
    overhead.draw_scene(s, art, scene, image)
    if s.inventory != HIDDEN:
        for slot in range(s.taken - s.opened):
            x, y = overhead.icon_right(slot), overhead.ICON_DOWN
            if s.inventory == UPPER_LEFT or s.inventory == LOWER_LEFT:
                x = F(1) - x
            if s.inventory == LOWER_LEFT or s.inventory == LOWER_RIGHT:
                y = F(1) - y
            overhead.draw_icon(s, art, image, KEY, x, y)


LOOKS = original.looks(overhead.background, foreground, PICTURES, THINGS, HALVES)
