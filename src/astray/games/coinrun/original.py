"""CoinRun with the original's pictures, exact in every pixel."""

import numpy as np

from astray.art import original
from astray.games.coinrun.draw import PERIOD, VIEW
from astray.games.coinrun.levels import BACKGROUNDS, CRATES
from astray.games.coinrun.rules import (
    COIN,
    CRATE,
    HALF,
    LAVA,
    LAVA_TOP,
    PERMEABLE,
    PUFFS,
    SAW,
    TALL,
    TOP,
    WALK,
    WALL,
    WORLD,
    F,
)
from astray.kernel.cells import OPEN, paint_cells
from astray.kernel.jit import kernel, shared
from astray.kernel.qt import around, blit, camera

SEEN = F(VIEW) / F(2) + F(1)  # cells from the runner to the last that are looked at
# The pictures in the order of their numbers, and the number of the first of each kind.
KINDS = {
    name: original.paths(pattern)
    for name, pattern in {
        "backgrounds": "(platform|space)_backgrounds.*", "centres": "kenney/Ground/.*Center.png",
        "tops": "kenney/Ground/.*Mid.png", "lava": ".*/lava.png", "lava top": ".*/lavaTop_low.png",
        "coin": ".*/coinGold.png", "saws": ".*/sawHalf.*", "crates": ".*/boxCrate.*",
        "walkers": "kenney/Enemies/(?!saw).*", "runners": "kenney/Players/.*",
        "puff": ".*/iconCircle_white.png",
    }.items()
}  # fmt: skip
PICTURES = tuple(path for paths in KINDS.values() for path in paths)
(BACKGROUND_PLACE, CENTRE_PLACE, TOP_PLACE, LAVA_PLACE, LAVA_TOP_PLACE, COIN_PLACE, SAW_PLACE,
 CRATE_PLACE, WALKER_PLACE, RUNNER_PLACE, PUFF_PLACE) = (
    PICTURES.index(paths[0]) for paths in KINDS.values()
)  # fmt: skip

HEAD = 0.7415  # of the runner's box, how far its picture is higher than it
PUFF_DOWN, PUFF_RISE = F(0.25), F(0.01)  # cells below the walker's centre; cells per step
PUFF_WIDE, PUFF_HIGH, PUFF_GROWTH = F(0.3), F(0.2), F(1.05)  # halves, cells; per step
PUFF_OPACITY, PUFF_FADE = F(0.5), F(0.8)  # per step


def _puffs() -> tuple[np.ndarray, np.ndarray]:
    """Return by age a puff's half sizes [PUFFS, 2], and its opacity of 255."""
    half, opacity = np.empty((PUFFS, 2), F), np.empty(PUFFS, np.int64)
    wide, high, left = PUFF_WIDE, PUFF_HIGH, PUFF_OPACITY
    for age in range(PUFFS):
        half[age], opacity[age] = (wide, high), 255 * int(256 * left) >> 8
        wide, high, left = wide * PUFF_GROWTH, high * PUFF_GROWTH, left * PUFF_FADE
    return half, opacity


PUFF_HALF, PUFF_LEFT = _puffs()


@shared
def background(s, art, scene):
    """Do nothing: the camera follows the runner, so no part of the image stays."""


@shared
def foreground(s, art, scene, image):
    """Draw the window around the runner."""
    pixels, places, rule = art
    seen = camera(image.shape[0], VIEW, s.x, s.y)
    draw_cells(s, pixels, places, rule[0], seen, image)
    draw_things(s, pixels, places, seen, image)
    draw_trails(s, pixels, places, rule[0], seen, image)
    draw_runner(s, pixels, places, seen, image)
    draw_walkers(s, pixels, places, seen, image)


@kernel
def draw_cells(s, pixels, places, rule, seen, image):
    """Draw background, ground, lava and coins; around the world there is wall."""
    picture = np.full(PERMEABLE + 1, OPEN)  # of what is in a cell, as `paint_cells` has it
    picture[WALL], picture[TOP] = CENTRE_PLACE + s.ground, TOP_PLACE + s.ground
    picture[PERMEABLE] = CENTRE_PLACE  # of dirt, whatever the level's ground
    picture[LAVA], picture[LAVA_TOP] = LAVA_PLACE, -2 - LAVA_TOP_PLACE
    picture[COIN] = -2 - COIN_PLACE
    left, low = int(s.x - SEEN), int(s.y - SEEN)
    columns, rows = int(s.x + SEEN) - left + 1, int(s.y + SEEN) - low + 1
    cells = np.full((rows, columns), picture[WALL])
    first, after = max(-left, 0), min(WORLD - left, columns)
    for j in range(max(-low, 0), min(WORLD - low, rows)):
        line = s.cell[low + j]
        for i in range(first, after):
            cells[j, i] = picture[line[left + i]]
    background = s.background + BACKGROUND_PLACE, s.background_offset
    paint_cells(image, pixels, places, cells, seen, left, low, WORLD, background, rule)


@shared
def draw_things(s, pixels, places, seen, image):
    """Draw saws, which turn with every step, then crates."""
    left, after = max(int(s.x - SEEN), 0), min(int(s.x + SEEN) + 1, WORLD)
    low, high = max(int(s.y - SEEN), 0), min(int(s.y + SEEN) + 1, WORLD)
    saws, crates = 0, 0
    for y in range(low, high):
        line = s.thing[y]
        for x in range(left, after):
            saws += line[x] == SAW
            crates += line[x] == CRATE
    for thing in (SAW, CRATE):
        many = saws if thing == SAW else crates
        for x in range(left, after if many else left):
            for y in range(low, high):
                if s.thing[y, x] == thing:
                    rect = around(seen, F(x) + HALF, F(y) + HALF, HALF, HALF)
                    if thing == SAW:
                        blit(image, pixels, places[SAW_PLACE + s.time % 2], rect, False)
                    else:
                        draw_crate(s.detail[y, x], pixels, places, rect, image)


@kernel
def draw_crate(detail, pixels, places, rect, image):
    """Draw a crate, over the one that it was put on."""
    if detail >= CRATES:
        blit(image, pixels, places[CRATE_PLACE + detail // CRATES - 1], rect, False)
    blit(image, pixels, places[CRATE_PLACE + detail % CRATES], rect, False)


@shared
def draw_trails(s, pixels, places, rule, seen, image):
    """Draw the walkers' trails, oldest puffs first; within a step, the last walker first."""
    far = SEEN + F(3)
    for age in range(min(s.time, PUFFS) - 1, -1, -1):
        for k in range(s.walkers - 1, -1, -1):
            x, y = s.trail_x[k, age], s.walker_y[k] - PUFF_DOWN
            if abs(x - s.x) < far and abs(y - s.y) < far:
                for _ in range(age):
                    y += PUFF_RISE
                rect = around(seen, x, y, PUFF_HALF[age, 0], PUFF_HALF[age, 1])
                blit(image, pixels, places[PUFF_PLACE], rect, False, PUFF_LEFT[age], rule)


@kernel
def draw_runner(s, pixels, places, seen, image):
    """Draw the runner, which begins as if walking; its picture is higher than its hit box."""
    left, top, wide, high = around(seen, s.x, s.y, HALF, TALL)
    rect = left, top - HEAD * high, wide, 1.7415 * high
    pose = s.pose if s.time > 0 else WALK
    blit(image, pixels, places[RUNNER_PLACE + 3 * s.runner_look + pose], rect, s.faces_left)


@shared
def draw_walkers(s, pixels, places, seen, image):
    """Draw the visible walkers, which face left at first, wherever they go."""
    far = SEEN + F(1)
    for k in range(s.walkers):
        x, y = s.walker_x[k], s.walker_y[k]
        if abs(x - s.x) < far and abs(y - s.y) < far:
            rect = around(seen, x, y, HALF, HALF)
            place = WALKER_PLACE + 2 * s.walker_look[k] + s.time // PERIOD % 2
            blit(image, pixels, places[place], rect, s.time > 0 and s.walker_vx[k] > 0)


LOOKS = original.looks(
    background, foreground, PICTURES, backgrounds=BACKGROUNDS, scene_shape=lambda *_: (1, 1, 3)
)
