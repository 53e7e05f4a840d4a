"""Heist as the original draws it, pixel by pixel, with its pictures."""

import numpy as np

from astray.art import original
from astray.games.heist.rules import COLOURS, DOOR_CODE, GEM, GEM_HIGH, KEY
from astray.kernel import overhead
from astray.kernel.jit import shared
from astray.kernel.thief import KEY_HIGH, KEY_WIDE

PICTURES = (
    *original.FLOORS,
    "kenney/Ground/Dirt/dirtCenter.png",
    "misc_assets/spaceAstronauts_008.png",
    *(f"misc_assets/key{colour.title()}.png" for colour in COLOURS),
    *(f"misc_assets/lock_{colour}.png" for colour in COLOURS),
    "misc_assets/gemYellow.png",
)
# By the code of an object: its picture, and half its width and height in cells.
THINGS = np.arange(GEM + 1) - KEY + overhead.FIRST_PLACE
HALVES = np.full((GEM + 1, 2), 0.5, np.float32)
HALVES[KEY:DOOR_CODE] = KEY_WIDE, KEY_HIGH
HALVES[GEM] = KEY_WIDE, GEM_HIGH


@shared
def foreground(s, art, scene, image):
    """Draw the scene or its window around the thief, with the thief and the keys in hand."""
    overhead.draw_scene(s, art, scene, image)
    for k in range(len(COLOURS)):
        if s.hand >> k & 1:
            overhead.draw_icon(s, art, image, KEY + k, overhead.icon_right(k), overhead.ICON_DOWN)


LOOKS = original.looks(overhead.background, foreground, PICTURES, THINGS, HALVES)
