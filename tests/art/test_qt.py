"""Copies of pictures, beside a slow version that draws one cell after the other."""

import numpy as np
import pytest

from astray.art import original
from astray.kernel import qt
from astray.kernel.cells import OPEN, TILE, cell_box, paint_cells


def naive_span(begin, length, side, size, rule):
    """Target pixels and the source pixel of each."""
    first, after = (int(np.floor(edge + 0.5)) for edge in (begin, begin + length))
    first, after = max(first, 0), min(after, side)
    scale = size / length
    step = int(65536 * scale)
    product = (first + 0.5 - begin) * (step if rule == qt.SPRITE else scale)
    base = int(np.ceil(product if rule == qt.SPRITE else product * 65536)) - 1
    pairs = [(k, (base + (k - first) * step) >> 16) for k in range(first, after)]
    return pairs[:-1] if pairs and pairs[-1][1] >= size else pairs


def naive_draw(image, source, rect, rule=qt.SPRITE):
    """Draw a premultiplied picture [H, W, 4] as exact arithmetic has it."""
    left, top, wide, high = rect
    for row, v in naive_span(top, high, len(image), len(source), rule):
        for column, u in naive_span(left, wide, len(image), len(source[0]), rule):
            over, under = source[v, u].astype(int), image[row, column].astype(int)
            product = under * (255 - over[3])
            image[row, column] = over[:3] + ((product + (product >> 8) + 128) >> 8)


def made_pictures(random, kinds):
    """Pictures of random pixels, as RGBA and as the arrays that compiled code takes."""
    pictures, flat, places = [], [np.zeros(5, np.uint32)], []
    for height, width, opaque in kinds:
        rgba = random.integers(0, 256, (height, width, 4)).astype(np.uint8)
        alpha = (
            np.full((height, width), 255)
            if opaque
            else random.choice([0, 90, 255], (height, width))
        )
        packed = original._packed(np.dstack([rgba[..., :3], alpha]).astype(np.uint32), False)
        pictures.append(packed[..., None] >> np.array([0, 8, 16, 24], np.uint32) & 255)
        places.append((sum(map(len, flat)), height, width))
        flat.append(packed.reshape(-1).astype(np.uint32))
    return pictures, np.concatenate(flat), np.array(places)


@pytest.mark.parametrize("seed", range(12))
def test_cells_painted_at_once_are_those_drawn_one_by_one(seed):
    random, side = np.random.default_rng(seed), int(np.random.default_rng(seed).choice([64, 50]))
    tile = (TILE, TILE, True)
    pictures, pixels, places = made_pictures(
        random, [(70, 90, True), tile, tile, (27, 31, False), (128, 128, False)]
    )
    world, visible = 20, int(random.choice([13, 8, 20]))
    x, y = (np.float32(v) for v in random.uniform(1, 19, 2))
    if visible == world:
        x = y = np.float32(world / 2)
    seen = qt.camera(side, visible, x, y)
    half = np.float32(visible) / np.float32(2) + np.float32(1)
    left, low = (int(v - half) if visible < world else 0 for v in (x, y))
    count = world if visible == world else int(x + half) - left + 1
    rows = world if visible == world else int(y + half) - low + 1
    choices = [OPEN] * 6 + [1, 1, 1, 2, 2, -2 - 3, -2 - 4]
    cells = np.full((rows, count), 1)
    for j in range(rows):
        for i in range(count):
            if 0 <= low + j < world and 0 <= left + i < world:
                cells[j, i] = random.choice(choices)
    offset = float(np.float32(random.random()))
    image, expected = np.zeros((side, side, 3), np.uint8), np.zeros((side, side, 3), np.uint8)
    paint_cells(image, pixels, places, cells, seen, left, low, world, (0, offset), qt.GENERIC)

    size = np.float32(world)
    begin, top, wide, high = qt.rectangle(seen, np.float32(0), size, size, size, np.float32(0))
    aspect = np.float32(90 / 70)
    shift = wide * float(np.float32(offset) * (aspect - np.float32(1)))
    naive_draw(expected, pictures[0], (begin - shift, top, wide * float(aspect), high), qt.GENERIC)
    for i in range(count):
        for j in range(rows):
            if cells[j, i] != OPEN:
                which = cells[j, i] if cells[j, i] > 0 else -2 - cells[j, i]
                naive_draw(expected, pictures[which], cell_box(seen, left + i, low + j))
    assert np.array_equal(image, expected)


@pytest.mark.parametrize("eighths, turns", [(-4, 2), (-2, 1), (0, 0), (2, 3)])
def test_quarter_turns_turn_pixels(eighths, turns):
    """A picture on as many pixels as it has; numpy turns against the clock."""
    random = np.random.default_rng(0)
    (source,), pixels, places = made_pictures(random, [(20, 20, True)])
    image = np.zeros((64, 64, 3), np.uint8)
    qt.blit_turned(image, pixels, places[0], (10.0, 30.0, 20.0, 20.0), eighths)
    assert np.array_equal(image[30:50, 10:30], np.rot90(source, turns)[..., :3])
    image[30:50, 10:30] = 0
    assert not image.any()


@pytest.mark.parametrize("eighths", [-3, -1, 1, 3])
def test_oblique_turns_cover_the_turned_square(eighths):
    (_,), pixels, places = made_pictures(np.random.default_rng(1), [(9, 9, True)])
    pixels[places[0, 0] :] = 0xFFFFFFFF
    image = np.zeros((64, 64, 3), np.uint8)
    qt.blit_turned(image, pixels, places[0], (22.0, 22.0, 20.0, 20.0), eighths)
    y, x = np.mgrid[:64, :64] + 0.5 - 32
    diamond = abs(x) + abs(y)
    assert (image[diamond < 13.2] == 255).all() and (image[diamond > 15] == 0).all()
