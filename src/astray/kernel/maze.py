"""Mazes as the original makes them: Kruskal's algorithm on a shuffled list of passages."""

import numpy as np

from astray.kernel.jit import kernel
from astray.kernel.rng import below


@kernel
def carve(s, size, is_open, free_x, free_y):
    """Carve a spanning tree into `is_open` and return its number of free cells.

    s        whose twister is drawn from, once per passage
    size     cells a side, odd; nodes are the cells with two even coordinates
    is_open  [size, size] bool, indexed [y, x], all False; filled here
    free_x, free_y  [size * size], the free cells in the order they are opened; filled here
    """
    # A passage is x * size + y. First those that join nodes to the left and right of them.
    passages = np.empty(size * size, np.int16)  # small: the list is moved a lot
    count = 0
    for x in range(1, size, 2):
        for y in range(0, size, 2):
            passages[count] = x * size + y
            count += 1
    for x in range(0, size, 2):
        for y in range(1, size, 2):
            passages[count] = x * size + y
            count += 1
    parent = np.arange(size * size)
    free = 0
    while count > 0:
        pick = below(s, count)
        passage = int(passages[pick])
        x, y = passage // size, passage % size
        count -= 1
        for k in range(pick, count):
            passages[k] = passages[k + 1]  # the order of the rest matters to later draws
        dx = x % 2
        dy = 1 - dx
        one = root(parent, (x - dx) * size + y - dy)
        two = root(parent, (x + dx) * size + y + dy)
        if one != two:
            parent[one] = two
            for k in range(-1, 2):
                i, j = x + k * dx, y + k * dy
                if not is_open[j, i]:
                    is_open[j, i] = True
                    free_x[free], free_y[free] = i, j
                    free += 1
    return free


@kernel
def root(parent, node):
    """The representative of `node`'s tree; halves the path on the way."""
    while parent[node] != node:
        parent[node] = parent[parent[node]]
        node = parent[node]
    return node
