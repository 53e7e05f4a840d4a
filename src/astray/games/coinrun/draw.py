"""CoinRun as pictures, for the agent and at any larger scale, and as symbolic planes."""

import functools
import itertools
from pathlib import Path

import numpy as np

from astray.art import own
from astray.game import OWN, Looks, Variant
from astray.games.coinrun import backdrops
from astray.games.coinrun.rules import (
    COIN,
    CORNER,
    CRATE,
    HALF,
    LAVA,
    PERMEABLE,
    PUFFS,
    SAW,
    TALL,
    TOP,
    WALL,
    WORLD,
    is_lava,
    is_supported,
    stops,
)
from astray.kernel.canvas import blit, copy_window, pixel
from astray.kernel.jit import kernel, shared

ART = Path(__file__).parent / "art"
GROUNDS = ("dirt", "grass", "planet", "sand", "snow", "stone")
RUNNERS = ("beige", "blue", "green", "pink", "yellow")
POSES = ("stand", "walk-0", "walk-1")
WALKERS, CRATES = 9, 4
VIEW = 13  # cells a side that are seen, with the runner in the middle
SPAN = 16  # cells of a row that are looked through for saws
assert VIEW + 2 <= SPAN
MARGIN = 7  # cells of wall around the world in the scene, so that every window is inside it
CELLS = WORLD + 2 * MARGIN
LARGEST = 128  # pixels a side of a picture; for larger ones no scene is kept, it would be huge
FINEST = 10.0  # pixels per cell of a backdrop; larger pictures blur it
EDGE = float(HALF * CORNER)  # cells from a walker to its ends; walls in their cells turn it
PERIOD = 5  # steps from one picture of a walker to the next
RUNNER_HEIGHT = 88 / 64  # of its pictures, in cells, from its feet up
PUFF_DOWN, PUFF_RISE, PUFF_GROWTH = 0.25, 0.01, 1.05  # cells, cells per step, per step
PUFF_WIDTH, PUFF_HEIGHT, PUFF_OPACITY, PUFF_FADE = 0.6, 0.4, 0.5, 0.8  # cells; per step

OPEN = 255  # a cell that the sky is seen in

# The symbolic planes. What does not move comes first.
WALL_PLANE, HAZARD_PLANE, CRATE_PLANE, COIN_PLANE, STILL_PLANES = 0, 1, 2, 3, 4
LEFT_PLANE, RIGHT_PLANE, GAUGE_PLANE, PLANES = 4, 5, 6, 7
AROUND = VIEW // 2  # cells seen on each side of the runner's
GAUGE = 2 * VIEW  # marks of a gauge, over two rows


@shared
def background(s, art, scene):
    """Draw the level and its margin without moving things, if the scene is kept."""
    if scene.shape[0] > 1:
        part = up_to_wall(s, scene)
        paint_part(s, art, part, np.int64(0), np.int64(0), scene.shape[0] / CELLS)


@kernel
def up_to_wall(s, scene):
    """Return the scene up to the end wall and what is visible beyond.

    Most levels end before half of the world. Shorter rows are closer in memory, so windows of them
    are read faster.
    """
    height = scene.shape[0]
    cells = WORLD if s.permeable else s.end_x + 1
    width = min(pixel(cells + 2 * MARGIN, height / CELLS), scene.shape[1])
    return scene.reshape(-1)[: height * width * 3].reshape((height, width, 3))


@shared
def paint_part(s, art, target, top, left, scale):
    """Draw the part of the world whose upper left pixel in the scene is (top, left)."""
    backgrounds, strips, lavas, crates, _, coin, _, _, _ = art
    first_x, first_y = int(left / scale) - MARGIN, CELLS - MARGIN - int(top / scale) - 1
    after_x = min(first_x + int(target.shape[1] / scale) + 2, CELLS - MARGIN)
    after_y = max(first_y - int(target.shape[0] / scale) - 2, -MARGIN - 1)
    for y in range(first_y, after_y, -1):
        row = pixel(CELLS - MARGIN - y - 1, scale) - top
        beneath = pixel(CELLS - MARGIN - y, scale) - top
        x = first_x
        while x < after_x:
            kind, begin = opaque(s, x, y), x
            while x < after_x and opaque(s, x, y) == kind:
                x += 1
            column = max(pixel(begin + MARGIN, scale) - left, 0)
            beside = min(pixel(x + MARGIN, scale) - left, target.shape[1])
            if kind == OPEN:
                sky = backgrounds[s.background]
                lay_sky(s, target, sky, row, beneath, column, beside, top, left, scale)
            else:
                ground = 0 if kind == PERMEABLE else s.ground  # whatever the level's
                strip = strips[ground, 1 if kind == TOP else 0]
                lay(target, strip, row, beneath, column, beside, left)
    for y in range(max(after_y + 1, 0), min(first_y + 1, WORLD)):
        for x in range(max(first_x, 0), min(after_x, WORLD)):
            cell, crate = s.cell[y, x], s.thing[y, x] == CRATE
            if crate or cell == COIN or is_lava(cell):
                row = pixel(CELLS - MARGIN - y - 1, scale) - top
                column = pixel(x + MARGIN, scale) - left
                if crate:
                    put(target, crates[s.detail[y, x] % CRATES], row, column)
                elif cell == COIN:
                    put(target, coin, row, column)
                else:
                    put(target, lavas[0 if cell == LAVA else 1], row, column)


@kernel
def opaque(s, x, y):
    """Return what hides the sky in cell (x, y): WALL (also outside), TOP, PERMEABLE or OPEN."""
    if not (0 <= x < WORLD and 0 <= y < WORLD):
        return WALL
    cell = s.cell[y, x]
    return cell if stops(cell) or cell == PERMEABLE else OPEN


@shared
def lay(target, strip, top, bottom, left, right, shift):
    """Fill the visible part of rows top..bottom, columns left..right with a strip.

    `shift` is the strip's column at the target's left edge.
    """
    height, width = target.shape[:2]
    flat, n = target.reshape(-1), (right - left) * 3
    for row in range(max(top, 0), min(bottom, height)):
        begin = (row * width + left) * 3
        to, of = flat[begin : begin + n], strip[row - top, left + shift : right + shift].reshape(-1)
        for k in range(n):
            to[k] = of[k]


@shared
def put(target, sprite, top, left):
    """Call `blit`, in a version that is compiled once."""
    blit(target, sprite, top, left)


@shared
def lay_sky(s, target, picture, first, after, left, right, top, shift, scale):
    """Fill rows first..after with the backdrop above the world's floor; its top row repeats above.

    The target's upper left pixel is (`top`, `shift`) in the scene.
    """
    height, width = picture.shape[:2]
    fine = width / backdrops.WIDE / scale  # the backdrop's pixels per pixel
    floor = pixel(CELLS - MARGIN, scale) - top
    offset = s.background_offset * width
    for row in range(max(first, 0), min(after, target.shape[0])):
        if scale <= FINEST:  # pixel by pixel
            v = min(max(height - floor + row, 0), height - 1)
            part, begin = target[row, left:right].reshape(-1), int(offset) + shift + left
            copy_round(part, picture[v].reshape(-1), begin * 3)
        else:
            v = min(max(height - (floor - row - 0.5) * fine - 0.5, 0.0), height - 1.0)
            one, two = picture[int(v)], picture[min(int(v) + 1, height - 1)]
            blend(target[row], left, right, one, two, v - int(v), fine, shift * fine + offset)


@kernel
def copy_round(target, source, begin):
    """Fill `target` from the periodic `source`, from item `begin` on."""
    done, begin = 0, begin % source.size
    while done < target.size:
        n = min(target.size - done, source.size - begin)
        to, of = target[done : done + n], source[begin : begin + n]
        for k in range(n):
            to[k] = of[k]
        done, begin = done + n, 0


@kernel
def blend(target, left, right, one, two, fraction, fine, begin):
    """Fill part of a row by interpolation between two periodic rows of a coarser picture."""
    down, width = int(fraction * 256), one.shape[0]
    for column in range(left, right):
        u = (column + 0.5) * fine + begin + width - 0.5
        a, b = int(u) % width, (int(u) + 1) % width
        right = int((u - int(u)) * 256)
        for c in range(3):
            over = int(one[a, c]) * (256 - right) + int(one[b, c]) * right
            under = int(two[a, c]) * (256 - right) + int(two[b, c]) * right
            target[column, c] = (over * (256 - down) + under * down) >> 16


@shared
def foreground(s, art, scene, image):
    """Draw the window around the runner: the scene, then moving things."""
    _, _, _, _, saws, _, runners, walkers, puffs = art
    scale = image.shape[0] / VIEW
    left = pixel(s.x + MARGIN - VIEW / 2, scale)
    top = pixel(CELLS - MARGIN - s.y - VIEW / 2, scale)
    part = up_to_wall(s, scene)
    if left + image.shape[1] <= part.shape[1]:
        copy_window(image, part, top, left)
    else:  # no scene is kept, or the runner is beyond the end without passing a permeable wall
        paint_part(s, art, image, top, left, scale)
    draw_saws(s, saws, scale, top, left, image)
    runner = runners[s.runner_look, s.pose, int(s.faces_left)]
    stamp(image, runner, scale, top, left, s.x, s.y - TALL + RUNNER_HEIGHT / 2)
    draw_walkers(s, walkers, puffs, scale, top, left, image)


@kernel
def stamp(image, sprite, scale, top, left, x, y):
    """Blit `sprite` centred at (x, y) of the world."""
    high, wide = sprite.shape[0] / (2 * scale), sprite.shape[1] / (2 * scale)
    row, column = pixel(CELLS - MARGIN - y - high, scale), pixel(x + MARGIN - wide, scale)
    put(image, sprite, row - top, column - left)


@shared
def draw_saws(s, saws, scale, top, left, image):
    """Draw the visible saws, which turn with every step."""
    around = VIEW // 2 + 1
    first, j = min(max(int(s.x) - around, 0), WORLD - SPAN), int(s.y)
    for y in range(max(j - around, 0), min(j + around + 1, WORLD)):
        many = 0
        for k in range(SPAN):  # the compiler knows how many, and compares all at once
            many += s.thing[y, first + k] == SAW
        for x in range(first, first + SPAN if many else first):
            if s.thing[y, x] == SAW:
                row, column = pixel(CELLS - MARGIN - y - 1, scale), pixel(x + MARGIN, scale)
                put(image, saws[s.time % 2], row - top, column - left)


@shared
def draw_walkers(s, walkers, puffs, scale, top, left, image):
    """Draw the visible walkers on their trails."""
    far = VIEW / 2 + 1
    for k in range(s.walkers):
        x, y = s.walker_x[k], s.walker_y[k]
        if abs(x - s.x) < far + 2 and abs(y - s.y) < far:
            for age in range(min(s.time, PUFFS) - 1, -1, -1):
                rise = y - PUFF_DOWN + PUFF_RISE * age
                stamp(image, puffs[age], scale, top, left, s.trail_x[k, age], rise)
            facing = 1 if s.walker_vx[k] > 0 else 0
            sprite = walkers[s.walker_look[k], s.time // PERIOD % 2, facing]
            stamp(image, sprite, scale, top, left, x, y)


@shared
def background_planes(s, scene):
    """Write walls, hazards, crates and coins of the whole world, and its margin."""
    scene[:] = 0
    for y in range(WORLD + 2 * AROUND):
        for x in range(WORLD + 2 * AROUND):
            i, j = x - AROUND, y - AROUND
            if not (0 <= i < WORLD and 0 <= j < WORLD):
                scene[WALL_PLANE, y, x] = 1
                continue
            cell, thing = s.cell[j, i], s.thing[j, i]
            scene[WALL_PLANE, y, x] = stops(cell) or cell == PERMEABLE
            scene[HAZARD_PLANE, y, x] = is_lava(cell) or thing == SAW
            scene[CRATE_PLANE, y, x] = thing == CRATE
            scene[COIN_PLANE, y, x] = cell == COIN


@shared
def foreground_planes(s, scene, planes):
    """Write the cells around the runner, with walkers, and gauges of the runner's motion."""
    x, y = int(s.x), int(s.y)
    for plane in range(STILL_PLANES):
        for row in range(VIEW):
            for column in range(VIEW):
                planes[plane, row, column] = scene[plane, y + row, x + column]
    for plane in range(STILL_PLANES, PLANES):
        for row in range(VIEW):
            for column in range(VIEW):
                planes[plane, row, column] = 0
    for k in range(s.walkers):
        row = int(s.walker_y[k]) - y + AROUND
        plane = LEFT_PLANE if s.walker_vx[k] < 0 else RIGHT_PLANE
        for side in range(2):  # the two cells that it is in
            column = int(np.floor(s.walker_x[k] - EDGE + 2 * EDGE * side)) - x + AROUND
            if 0 <= row < VIEW and 0 <= column < VIEW:
                planes[plane, row, column] = 1
    gauge(planes, 0, s.x - x)
    gauge(planes, 2, s.y - y)
    gauge(planes, 4, s.vx + 0.5)
    gauge(planes, 6, (s.vy + 1.5) / 3)
    if is_supported(s):
        for column in range(VIEW):
            planes[GAUGE_PLANE, 8, column] = 1


@kernel
def gauge(planes, row, fraction):
    """Fill two rows up to `fraction`, 0 to 1, of their length."""
    marks = int(fraction * GAUGE + 0.5)
    for k in range(min(max(marks, 0), GAUGE)):
        planes[GAUGE_PLANE, row + k // VIEW, k % VIEW] = 1


def planes(variant: Variant) -> np.ndarray:
    """Return the largest value of each symbolic plane, [C, H, W] uint8: all are flags."""
    return np.ones((PLANES, VIEW, VIEW), np.uint8)


def planes_scene_shape(variant: Variant) -> tuple[int, ...]:
    return (STILL_PLANES, WORLD + 2 * AROUND, WORLD + 2 * AROUND)


def scene_shape(variant: Variant, pixels: int) -> tuple[int, ...]:
    side = round(CELLS * pixels / VIEW) if pixels <= LARGEST else 1
    return (side, side, 3)


def art(variant: Variant, pixels: int) -> tuple[np.ndarray, ...]:
    """Return the pictures; S is a cell's side in pixels, rounded up.

    They are backgrounds [62, h, w, 3], strips of ground (within, top) as wide as the scene [6, 2,
    S, w, 3], lava (within, top) [2, S, S, 4], crates [4, S, S, 4], saws [2, S, S, 4], a coin [S,
    S, 4], runners (pose, facing) [5, 3, 2, h, S, 4], walkers (picture, facing) [9, 2, 2, S, S, 4],
    puffs by age [9, h, w, 4].
    """
    return _art(pixels / VIEW)


@functools.cache
def _art(scale: float) -> tuple[np.ndarray, ...]:
    side = int(np.ceil(scale))

    def load(name: str, height: int = side, width: int = side) -> np.ndarray:
        return own.resize(own.load(ART, name), height, width)

    def facing(picture: np.ndarray) -> list[np.ndarray]:
        return [picture, picture[:, ::-1]]

    grounds = [[load(f"ground-{g}{part}")[..., :3] for part in ("", "-top")] for g in GROUNDS]
    tall = max(1, round(RUNNER_HEIGHT * scale))
    runners = [[facing(load(f"runner-{r}-{p}", tall)) for p in POSES] for r in RUNNERS]
    walkers = [[facing(load(f"walker-{k}-{f}")) for f in range(2)] for k in range(WALKERS)]
    # All contiguous, or compiled code would be compiled anew for another layout.
    return tuple(
        map(
            np.ascontiguousarray,
            (
                backdrops.render(min(scale, FINEST)),
                _strips(grounds, scale),
                [load("lava"), load("lava-top")],
                [load(f"crate-{k}") for k in range(CRATES)],
                [load("saw-0"), load("saw-1")],
                load("coin"),
                runners,
                walkers,
                _puffs(scale),
            ),
        )
    )


def _strips(grounds: list[list[np.ndarray]], scale: float) -> np.ndarray:
    """Return the pictures of ground cells, side by side as in the scene."""
    edges = np.floor(np.arange(CELLS + 1) * scale + 0.5).astype(int)
    columns = np.concatenate([np.arange(b - a) for a, b in itertools.pairwise(edges)])
    return np.array(grounds)[:, :, :, columns]


def _puffs(scale: float) -> np.ndarray:
    """Return the puffs of a trail, youngest first, centred in pictures as large as the last."""
    white = own.load(ART, "puff")
    sizes = [
        [max(1, round(cells * PUFF_GROWTH**age * scale)) for cells in (PUFF_HEIGHT, PUFF_WIDTH)]
        for age in range(PUFFS)
    ]
    high, wide = sizes[-1]
    puffs = np.zeros((PUFFS, high, wide, 4), np.uint8)
    for age, (height, width) in enumerate(sizes):
        puff = own.resize(white, height, width)
        puff[..., 3] = puff[..., 3] * (PUFF_OPACITY * PUFF_FADE**age)
        row, column = (high - height) // 2, (wide - width) // 2
        puffs[age, row : row + height, column : column + width] = puff
    return puffs


LOOKS = {OWN: Looks(OWN, background, foreground, art, scene_shape)}
