"""Grid helpers for games: the original's actions, and distances."""

import numpy as np

from astray.kernel.jit import entry, kernel

UNREACHABLE = -1
# The original's 15 actions; those after "right-up" are keys that mean nothing here.
ACTIONS = (
    "left-down", "left", "left-up", "down", "stay", "up", "right-down", "right", "right-up",
    "d", "a", "w", "s", "q", "e",
)  # fmt: skip
MOVES = 9  # actions that may move
STAY = ACTIONS.index("stay")


@kernel
def push(action):
    """Return the direction of an action along x and y: -1, 0 or 1 each."""
    if action < MOVES:
        return action // 3 - 1, action % 3 - 1
    return 0, 0


PUSHES = tuple(map(push, range(len(ACTIONS))))


@entry
def distances(is_open, x, y):
    """Return [H, W] int64 steps from every cell to (x, y), or UNREACHABLE.

    Moves go to the four neighbours. IndexError is raised if (x, y) is outside of the grid.

    Args:
        is_open: [H, W] bool, indexed [y, x].
    """
    height, width = is_open.shape
    if not (0 <= x < width and 0 <= y < height):
        raise IndexError("the cell is outside the grid")
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
