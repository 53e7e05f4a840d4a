"""Copies of pictures, to the pixel as made by Qt, which the original draws with.

A picture is part of a flat array of uint32 `pixels`: red in the lowest byte, then green, blue and
opacity, with premultiplied colours. Its `place` is its index, height and width. The target is an
image [side, side, 3] uint8.

All copies use the nearest pixel, in 16.16 fixed point. Rectangles are left, top, width and height
in pixels, as doubles made from float32.
"""

import math

import numpy as np

from astray.kernel.jit import kernel, shared

F = np.float32
ZERO, ONE, TWO = F(0), F(1), F(2)

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
    """Return the pixel edge nearest to a length in pixels."""
    return int(np.floor(length + 0.5))


@kernel
def camera(side, cells, x, y):
    """Return the map from cells to pixels for a view of `cells` a side around (x, y).

    It consists of pixels per cell, cells a side as float32, and the shift of the world to the left
    and down in pixels.
    """
    unit = F(side) / F(cells)
    view = F(side / np.float64(unit))
    return unit, view, unit * (x - view / TWO), unit * (y - view / TWO)


@kernel
def rectangle(seen, left, top, wide, high, margin):
    """Return the pixels of a box whose left and top edges are `left` and `top`, in cells.

    Args:
        seen: Result of `camera`.
        margin: Cells to enlarge it by on each side.
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
    """Return the pixels of a box centred at (x, y), with half sizes in cells."""
    return rectangle(seen, x - half_x, y + half_y, TWO * half_x, TWO * half_y, ZERO)


@kernel
def span(begin, length, side, size, rule):
    """Return the first pixel of a picture, the one after its last, and its base and step.

    There are `side` pixels, and `size` in the picture. Pixel k shows the picture's number
    (base + (k - first) * step) >> 16.
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
    """Blend the pixel `over` onto a pixel of the image."""
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


@kernel
def faded(over, opacity):
    """Return a pixel multiplied by `opacity` / 255."""
    channels = (over & 255) | (over >> 8 & 255) << 16 | (over >> 16 & 255) << 32
    channels *= opacity
    channels = (channels + (channels >> 8 & LOW_BYTES) + HALVES) >> 8 & LOW_BYTES
    alpha = (over >> 24) * opacity
    alpha = (alpha + (alpha >> 8) + 128) >> 8
    return (channels & 255) | (channels >> 16 & 255) << 8 | channels >> 32 << 16 | alpha << 24


@shared
def blit(image, pixels, place, rect, mirrored, opacity=255, rule=SPRITE):
    """Draw a picture or its mirror image into a rectangle with `opacity` / 255."""
    begin, height, width = place[0], place[1], place[2]
    left, top, wide, high = rect
    side = image.shape[0]
    first_x, after_x, base_x, step_x = span(left, wide, side, width, rule)
    first_y, after_y, base_y, step_y = span(top, high, side, height, rule)
    for row in range(first_y, after_y):
        line = begin + ((base_y + (row - first_y) * step_y) >> 16) * width
        for column in range(first_x, after_x):
            u = (base_x + (column - first_x) * step_x) >> 16
            if mirrored:
                u = width - 1 - u
            over = np.int64(pixels[line + u])
            blend(image, row, column, faded(over, opacity) if opacity < 255 else over)


@shared
def blit_turned(image, pixels, place, rect, eighths):
    """Draw a picture into a rectangle, rotated about its centre by -4 to 4 eighths of a turn."""
    if eighths == 0:
        blit(image, pixels, place, rect, False)
    elif abs(eighths) == 4:
        blit_upside_down(image, pixels, place, rect)
    else:
        blit_tilted(image, pixels, place, rect, eighths)


@kernel
def span_back(begin, length, side, size):
    """Return the `span` of a picture shown mirrored, which starts at `begin` + `length`."""
    centre = begin + length / 2
    low, high = centre - length / 2, centre + length / 2
    scale = size / (low - high)
    step = int(65536 * scale)
    first, after = max(nearest(low), 0), min(nearest(low + (high - low)), side)
    base = 65536 * size + int(np.floor((first + 0.5 - low) * step)) + 1
    return first, after, base, step


@kernel
def blit_upside_down(image, pixels, place, rect):
    """Draw a picture rotated by half a turn."""
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
    """Draw a picture rotated by an odd number of eighths, or by a quarter turn."""
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
    """Fill the rows between two heights and two edges from the picture in `plane`."""
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
    """Return where the line between two corners meets `row`, and its slope per row, in 16.16."""
    slope = (two[0] - one[0]) / (two[1] - one[1])
    return int((one[0] + (0.5 + row - one[1]) * slope + 0.5) * 65536), int(65536 * slope)
