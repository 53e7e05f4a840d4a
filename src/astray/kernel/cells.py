"""Cells and background drawn together, to the pixel as if Qt drew one cell after another.

Terms are those of `kernel.qt`.
"""

from typing import Any

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

from astray.kernel.canvas import copy_flat
from astray.kernel.jit import kernel, shared
from astray.kernel.qt import ONE, SPRITE, ZERO, F, blend, rectangle, span

OVERLAP = F(0.02)  # cells that a cell's picture goes beyond it on each side
TILE = 128  # pixels a side of the pictures that fill a cell
OPEN = -1  # no picture fills the cell

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
    """Draw the background and the visible cells, with the same overlaps as if one by one.

    The order is that of columns, each from the lowest cell up.

    Args:
        cells: [rows, columns] int64, lowest row first: the number of the opaque picture that fills
            the cell, TILE pixels a side; or OPEN; or -2 - k, the background through picture k.
        seen: Result of `camera`.
        left, low: Column and row of cells[0, 0] in the world.
        world: Side of the world in cells, which the background covers.
        background: Number of its picture, and the fraction of its extra width that lies to the
            left of the world.
    """
    side, (rows, columns) = image.shape[0], cells.shape
    # All arrays are parts of one, as each would take as long as a few rows of the image; zeros, so
    # that a pixel that no cell covers is a wrong pixel and no wrong address.
    memory = np.zeros(12 * side + rows * columns + 6 * (rows + columns) + 3, np.int64)
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
    """Return an array [rows, columns] from the beginning of another, and the rest of that."""
    return memory[: rows * columns].reshape((rows, columns)), memory[rows * columns :]


@kernel
def cell_box(seen, x, y):
    """Return the pixels of a cell's picture, which overlaps its neighbours'."""
    return rectangle(seen, F(x), F(y + 1), ONE, ONE, OVERLAP)


@kernel
def lay(axis, edges, k, begin, length):
    """Write the pixels of cell `k`, which is drawn over all earlier cells."""
    first, after, base, step = span(begin, length, axis.shape[1], TILE, SPRITE)
    edges[0, k], edges[1, k] = first, after
    for pixel in range(first, after):
        axis[LAST, pixel], axis[OF_LAST, pixel] = k, (base + (pixel - first) * step) >> 16
        if axis[FIRST, pixel] < 0:
            axis[FIRST, pixel], axis[OF_FIRST, pixel] = k, axis[OF_LAST, pixel]


@kernel
def lay_background(across, down, place, seen, world, offset, rule):
    """Write the visible columns of the background, and where its visible rows begin.

    It is as high as the world, and wider by the aspect ratio of its picture.
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
    """Write the contents of rows of cells; return whether a picture shows the background.

    Args:
        begins: Filled with the index in the flat array of each cell's picture, or OPEN.
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
    """Fill the image from the tables, except for pictures that show the background."""
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
    """Write the parts of an image row with the background and with cells' pictures.

    Args:
        source: Filled with the offsets of pixels in the pictures' first rows.
        begins: Indices of the cells' pictures in the flat array, or OPEN.
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
    """Write the source of each pixel in a row where two rows of cells overlap."""
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
    """Copy pixels `begin` + `source` from `first` to `after`; compiled, also the next byte.

    Copying words takes a third of the time. At the end of the image there is no next byte.
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
    """Prefetch the memory that `copy` will read; `pixels` [K] and `source` [W] are as there."""


def put_word(row: np.ndarray, at: int, word: int) -> None:
    """Write four bytes to `row` [3 W], of which the last will be overwritten."""
    for k in range(4):
        row[at + k] = word >> (8 * k) & 255


# Not strict, as its compiled form would need the same annotations.
@overload(put_word, strict=False)
def _put_word(row: Any, at: Any, word: Any) -> Any:
    return lambda row, at, word: _store_word(row, at, word)  # pyrefly: ignore


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
            _fetch_line(pixels, at)  # pyrefly: ignore
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
    """Draw a picture in cell [j, k], beneath full pictures that are drawn later."""
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
