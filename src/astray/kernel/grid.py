"""Distances on a grid."""

import numpy as np

from astray.kernel.jit import entry

UNREACHABLE = -1


@entry
def distances(is_open, x, y):
    """Steps from every cell to (x, y) by moves to the four neighbours, UNREACHABLE where none.

    is_open  [H, W] bool, indexed [y, x]
    returns  [H, W] int64

    IndexError where (x, y) is outside of the grid.
    """
    height, width = is_open.shape
    if not (0 <= x < width and 0 <= y < height):
        raise IndexError("the cell is outside of the grid")
    steps = np.full((height, width), UNREACHABLE, np.int64)
    queue = np.empty(height * width, np.int64)
    steps[y, x], queue[0] = 0, y * width + x
    first, after = 0, 1
    while first < after:
        j, i = queue[first] // width, queue[first] % width
        first += 1
        for k in range(4):
            v, u = j + (k == 0) - (k == 1), i + (k == 2) - (k == 3)
            inside = 0 <= v < height and 0 <= u < width
            if inside and is_open[v, u] and steps[v, u] == UNREACHABLE:
                steps[v, u] = steps[j, i] + 1
                queue[after] = v * width + u
                after += 1
    return steps
