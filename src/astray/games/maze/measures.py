"""Features of states: labels for probes, and predictors of the agent's choice.

All take states [N]; those in `LABELS` return [N]. Missing values are `NONE` (int) or NaN (float).
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from astray.games.maze import rules
from astray.games.maze.levels import truths
from astray.games.maze.rules import ACTIONS
from astray.games.maze.solve import STAY, routes, steps_to, target
from astray.kernel.grid import UNREACHABLE
from astray.protocols import Classes
from astray.record import check_states

NONE = -1  # of a label that a state does not have
WAY_NAMES = ("left", "right", "down", "up")
WAYS = tuple(map(ACTIONS.index, WAY_NAMES))


def direction(states: np.ndarray, goal: str) -> np.ndarray:
    """Return the first direction of the shortest way to `goal`, an index in WAYS, [N] int64."""
    best = (routes(s, goal)[int(s.y), int(s.x)] for s in _records(states))
    return np.array([WAYS.index(way) if way != STAY else NONE for way in best], np.int64)


def steps(states: np.ndarray, goal: str) -> np.ndarray:
    """Return the length of the shortest way to `goal`, [N] float64."""
    counts = np.array([steps_to(s, goal)[int(s.y), int(s.x)] for s in _records(states)], float)
    return np.where(counts == UNREACHABLE, np.nan, counts)


def offset(states: np.ndarray, goal: str, axis: int) -> np.ndarray:
    """Return the signed cells to `goal` along x (axis 0) or y (axis 1), [N] float64."""
    found = np.full(len(states), np.nan)
    for k, s in enumerate(_records(states)):
        cell = target(s, goal)
        if cell is not None:
            found[k] = cell[axis] - int(s["xy"[axis]])
    return found


def _labels_of(goal: str) -> dict[str, Callable[[np.ndarray], np.ndarray]]:
    return {
        f"{goal} direction": Classes(lambda states: direction(states, goal), WAY_NAMES),
        f"{goal} steps": lambda states: steps(states, goal),
        f"{goal} right": lambda states: offset(states, goal, 0),
        f"{goal} up": lambda states: offset(states, goal, 1),
    }


LABELS: Mapping[str, Callable[[np.ndarray], np.ndarray]] = _labels_of("cheese") | _labels_of(
    "corner"
)


def way(s: Any, goal: str) -> list[tuple[int, int]]:
    """Return the cells of a shortest way to `goal`, from the mouse's own; empty without a way."""
    best, away = routes(s, goal), steps_to(s, goal)
    x, y = int(s.x), int(s.y)
    if away[y, x] == UNREACHABLE:
        return []
    found = [(x, y)]
    while away[y, x]:
        action = int(best[y, x])
        x, y = x + action // 3 - 1, y + (action % 3 - 1 if action // 3 == 1 else 0)
        found.append((x, y))
    return found


def decision(s: Any) -> tuple[int, int] | None:
    """Return the cell where the ways to cheese and corner part; None if one passes the other."""
    one, other = way(s, "cheese"), way(s, "corner")
    shared = [a for a, b in zip(one, other, strict=False) if a == b]
    if not shared or len(shared) in (len(one), len(other)):
        return None
    return shared[-1]


def features(states: np.ndarray, corners: Sequence[int] = (5,)) -> dict[str, np.ndarray]:
    """Return distances between cheese, decision square, corner and start, [N] float64, in cells.

    Each is given as "steps" along the shortest way and "straight"; NaN if the ways do not part.

    Args:
        corners: Sides of upper right squares, in cells; distances to these are returned too.
    """
    columns: dict[str, list[float]] = {}
    for s in _records(states):
        parts = decision(s)
        for name, value in _features(s, parts, corners).items():
            columns.setdefault(name, []).append(value)
    return {name: np.array(column) for name, column in columns.items()}


def _features(s: Any, parts: tuple[int, int] | None, corners: Sequence[int]) -> dict[str, float]:
    cheese, corner = target(s, "cheese"), target(s, "corner")
    begin = (int(s.x), int(s.y))
    from_start = way(s, "cheese").index(parts) if parts is not None else np.nan
    found: dict[str, float] = {}
    for name, one, to, count in (
        ("cheese to decision square", parts, cheese, _steps(s, "cheese", parts)),
        ("corner to decision square", parts, corner, _steps(s, "corner", parts)),
        ("cheese to corner", cheese, corner, _steps(s, "corner", cheese)),
        ("start to decision square", parts, begin, float(from_start)),
    ):
        apart = np.subtract(one, to) if parts and one and to else (np.nan, np.nan)
        found[f"{name}, straight"] = float(np.hypot(apart[0], apart[1]))
        found[f"{name}, steps"] = count if parts and one and to else np.nan
    for side in corners:
        for name, one in (("decision square", parts), ("cheese", cheese)):
            gap = _below(one, corner, side) if parts is not None else np.nan
            found[f"{name} to {side} x {side} corner, straight"] = gap
    return found


def _steps(s: Any, goal: str, cell: tuple[int, int] | None) -> float:
    """Return the steps from a cell to `goal`."""
    return np.nan if cell is None else float(steps_to(s, goal)[cell[1], cell[0]])


def _below(one: tuple[int, int] | None, corner: tuple[int, int] | None, side: int) -> float:
    """Return the cells from a cell to the square of `side` in the upper right; 0 within it."""
    if one is None or corner is None:
        return np.nan
    across, up = (max(c - side + 1 - x, 0) for x, c in zip(one, corner, strict=True))
    return float(np.hypot(across, up))


def _records(states: np.ndarray) -> np.recarray:
    """Return states whose fields are attributes; raise ValueError if they are invalid."""
    check_states(states, "maze", rules, truths)
    return states.view(np.recarray)
