"""Maps of 20 x 20 cells for studies of the measure; the paper's own map is unknown.

Rows go from the top down.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from astray.agency.gridworld import World

SIDE = 20


def open_room() -> World:
    """Return a room without walls."""
    return World(np.ones((SIDE, SIDE), bool))


def four_rooms() -> World:
    """Return four rooms with doors between neighbours."""
    free = np.ones((SIDE, SIDE), bool)
    free[SIDE // 2] = free[:, SIDE // 2] = False
    for door in (SIDE // 4, 3 * SIDE // 4):
        free[SIDE // 2, door] = free[door, SIDE // 2] = True
    return World(free[::-1])


def obstacles(fraction: float, seed: int) -> World:
    """Return random walls in a `fraction` of the cells; enclosed cells become wall too."""
    free = np.random.default_rng(seed).random((SIDE, SIDE)) >= fraction
    world = World(free[::-1])
    sizes = np.isfinite(world.distance).sum(1)
    kept = world.cells[world.accessible(int(sizes.argmax()))]
    largest = np.zeros_like(free)
    largest[kept[:, 1], kept[:, 0]] = True
    return World(largest)


def maze(seed: int) -> World:
    """Return a maze without loops from a depth-first walk; the last row and column are wall."""
    rng, free = np.random.default_rng(seed), np.zeros((SIDE, SIDE), bool)
    way = [(0, 0)]
    free[0, 0] = True
    while way:
        row, column = way[-1]
        around = [(row + dr, column + dc) for dr, dc in ((-2, 0), (2, 0), (0, -2), (0, 2))]
        dug = [
            (r, c) for r, c in around if 0 <= r < SIDE - 1 and 0 <= c < SIDE - 1 and not free[r, c]
        ]
        if not dug:
            way.pop()
            continue
        r, c = dug[rng.integers(len(dug))]
        free[r, c] = free[(row + r) // 2, (column + c) // 2] = True
        way.append((r, c))
    return World(free[::-1])


MAPS: dict[str, Callable[[], World]] = {
    "open room": open_room,
    "four rooms": four_rooms,
    "obstacles, 20 %": partial(obstacles, 0.2, seed=0),
    "obstacles, 30 %": partial(obstacles, 0.3, seed=0),
    "maze": partial(maze, seed=0),
}
