"""Copies of pictures to the pixel as Qt makes them, by which the original draws.

A picture is part of a flat array of uint32 `pixels`: red in the lowest byte, then green, blue and
opacity, colours multiplied by it. Its `place` is where it begins, its height and its width. The
target is an image [side, side, 3] uint8.

All copies are to the nearest pixel, in 16.16 fixed point; rectangles are left, top, width and
height in pixels, in doubles made from float32.
"""

import math
from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

from astray.kernel.canvas import copy_flat
from astray.kernel.jit import kernel, shared

F = np.float32
ZERO, ONE, TWO = F(0), F(1), F(2)
OVERLAP = F(0.02)  # cells that a cell's picture goes beyond it on each side
TILE = 128  # pixels a side of the pictures that fill a cell
OPEN = -1  # no picture fills the cell

# Qt finds the first pixel of a picture to show by one of two formulas, which differ by less than
# 1/65536 of a pixel for every pixel to the picture's edge. Sprites come by the first; backgrounds
# and what is partly transparent as a whole by the second, since Qt 5.13.
SPRITE, GENERIC = 0, 1

# Of k eighths of a turn, -4 to 4 (at [k + 4]); positive ones are clockwise on the screen.
ROOT = math.sqrt(0.5)  # 0.7071067811865476; the sine of 45 degrees is the double below it
SINE_45 = 0.7071067811865475
COS = np.array([-1, -SINE_45, 0, ROOT, 1, ROOT, 0, -SINE_45, -1])
SIN = np.array([0, -ROOT, -1, -SINE_45, 0, SINE_45, 1, ROOT, 0])

LOW_BYTES, HALVES = 0x00FF_00FF_00FF, 0x0080_0080_0080  # of three channels, 16 bits each


@kernel
def nearest(length):
    """The pixel edge nearest to a length in pixels."""
    return int(np.floor(length + 0.5))


@kernel
def camera(side, cells, x, y):
    """How to get from cells to pixels where `cells` a side are seen around (x, y).

    Pixels a cell, cells a side as float32 has them, and how far the world is moved to the left
    and down, in pixels.
    """
    unit = F(side) / F(cells)
    view = F(side / np.float64(unit))
    return unit, view, unit * (x - view / TWO), unit * (y - view / TWO)


@kernel
def rectangle(seen, left, top, wide, high, margin):
    """The pixels of a box whose left and top edges are at `left` and `top`, in cells.

    seen    what `camera` says
    margin  cells that it is larger by on each side
    """
    unit, view, off_x, off_y = seen
    return (
        np.float64((left - margin) * unit - off_x),
        np.float64(((view - top) - margin) * unit + off_y),
        np.float64((wide + TWO * margin) * unit),
        np.float64((high + TWO * margin) * unit),
    )


@kernel
def around(seen, x, y, half_x, half_y):
    """The pixels of a box centred at (x, y); sizes are halves, in cells."""
    return rectangle(seen, x - half_x, y + half_y, TWO * half_x, TWO * half_y, ZERO)


@kernel
def span(begin, length, side, size, rule):
    """Where a picture is shown: its first pixel of `side`, the one after its last, base and step.

    Pixel k shows number (base + (k - first) * step) >> 16 of the picture's `size`.
    """
    first = min(max(nearest(begin), 0), side)
    after = max(min(nearest(begin + length), side), first)
    scale = size / length
    step = int(65536 * scale)
    if rule == SPRITE:
        base = int(np.ceil((first + 0.5 - begin) * step)) - 1
    else:
        base = int(np.ceil(((first + 0.5 - begin) * scale) * 65536)) - 1
    if after > first and (base + (after - 1 - first) * step) >> 16 >= size:
        after -= 1
    return first, after, base, step


@kernel
def blend(image, row, column, over):
    """Lay the pixel `over` on a pixel of the image."""
    rest = 255 - (over >> 24)
    if rest == 0:
        image[row, column, 0] = over & 255
        image[row, column, 1] = over >> 8 & 255
        image[row, column, 2] = over >> 16 & 255
    elif rest < 255:
        under = np.int64(image[row, column, 0])
        under |= np.int64(image[row, column, 1]) << 16 | np.int64(image[row, column, 2]) << 32
        mixed = under * rest
        mixed = (mixed + (mixed >> 8 & LOW_BYTES) + HALVES) >> 8 & LOW_BYTES
        image[row, column, 0] = (over & 255) + (mixed & 255)
        image[row, column, 1] = (over >> 8 & 255) + (mixed >> 16 & 255)
        image[row, column, 2] = (over >> 16 & 255) + (mixed >> 32)


@shared
def blit(image, pixels, place, rect, mirrored):
    """Draw a picture, or its mirror image, into a rectangle."""
    begin, height, width = place[0], place[1], place[2]
    left, top, wide, high = rect
    side = image.shape[0]
    first_x, after_x, base_x, step_x = span(left, wide, side, width, SPRITE)
    first_y, after_y, base_y, step_y = span(top, high, side, height, SPRITE)
    for row in range(first_y, after_y):
        line = begin + ((base_y + (row - first_y) * step_y) >> 16) * width
        for column in range(first_x, after_x):
            u = (base_x + (column - first_x) * step_x) >> 16
            if mirrored:
                u = width - 1 - u
            blend(image, row, column, np.int64(pixels[line + u]))


@kernel
def faded(over, opacity):
    """A pixel with `opacity` of 255 left."""
    channels = (over & 255) | (over >> 8 & 255) << 16 | (over >> 16 & 255) << 32
    channels *= opacity
    channels = (channels + (channels >> 8 & LOW_BYTES) + HALVES) >> 8 & LOW_BYTES
    alpha = (over >> 24) * opacity
    alpha = (alpha + (alpha >> 8) + 128) >> 8
    return (channels & 255) | (channels >> 16 & 255) << 8 | channels >> 32 << 16 | alpha << 24


@shared
def blit_faded(image, pixels, place, rect, opacity, rule):
    """Draw a picture into a rectangle with `opacity` of 255."""
    begin, height, width = place[0], place[1], place[2]
    left, top, wide, high = rect
    side = image.shape[0]
    first_x, after_x, base_x, step_x = span(left, wide, side, width, rule)
    first_y, after_y, base_y, step_y = span(top, high, side, height, rule)
    for row in range(first_y, after_y):
        line = begin + ((base_y + (row - first_y) * step_y) >> 16) * width
        for column in range(first_x, after_x):
            over = np.int64(pixels[line + ((base_x + (column - first_x) * step_x) >> 16)])
            blend(image, row, column, faded(over, opacity))


@shared
def blit_turned(image, pixels, place, rect, eighths):
    """Draw a picture into a rectangle turned about its centre by -4 to 4 eighths of a turn."""
    if eighths == 0:
        blit(image, pixels, place, rect, False)
    elif abs(eighths) == 4:
        blit_upside_down(image, pixels, place, rect)
    else:
        blit_tilted(image, pixels, place, rect, eighths)


@kernel
def span_back(begin, length, side, size):
    """`span` of a picture shown from its end to its beginning, from `begin` + `length` on."""
    centre = begin + length / 2
    low, high = centre - length / 2, centre + length / 2
    scale = size / (low - high)
    step = int(65536 * scale)
    first, after = max(nearest(low), 0), min(nearest(low + (high - low)), side)
    base = 65536 * size + int(np.floor((first + 0.5 - low) * step)) + 1
    return first, after, base, step


@kernel
def blit_upside_down(image, pixels, place, rect):
    """Draw a picture turned by half a turn."""
    begin, height, width = place[0], place[1], place[2]
    left, top, wide, high = rect
    side = image.shape[0]
    first_x, after_x, base_x, step_x = span_back(left, wide, side, width)
    first_y, after_y, base_y, step_y = span_back(top, high, side, height)
    for row in range(first_y, after_y):
        v = (base_y + (row - first_y) * step_y) >> 16
        for column in range(first_x, after_x):
            u = (base_x + (column - first_x) * step_x) >> 16
            if 0 <= u < width and 0 <= v < height:
                blend(image, row, column, np.int64(pixels[begin + v * width + u]))


@shared
def blit_tilted(image, pixels, place, rect, eighths):
    """Draw a picture turned by an odd number of eighths, or by a quarter of a turn."""
    width, height = np.float64(place[2]), np.float64(place[1])
    left, top, wide, high = rect
    c, s = COS[eighths + 4], SIN[eighths + 4]
    x0, y0 = left + wide / 2, top + high / 2
    # Its corners on the screen, and in the picture, from the upper left one on, clockwise.
    corner = np.empty((4, 4))
    for k in range(4):
        p = -wide / 2 + wide if k == 1 or k == 2 else -wide / 2
        q = -high / 2 + high if k >= 2 else -high / 2
        corner[k, 0], corner[k, 1] = c * p - s * q + x0, s * p + c * q + y0
        corner[k, 2] = width if k == 1 or k == 2 else 0.0
        corner[k, 3] = height if k >= 2 else 0.0
    highest = 0
    for k in range(1, 4):
        if corner[k, 1] < corner[highest, 1]:
            highest = k
    v0, v1 = corner[highest], corner[(highest + 1) % 4]
    v2, v3 = corner[(highest + 2) % 4], corner[(highest + 3) % 4]
    if (v1[0] - v0[0]) * (v3[1] - v0[1]) - (v3[0] - v0[0]) * (v1[1] - v0[1]) > 0:
        v1, v3 = v3, v1
    # Places in the picture are linear in those on the screen.
    px, py, qx, qy = v1[0] - v0[0], v1[1] - v0[1], v2[0] - v0[0], v2[1] - v0[1]
    pu, pv, qu, qv = v1[2] - v0[2], v1[3] - v0[3], v2[2] - v0[2], v2[3] - v0[3]
    inverse = 1 / (px * qy - py * qx)
    a11, a12 = (pu * qy - py * qu) * inverse, (px * qu - pu * qx) * inverse
    a21, a22 = (pv * qy - py * qv) * inverse, (px * qv - pv * qx) * inverse
    eu, ev = v0[2] - a11 * v0[0] - a12 * v0[1], v0[3] - a21 * v0[0] - a22 * v0[1]
    u0 = int(np.ceil((a11 / 2 + a12 / 2 + eu) * 65536)) - 1
    v_0 = int(np.ceil((a21 / 2 + a22 / 2 + ev) * 65536)) - 1
    plane = (int(65536 * a11), int(65536 * a12), u0, int(65536 * a21), int(65536 * a22), v_0)
    if v1[1] < v3[1]:
        fill_band(image, pixels, place, plane, v0[1], v1[1], v0, v1, v0, v3)
        fill_band(image, pixels, place, plane, v1[1], v3[1], v1, v2, v0, v3)
        fill_band(image, pixels, place, plane, v3[1], v2[1], v1, v2, v3, v2)
    else:
        fill_band(image, pixels, place, plane, v0[1], v3[1], v0, v1, v0, v3)
        fill_band(image, pixels, place, plane, v3[1], v1[1], v0, v1, v3, v2)
        fill_band(image, pixels, place, plane, v1[1], v2[1], v1, v2, v3, v2)


@shared
def fill_band(image, pixels, place, plane, high, low, left_from, left_to, right_from, right_to):
    """Fill the rows between two heights, between two edges, with what `plane` says is there."""
    side = image.shape[0]
    begin, height, width = place[0], place[1], place[2]
    first, after = max(nearest(high), 0), min(nearest(low), side)
    if first >= after:
        return
    left, left_step = edge(first, left_from, left_to)
    right, right_step = edge(first, right_from, right_to)
    a11, a12, u0, a21, a22, v0 = plane
    for row in range(first, after):
        for column in range(max(left >> 16, 0), min(right >> 16, side)):
            u = min(max((column * a11 + row * a12 + u0) >> 16, 0), width - 1)
            v = min(max((column * a21 + row * a22 + v0) >> 16, 0), height - 1)
            blend(image, row, column, np.int64(pixels[begin + v * width + u]))
        left, right = left + left_step, right + right_step


@kernel
def edge(row, one, two):
    """Where the line between two corners meets `row`, and how far it goes a row, in 16.16."""
    slope = (two[0] - one[0]) / (two[1] - one[1])
    return int((one[0] + (0.5 + row - one[1]) * slope + 0.5) * 65536), int(65536 * slope)


# The cells and the background are laid together, row by row of the image: drawn one cell after the
# other, as the original does, they would take five times as long.

# Rows of a table of what the pixels along one axis of the image show: of the two cells that may
# cover one, as their pictures overlap, the one drawn last and what of its picture, and the other;
# where the first row or column of that is in the flat array.
LAST, OF_LAST, FIRST, OF_FIRST, SKY = range(5)
LINE = 16  # pixels of a line of the processor's cache
AHEAD = 4  # rows of an image for which the background is fetched before they are written


@shared
def paint_cells(image, pixels, places, cells, seen, left, low, world, background, rule):
    """Paint the background and the cells in view, as if cell by cell: by columns, each from below.

    cells       [rows, columns] int64, from the lowest up: the number of the picture that fills
                the cell, TILE pixels a side and opaque; OPEN; or -2 - k: the background is seen
                through picture k
    seen        what `camera` says
    left, low   the column and row of the world that cells[0, 0] is
    world       cells a side of the world, which the background covers
    background  the number of its picture, and how far it is moved to the left, of all by which it
                is wider than the world
    """
    side, (rows, columns) = image.shape[0], cells.shape
    # All arrays are parts of one, as each would take as long as a few rows of the image.
    memory = np.empty(12 * side + rows * columns + 6 * (rows + columns) + 3, np.int64)
    across, memory = part(memory, 5, side)
    down, memory = part(memory, 5, side)
    edges, memory = part(memory, 4, max(rows, columns))
    across[FIRST], down[FIRST] = -1, -1
    for k in range(columns):
        begin, _, length, _ = cell_box(seen, left + k, low)
        lay(across, edges[:2], k, begin, length)
    for k in range(rows):
        _, begin, _, length = cell_box(seen, left, low + k)
        lay(down, edges[2:], k, begin, length)
    lay_background(across, down, places[background[0]], seen, F(world), F(background[1]), rule)
    begins, memory = part(memory, rows, columns)
    kinds, memory = part(memory, 2, rows)
    through = sort_rows(begins, kinds, places, cells)
    fill_rows(image, pixels, begins, kinds, across, down, edges, memory)
    for k in range(columns if through else 0):
        for j in range(rows):
            if cells[j, k] < OPEN:
                rect = cell_box(seen, left + k, low + j)
                blit_cell(image, pixels, places[-2 - cells[j, k]], rect, cells, edges, j, k)


@kernel
def part(memory, rows, columns):
    """An array [rows, columns] from the beginning of another, and what is left of that."""
    return memory[: rows * columns].reshape((rows, columns)), memory[rows * columns :]


@kernel
def cell_box(seen, x, y):
    """The pixels of a cell's picture, which overlaps its neighbours'."""
    return rectangle(seen, F(x), F(y + 1), ONE, ONE, OVERLAP)


@kernel
def lay(axis, edges, k, begin, length):
    """Write what pixels show of cell `k`, which is drawn after those laid before."""
    first, after, base, step = span(begin, length, axis.shape[1], TILE, SPRITE)
    edges[0, k], edges[1, k] = first, after
    for pixel in range(first, after):
        axis[LAST, pixel], axis[OF_LAST, pixel] = k, (base + (pixel - first) * step) >> 16
        if axis[FIRST, pixel] < 0:
            axis[FIRST, pixel], axis[OF_FIRST, pixel] = k, axis[OF_LAST, pixel]


@kernel
def lay_background(across, down, place, seen, world, offset, rule):
    """Write which columns of the background pixels show, and where the rows that they show begin.

    It is as high as the world, and as much wider as its picture is.
    """
    left, top, wide, high = rectangle(seen, ZERO, world, world, world, ZERO)
    begin, height, width, side = place[0], place[1], place[2], across.shape[1]
    aspect = F(width / height)
    left, wide = left - wide * np.float64(offset * (aspect - ONE)), wide * np.float64(aspect)
    across[SKY], down[SKY] = 0, begin  # where walls hide what is beyond its edges
    first, after, base, step = span(left, wide, side, width, rule)
    for pixel in range(first, after):
        across[SKY, pixel] = (base + (pixel - first) * step) >> 16
    first, after, base, step = span(top, high, side, height, rule)
    for pixel in range(first, after):
        down[SKY, pixel] = begin + ((base + (pixel - first) * step) >> 16) * width


# Rows of `kinds`: the first of the rows of cells that are alike up to this one; whether the
# background is seen in it.
ALIKE, IS_OPEN = range(2)


@kernel
def sort_rows(begins, kinds, places, cells):
    """Write what rows of cells hold; whether the background is seen through a picture in any.

    begins  filled with where in the flat array the picture that fills the cell begins, or OPEN
    """
    through = False
    for j in range(cells.shape[0]):
        same, is_open = j > 0, False
        for k in range(cells.shape[1]):
            cell = cells[j, k]
            begins[j, k] = places[cell, 0] if cell > OPEN else OPEN
            same = same and begins[j, k] == begins[j - 1, k]
            is_open = is_open or cell <= OPEN
            through = through or cell < OPEN
        kinds[ALIKE, j], kinds[IS_OPEN, j] = kinds[ALIKE, j - 1] if same else j, is_open
    return through


@shared
def fill_rows(image, pixels, begins, kinds, across, down, edges, memory):
    """Fill the image with what the tables say, but for pictures that the background is seen by."""
    side, flat, known = image.shape[0], image.reshape(-1), -1
    tables, stretches = part(memory, 2, side)
    sky, source = tables[0].view(np.uint64), tables[1].view(np.uint64)
    for x in range(side):
        sky[x] = across[SKY, x]
    # `stretches` are the first and last-but-one pixels of the background and of pictures, by turns.
    for y in range(side):
        one, two = kinds[ALIKE, down[FIRST, y]], kinds[ALIKE, down[LAST, y]]
        row = flat[y * side * 3 : (y + 1) * side * 3 + (y + 1 < side)]
        behind, tile = np.uint64(down[SKY, y]), np.uint64(down[OF_LAST, y] * TILE)
        if y + AHEAD < side and kinds[IS_OPEN, down[LAST, y + AHEAD]]:
            fetch(pixels, np.uint64(down[SKY, y + AHEAD]), sky)
        if one != two:
            known = -1
            look_up(source, begins, across, down[:, y], edges)
            copy(row, pixels, np.uint64(0), source, 0, side)
            continue
        if one != known:
            known = one
            find_stretches(stretches, source, begins[known], across, edges)
        elif stretches[1] == side and down[SKY, y] == down[SKY, y - 1]:
            copy_flat(row[: side * 3], flat[(y - 1) * side * 3 : y * side * 3])
            continue
        k, after = 0, 0
        while after < side:
            begin, after = stretches[k], stretches[k + 1]
            if k % 2 == 0:
                copy(row, pixels, behind, sky, begin, after)
            else:
                copy(row, pixels, tile, source, begin, after)
            k += 1


@kernel
def find_stretches(stretches, source, begins, across, edges):
    """Write where in an image's row the background is seen and where pictures that fill cells.

    source  filled with where the first rows of these pictures have what pixels show
    begins  of the cells' pictures in the flat array, or OPEN
    """
    side, columns = source.size, begins.size
    for x in range(side):
        source[x] = begins[across[LAST, x]] + across[OF_LAST, x]
    count, filled, stretches[0] = 0, False, 0
    for k in range(columns):
        if begins[k] > OPEN and not filled:
            filled = True
            count += 1
            stretches[count] = edges[0, k]
        elif begins[k] <= OPEN and filled:
            filled = False
            count += 1
            stretches[count] = edges[1, k - 1]
            for x in range(edges[0, k], edges[1, k - 1]):  # drawn by the cell before alone
                source[x] = begins[k - 1] + across[OF_FIRST, x]
    stretches[count + 1], stretches[count + 2] = side, side


@kernel
def look_up(source, begins, across, down, edges):
    """Write where in the flat array each pixel of a row is from where two rows of cells overlap."""
    for x in range(source.size):
        source[x] = down[SKY] + across[SKY, x]
    for k in range(begins.shape[1]):
        for turn in range(2):
            line = down[FIRST] if turn == 0 else down[LAST]
            v = down[OF_FIRST] if turn == 0 else down[OF_LAST]
            if begins[line, k] > OPEN:
                begin = begins[line, k] + v * TILE
                for x in range(edges[0, k], edges[1, k]):
                    of = across[OF_LAST, x] if across[LAST, x] == k else across[OF_FIRST, x]
                    source[x] = begin + of


@kernel
def copy(row, pixels, begin, source, first, after):
    """Write pixels `begin` + `source` from the first on; compiled, also the byte after each.

    A word at once takes a third of the time; of a row that ends the image there is no byte more.
    """
    whole = after if 3 * after < row.size else after - 1
    for x in range(first, whole):
        put_word(row, 3 * x, pixels[begin + source[x]])
    for x in range(max(whole, first), after):
        pixel = pixels[begin + source[x]]
        row[3 * x], row[3 * x + 1], row[3 * x + 2] = (
            pixel & 255,
            pixel >> 8 & 255,
            pixel >> 16 & 255,
        )


def fetch(pixels: np.ndarray, begin: Any, source: np.ndarray) -> None:
    """Have the processor read what `copy` will need; nothing else comes of it."""


def put_word(row: np.ndarray, at: int, word: int) -> None:
    """Write four bytes, of which the last is to be written over."""
    for k in range(4):
        row[at + k] = word >> (8 * k) & 255


# Not strict, as its compiled form would need the same annotations.
@overload(put_word, strict=False)
def _put_word(row: Any, at: Any, word: Any) -> Any:
    return lambda row, at, word: _store_word(row, at, word)  # pyright: ignore


@intrinsic
def _store_word(typing: Any, row: Any, at: Any, word: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], arguments[:2])
        pointer = builder.bitcast(pointer, ir.IntType(32).as_pointer())
        builder.store(arguments[2], pointer, align=1)
        return context.get_dummy_value()

    return types.void(row, types.intp, types.uint32), generate


@overload(fetch, strict=False)
def _fetch(pixels: Any, begin: Any, source: Any) -> Any:
    def fetch_lines(pixels, begin, source):
        at, last = begin + source[0], begin + source[-1]
        while at <= last:
            _fetch_line(pixels, at)  # pyright: ignore
            at += np.uint64(LINE)

    return fetch_lines


@intrinsic
def _fetch_line(typing: Any, pixels: Any, at: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], arguments[:2])
        integer = ir.IntType(32)
        kind = ir.FunctionType(ir.VoidType(), [pointer.type, *3 * [integer]])
        function = cgutils.get_or_insert_function(builder.module, kind, "llvm.prefetch.p0i8")
        builder.call(function, [pointer, integer(0), integer(3), integer(1)])  # to read, soon, data
        return context.get_dummy_value()

    return types.void(pixels, types.uint64), generate


def _pointer(context: Any, builder: Any, kind: Any, arguments: Any) -> Any:
    array = context.make_array(kind)(context, builder, arguments[0])
    pointer = cgutils.get_item_pointer(context, builder, kind, array, [arguments[1]])
    return builder.bitcast(pointer, ir.IntType(8).as_pointer())


@shared
def blit_cell(image, pixels, place, rect, cells, edges, j, k):
    """Draw a picture in cell [j, k], beneath the pictures that fill cells and are drawn later."""
    begin, height, width = place[0], place[1], place[2]
    left, top, wide, high = rect
    side, (rows, columns) = image.shape[0], cells.shape
    first_x, after_x, base_x, step_x = span(left, wide, side, width, SPRITE)
    first_y, after_y, base_y, step_y = span(top, high, side, height, SPRITE)
    for row in range(first_y, after_y):
        line = begin + ((base_y + (row - first_y) * step_y) >> 16) * width
        in_upper = j + 1 < rows and row < edges[3, j + 1]
        in_lower = j > 0 and row >= edges[2, j - 1]
        for column in range(first_x, after_x):
            in_right = k + 1 < columns and column >= edges[0, k + 1]
            hidden = in_upper and cells[j + 1, k] > OPEN
            if in_right:
                hidden = hidden or cells[j, k + 1] > OPEN
                hidden = hidden or (in_upper and cells[j + 1, k + 1] > OPEN)
                hidden = hidden or (in_lower and cells[j - 1, k + 1] > OPEN)
            if not hidden:
                u = (base_x + (column - first_x) * step_x) >> 16
                blend(image, row, column, np.int64(pixels[line + u]))
