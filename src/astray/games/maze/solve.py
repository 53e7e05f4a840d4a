"""The shortest ways through a maze."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from astray.bounds import finite, one_of
from astray.games.maze import rules
from astray.games.maze.levels import truths
from astray.games.maze.rules import REWARD
from astray.games.maze.variants import GOALS
from astray.kernel import maze
from astray.kernel.grid import ACTIONS, STAY, UNREACHABLE, distances
from astray.kernel.maze import WALL
from astray.record import NEVER, check_record

check = functools.partial(check_record, rules=rules, truths=truths)


def target(s: Any, goal: str) -> tuple[int, int] | None:
    """The cell (x, y) of `goal` in state `s`; None where the level has none."""
    one_of("goal", goal, GOALS)
    place = GOALS[goal].removeprefix("reached_")
    x, y = int(s[f"{place}_x"]), int(s[f"{place}_y"])
    return None if x == NEVER else (x, y)


def steps_to(s: Any, goal: str) -> np.ndarray:
    """Steps from every cell to `goal`, [world, world] int64; UNREACHABLE where there is no way."""
    is_open = s.cell[: s.world, : s.world] != WALL
    cell = target(s, goal)
    if cell is None:
        return np.full(is_open.shape, UNREACHABLE)
    return distances(is_open, *cell)


def routes(s: Any, goal: str) -> np.ndarray:
    """The action of a shortest way to `goal` in every cell, [world, world]; "stay" at its end."""
    steps = steps_to(s, goal)
    best = np.full(steps.shape, STAY)
    around = np.pad(steps, 1, constant_values=UNREACHABLE)
    neighbours = {"left": (1, 0), "right": (1, 2), "down": (0, 1), "up": (2, 1)}
    for name, (row, column) in neighbours.items():
        beside = around[row : row + len(steps), column : column + len(steps)]
        closer = (beside != UNREACHABLE) & (beside == steps - 1)
        best[closer] = ACTIONS.index(name)
    return best


def expert(s: Any, goal: str) -> Callable[[Any], int]:
    """What leads to `goal` the shortest way, from wherever the mouse is in the maze of `s`.

    Once it was there, it stays, wherever somebody else leads it.
    """
    check(s)
    best, event = routes(s, goal), GOALS[goal]

    def action(now: Any) -> int:
        check(now)
        return STAY if now[event] != NEVER else int(best[int(now.y), int(now.x)])

    return action


def reachable(s: Any) -> np.ndarray:
    """The cells that the mouse can walk to, [world, world] bool."""
    check(s)
    return maze.reachable(s)


def optimal_return(s: Any, goal: str, gamma: float = 1.0) -> float:
    """The discounted reward of the shortest way from the mouse to `goal`, were it the rewarded one.

    The reward comes with the last step: gamma ** (steps - 1) * 10, and 0 where there is no way
    or it is longer than the time left.
    """
    finite("gamma", gamma, 0, 1)
    check(s)
    steps = steps_to(s, goal)[int(s.y), int(s.x)]
    if steps == UNREACHABLE or s.time + steps > s.time_limit:
        return 0.0
    return REWARD * gamma ** max(int(steps) - 1, 0)
