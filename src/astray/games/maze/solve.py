"""Shortest ways through a maze."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from astray.games.maze import rules
from astray.games.maze.levels import truths
from astray.games.maze.rules import REWARD
from astray.games.maze.variants import GOALS
from astray.kernel import maze
from astray.kernel.grid import ACTIONS, STAY, UNREACHABLE, distances
from astray.kernel.maze import WALL
from astray.record import NEVER, check_record
from astray.validation import finite, one_of

check = functools.partial(check_record, rules=rules, truths=truths)


def free(s: Any) -> np.ndarray:
    """Return the cells of the world of state `s` that are not walls, [H, W] bool."""
    return np.asarray(s.cell[: s.world, : s.world] != WALL)


def target(s: Any, goal: str) -> tuple[int, int] | None:
    """Return the cell (x, y) of `goal` in state `s`; None if the level lacks it."""
    one_of("goal", goal, GOALS)
    place = GOALS[goal].removeprefix("reached_")
    x, y = int(s[f"{place}_x"]), int(s[f"{place}_y"])
    return None if x == NEVER else (x, y)


def steps_to(s: Any, goal: str) -> np.ndarray:
    """Return the steps from every cell to `goal`, [world, world] int64, or UNREACHABLE."""
    is_open = free(s)
    cell = target(s, goal)
    if cell is None:
        return np.full(is_open.shape, UNREACHABLE)
    return distances(is_open, *cell)


def routes(s: Any, goal: str) -> np.ndarray:
    """Return the best action towards `goal` in every cell, [world, world]; "stay" at it."""
    steps = steps_to(s, goal)
    best = np.full(steps.shape, STAY)
    around = np.full((len(steps) + 2,) * 2, UNREACHABLE)  # `np.pad` takes ten times as long
    around[1:-1, 1:-1] = steps
    neighbours = {"left": (1, 0), "right": (1, 2), "down": (0, 1), "up": (2, 1)}
    for name, (row, column) in neighbours.items():
        beside = around[row : row + len(steps), column : column + len(steps)]
        closer = (beside != UNREACHABLE) & (beside == steps - 1)
        best[closer] = ACTIONS.index(name)
    return best


def expert(s: Any, goal: str) -> Callable[[Any], int]:
    """Return a policy that takes the shortest way to `goal`, from any cell in the maze of `s`.

    After reaching it, the policy stays, even if somebody else moves the mouse.
    """
    check(s)
    best, event = routes(s, goal), GOALS[goal]

    def action(now: Any) -> int:
        check(now)
        # A field of a record that is read as an attribute takes four times as long.
        return STAY if now[event] != NEVER else int(best[int(now["y"]), int(now["x"])])

    return action


def reachable(s: Any) -> np.ndarray:
    """Return the cells that the mouse can walk to, [world, world] bool."""
    check(s)
    return maze.reachable(s)


def optimal_return(s: Any, goal: str, gamma: float = 1.0) -> float:
    """Return the discounted reward of the shortest way to `goal`, as if that were rewarded.

    It is gamma ** (steps - 1) * 10, or 0 if there is no way in time, or the goal was reached.
    """
    finite("gamma", gamma, 0, 1)
    check(s)
    steps = steps_to(s, goal)[int(s.y), int(s.x)]
    is_over = s.ended or s[GOALS[goal]] != NEVER or s.time + steps > s.time_limit
    if is_over or steps == UNREACHABLE:
        return 0.0
    return REWARD * gamma ** max(int(steps) - 1, 0)
