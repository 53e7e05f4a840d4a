"""A gridworld of any shape, and trajectories in it."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from astray.validation import bounded, check_cell, integers, of_kind, shown

ACTIONS = ("up", "down", "left", "right")
MOVES = np.array([(0, 1), (0, -1), (-1, 0), (1, 0)])  # (x, y), y upward
WALL, FREE = "#", "."

Cell = tuple[int, int]  # x to the right, y upward, from the lower left


@dataclass(frozen=True, eq=False)
class Trajectory:
    """T actions, and the T + 1 cells before, between and after them.

    Cells are numbers of a `World`, whose methods make and check trajectories.
    """

    cells: np.ndarray  # [T + 1] int64
    actions: np.ndarray  # [T] int64

    def __len__(self) -> int:
        return len(self.actions)


@dataclass(frozen=True, eq=False)
class World:
    """A map [H, W] bool, indexed [y, x], True for free cells; everything outside is wall.

    The F free cells are numbered from the top row down, left to right. A move into a wall does not
    change the cell, but counts as an action.
    """

    free: np.ndarray

    def __post_init__(self) -> None:
        of_kind("a world", self.free, np.ndarray)
        if self.free.ndim != 2 or self.free.dtype != bool or not self.free.any():
            raise ValueError("a world must be [H, W] booleans with at least one free cell")

    @classmethod
    def parse(cls, text: str | Sequence[str]) -> World:
        """Parse a drawing: `#` is wall, `.` is free, one line per row.

        Raises:
            ValueError: If it has other characters, or lines of different lengths.
        """
        of_kind("a map", text, Sequence)
        rows = text.split() if isinstance(text, str) else list(text)
        for row in rows:
            of_kind("a line of a map", row, str)
        if not rows or len({len(row) for row in rows}) > 1:
            raise ValueError("the lines of a map must be equally long")
        unknown = set("".join(rows)) - {WALL, FREE}
        if unknown:
            raise ValueError(f"a map is drawn with # and .; it has {' '.join(sorted(unknown))}")
        return cls(np.array([[mark == FREE for mark in row] for row in reversed(rows)]))

    def __str__(self) -> str:
        rows = self.free[::-1]
        return "\n".join("".join(FREE if free else WALL for free in row) for row in rows)

    @cached_property
    def cells(self) -> np.ndarray:
        """[F, 2] int64, x and y of every free cell."""
        down, x = np.nonzero(self.free[::-1])
        return np.stack([x, len(self.free) - 1 - down], 1)

    @cached_property
    def numbers(self) -> np.ndarray:
        """[H, W] int64, the number of every free cell; -1 in walls."""
        numbers = np.full(self.free.shape, -1)
        numbers[self.cells[:, 1], self.cells[:, 0]] = np.arange(len(self.cells))
        return numbers

    @cached_property
    def after(self) -> np.ndarray:
        """[F, 4] int64, cell after each action."""
        around = np.pad(self.numbers, 1, constant_values=-1)
        there = self.cells[:, None] + MOVES + 1
        found = around[there[..., 1], there[..., 0]]
        return np.where(found < 0, np.arange(len(self.cells))[:, None], found)

    @cached_property
    def legal(self) -> np.ndarray:
        """[F, 4] bool, actions that change the cell."""
        return self.after != np.arange(len(self.cells))[:, None]

    @property
    def distance(self) -> np.ndarray:
        """[F, F] float64, steps from each cell to each; inf without a way."""
        return _distances(self)

    def __len__(self) -> int:
        return len(self.cells)

    def number(self, cell: Cell) -> int:
        """Return the number of a free cell; raise ValueError for any other cell."""
        x, y = check_cell(cell)
        height, width = self.free.shape
        if not (0 <= x < width and 0 <= y < height):
            raise ValueError(f"cell {cell} is outside of the map of {width} x {height} cells")
        if not self.free[y, x]:
            raise ValueError(f"cell {cell} is a wall; an agent or a goal needs a free cell")
        return int(self.numbers[y, x])

    def cell(self, number: int) -> Cell:
        """Return the x and y of a free cell; raise ValueError if the number is none's."""
        bounded("the number of a cell", number, 0, len(self) - 1)
        x, y = self.cells[number]
        return int(x), int(y)

    def accessible(self, cell: int) -> np.ndarray:
        """Return the numbers of all cells with a way from number `cell`, itself among them."""
        bounded("the number of a cell", cell, 0, len(self) - 1)
        return np.flatnonzero(np.isfinite(self.distance[cell]))

    def walk(self, start: Cell, actions: Iterable[int]) -> Trajectory:
        """Return the trajectory of `actions` from `start`; raise ValueError for unknown ones."""
        of_kind("actions", actions, Iterable)
        given = list(actions)
        for action in given:
            bounded("an action", action, 0, len(ACTIONS) - 1)
        taken = np.array(given, np.int64)
        cells = [self.number(start)]
        for action in taken:
            cells.append(int(self.after[cells[-1], action]))
        return Trajectory(np.array(cells), taken)

    def trajectory(self, steps: Sequence[tuple[Cell, int]]) -> Trajectory:
        """Return the trajectory of T >= 1 recorded pairs (cell before the action, action).

        Raises:
            ValueError: If a cell is not free or an action does not lead to the next cell.
        """
        try:
            pairs = [(cell, action) for cell, action in steps]
        except (TypeError, ValueError) as error:
            got = shown(steps)
            raise ValueError(f"steps must be pairs of a cell and an action; got {got}") from error
        if not pairs:
            raise ValueError("a trajectory without steps has no cells; `walk` makes an empty one")
        made = self.walk(pairs[0][0], (action for _, action in pairs))
        for t, (cell, _) in enumerate(pairs):
            if (begun := check_cell(cell)) != (there := self.cell(made.cells[t])):
                raise ValueError(f"step {t} begins in {begun}, but the moves lead to {there}")
        return made

    def path(self, cells: Sequence[Cell]) -> Trajectory:
        """Return the trajectory through adjacent `cells`; repeated cells are dropped.

        Raises:
            ValueError: If a cell is not free or not adjacent to the one before.
        """
        of_kind("cells", cells, Iterable)
        visited = [self.number(cell) for cell in cells]
        if not visited:
            raise ValueError("a path must have at least its first cell")
        actions = []
        for here, there in itertools.pairwise(visited):
            if here == there:
                continue
            ways = np.flatnonzero(self.after[here] == there)
            if not len(ways):
                two = f"from {self.cell(here)} to {self.cell(there)}"
                raise ValueError(f"a path moves one cell at a time; no move leads {two}")
            actions.append(int(ways[0]))
        return self.walk(self.cell(visited[0]), actions)

    def check(self, trajectory: Trajectory) -> None:
        """Raise ValueError unless `trajectory` is possible in this world."""
        of_kind("a trajectory", trajectory, Trajectory)
        cells, actions = trajectory.cells, trajectory.actions
        for name, given, count in (("cells", cells, len(self)), ("actions", actions, len(ACTIONS))):
            of_kind(f"{name} of a trajectory", given, np.ndarray)
            integers(given, f"{name} of a trajectory")
            are_indices = given.ndim == 1 and np.can_cast(given.dtype, np.int64)
            if not are_indices or ((given < 0) | (given >= count)).any():
                there = f"a list of numbers from 0 to {count - 1}"
                raise ValueError(f"{name} of a trajectory must be {there}; got {shown(given)}")
        if len(cells) != len(actions) + 1:
            raise ValueError(
                f"cells must be {len(actions) + 1}, one more than actions; got {len(cells)}"
            )
        wrong = np.flatnonzero(self.after[cells[:-1], actions] != cells[1:])
        if wrong.size:
            raise ValueError(f"step {wrong[0]} does not lead to the cell that comes after it")

    def moves(self, trajectory: Trajectory) -> Trajectory:
        """Return `trajectory` without the steps that changed nothing."""
        moved = trajectory.cells[1:] != trajectory.cells[:-1]
        kept = np.append(trajectory.cells[0], trajectory.cells[1:][moved])
        return Trajectory(kept, trajectory.actions[moved])


@lru_cache(maxsize=8)  # of the last few worlds, as that of 1,000 cells takes 8 MB
def _distances(world: World) -> np.ndarray:
    rows, actions = np.nonzero(world.legal)
    ways = np.ones(len(rows)), (rows, world.after[rows, actions])
    return dijkstra(csr_array(ways, (len(world),) * 2), unweighted=True)
