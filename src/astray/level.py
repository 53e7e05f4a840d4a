"""Levels as data: drawn in text, written as JSON, edited, checked."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeGuard

import numpy as np

from astray.game import Game, Variant
from astray.record import NEVER, is_trusted
from astray.validation import bounded, brief, check_cell, of_kind, one_of, shown

AGENT, EMPTY = "@", "."  # in the drawings of all games
ON = f"{AGENT} on "  # prefix of the line below a drawing with what the agent stands on
BYTE_ORDER_MARK = "\ufeff"  # some editors put it at the start of a file
LARGEST = 2**20  # cells of a level, or characters of a drawing; CoinRun's levels have 4,096 cells
CLOSE = 1e-5  # cells; the rounding of a 32-bit position
Cell = tuple[int, int]  # x to the right, y upward, from the lower left


@dataclass(frozen=True, eq=False)
class Level:
    r"""One layout of a game, before anything has moved. Edits return a new level.

    Examples:
        >>> maze = astray.games.find("maze")
        >>> level = astray.Level.from_text(maze, maze.variant("anywhere"), "..G\n.#.\n@..")
        >>> print(level.moved("goal", (0, 2)))
        G..
        .#.
        @..

    Attributes:
        cells: [H, W] uint8, indexed [y, x], codes of the game's legend.
        agent: Cell in which the agent begins.
        looks: Further fields that the game builds the level from, such as its background. The game
            chooses those that are missing.

    Raises:
        ValueError: If the cells or the agent are invalid, or an edit is impossible.
    """

    game: Game
    variant: Variant
    cells: np.ndarray
    agent: Cell
    looks: Mapping[str, Any]

    def __post_init__(self) -> None:
        of_kind("a level's game", self.game, Game)
        self.game.variant(self.variant)
        of_kind("a level's variant", self.variant, Variant)  # not its name
        of_kind("a level's looks", self.looks, Mapping)
        object.__setattr__(self, "agent", check_cell(self.agent))
        self._check_cells()
        if not self._is_inside(self.agent):
            raise ValueError(f"the agent is at cell {self.agent}, outside of the level")

    def _check_cells(self) -> None:
        """Raise ValueError if the cells, which callers may change, hold an unknown code."""
        cells, codes = self.cells, sorted(set(self.game.editing.LEGEND.values()))
        if not isinstance(cells, np.ndarray) or cells.ndim != 2 or cells.dtype != np.uint8:
            raise ValueError("a level's cells are an array [H, W] of uint8")
        known = np.bincount(codes, minlength=256)[cells]
        if not known.all():
            y, x = map(int, np.argwhere(known == 0)[0])
            raise ValueError(f"unknown code {cells[y, x]} at cell ({x}, {y}); there are: {codes}")

    @staticmethod
    def of(game: Game, variant: Variant, s: Any) -> Level:
        """Return the level of state `s`, without the objects that are gone.

        Raises:
            ValueError: If `s` was edited to an invalid state, or no level can begin where its
                agent is, for instance in lava.
        """
        of_kind("a state", s, np.void)
        variant = game.variant(variant)
        if s.dtype != game.state or not is_trusted(s):
            game.check(np.array([s]), variant)
        cells, centre = game.editing.grid(s), game.editing.centre(s)
        level = Level(game, variant, cells, _cell(centre), game.editing.describe(s)["looks"])
        level._check_stands()
        return level

    @staticmethod
    def from_text(game: Game, variant: Variant, drawing: str) -> Level:
        """Parse a level from a text drawing, one legend character per cell, top row first.

        If the agent stands on something, a line below the drawing says so, for instance "@ on o".

        Raises:
            ValueError: If the drawing is not a level; the message names the row.
        """
        of_kind("a level's drawing", drawing, str)
        bounded("the number of a drawing's characters", len(drawing), 0, LARGEST)
        drawing = drawing.removeprefix(BYTE_ORDER_MARK)
        rows = textwrap.dedent(drawing).strip("\n").rstrip().splitlines()[::-1]
        beneath = rows.pop(0)[len(ON) :] if rows and rows[0].startswith(ON) else EMPTY
        if not rows or len({len(row) for row in rows}) != 1:
            raise ValueError(
                f"a level's rows are equally long; these have {shown([len(r) for r in rows])}"
            )
        if beneath not in game.editing.LEGEND:
            there = " ".join(game.editing.LEGEND)
            raise ValueError(f"the agent is on {shown(beneath)}; there are: {there}")
        legend = {**game.editing.LEGEND, AGENT: game.editing.LEGEND[beneath]}
        cells = np.empty((len(rows), len(rows[0])), np.uint8)
        for y, row in enumerate(rows):
            for x, char in enumerate(row):
                if char not in legend:
                    there = " ".join(legend)
                    raise ValueError(f"unknown {char!r} at cell ({x}, {y}); there are: {there}")
                cells[y, x] = legend[char]
        agents = [(row.index(AGENT), y) for y, row in enumerate(rows) if AGENT in row]
        count = sum(row.count(AGENT) for row in rows)
        if count != 1:
            raise ValueError(f"a level has one {AGENT!r}, the agent; this has {count}")
        return Level(game, variant, cells, agents[0], {})

    @staticmethod
    def from_json(game: Game, variant: Variant, data: Any) -> Level:
        """Return the level that `to_json` wrote; only "grid" and "agent" are required.

        Raises:
            ValueError: If a field is unknown, or differs from what `to_json` writes.
        """
        if not isinstance(data, Mapping) or not {"grid", "agent"} <= data.keys():
            raise ValueError(
                f'a level must be an object with at least "grid" and "agent"; got {shown(data)}'
            )
        if data.get("game", game.name) != game.name:
            raise ValueError(f"the level is one of {shown(data['game'])}, not of {game.name!r}")
        rows = data["grid"]
        wide = isinstance(rows, list) and {len(r) if isinstance(r, list) else -1 for r in rows}
        if not wide or len(wide) != 1 or wide <= {-1, 0}:
            raise ValueError("a level's grid is a list of equally long lists of codes")
        bounded("the number of a level's cells", len(rows) * max(wide), 1, LARGEST)
        codes = sorted(set(game.editing.LEGEND.values()))
        for y, row in enumerate(rows):
            for x, code in enumerate(row):
                if type(code) is not int or code not in codes:
                    raise ValueError(
                        f"unknown code {shown(code)} at cell ({x}, {y}); there are: {codes}"
                    )
        cells, agent = np.array(rows, np.uint8), data["agent"]
        if not (
            isinstance(agent, list | tuple) and len(agent) == 2 and all(map(_is_number, agent))
        ):
            raise ValueError(f"the agent must be at two numbers, x and y; got {shown(agent)}")
        looks = data.get("looks", {})
        of_kind("a level's looks", looks, Mapping)
        level = Level(game, variant, cells, _cell(agent), looks)._uncovered()
        told = game.editing.describe(level.state(solvable=False))
        apart = {"game", "variant", "level", "looks"} | (
            {"grid"} if level.cells is not cells else set()
        )
        rest = {k: v for k, v in data.items() if k not in apart}
        _check_told(rest, told, "a level")
        return level

    def state(self, *, solvable: bool = True) -> Any:
        """Return the state that begins in this level; its level number is NEVER.

        Args:
            solvable: Check that the agent can reach every object.

        Raises:
            ValueError: If no episode can begin in this level.
        """
        game = self.game
        self._check_stands()
        s = self._built()
        s["level"] = NEVER
        game.check(np.array([s], game.state), self.variant)
        _check_told(self.looks, game.editing.describe(s)["looks"], "a level's looks")
        if solvable:
            reachable = game.solver.reachable(s)
            for name in game.editing.OBJECTS:
                for cell in self.where(name):
                    if not reachable[cell[1], cell[0]]:
                        raise ValueError(
                            f"the {name} at cell {cell} cannot be reached from {self.agent}"
                        )
        return s

    def _built(self) -> Any:
        """Return the game's state of the level, unchecked; raise ValueError if looks cannot be."""
        try:
            return self.game.editing.build(self.cells, self.agent, self.looks, self.variant)
        except (TypeError, IndexError, OverflowError, ValueError) as error:
            if not self.looks:
                raise
            replace(self, looks={}).state(solvable=False)  # raises what else is wrong
            told = f"{shown(dict(self.looks))}; these cannot be: {brief(error)}"
            raise ValueError(f"a level's looks are {told}") from error

    def to_json(self) -> dict[str, Any]:
        """Return the level as JSON-serialisable data; see the game's `describe`."""
        return {"game": self.game.name} | self.game.editing.describe(self.state(solvable=False))

    def __str__(self) -> str:
        """Return the drawing, one character per cell, top row first."""
        self._check_cells()
        chars = self._chars()
        rows = [[chars[code] for code in row] for row in self.cells.tolist()]
        x, y = self.agent
        beneath, rows[y][x] = rows[y][x], AGENT
        drawing = "\n".join("".join(row) for row in reversed(rows))
        return drawing if beneath == EMPTY else f"{drawing}\n{ON}{beneath}"

    def where(self, name: str) -> list[Cell]:
        """Return the cells of the object called `name`, or of "agent".

        Raises:
            ValueError: If the game has no such object.
        """
        if name == "agent":
            return [self.agent]
        one_of("object", name, ["agent", *self.game.editing.OBJECTS])
        code = self.game.editing.LEGEND[self.game.editing.OBJECTS[name]]
        return [(int(x), int(y)) for y, x in np.argwhere(self.cells == code)]

    def moved(self, name: str, to: Cell, at: Cell | None = None) -> Level:
        """Return the level with "agent" or an object moved to the cell `to`.

        Args:
            at: Cell of the object; needed if there are several.
        """
        if name == "agent":
            self._check_free(to)
            return replace(self, agent=to)
        at = self._one(name, at)
        lifted = self.removed(name, at)
        return replace(lifted.added(name, to), looks=lifted._details(check_cell(to), self, at))

    def removed(self, name: str, at: Cell | None = None) -> Level:
        """Return the level without an object.

        If there is another object in the cell, such as a walker at a crate, that one is drawn then.

        Args:
            at: Cell of the object; needed if there are several.

        Raises:
            ValueError: If there is no such object. The agent is none.
        """
        one_of("object", name, self.game.editing.OBJECTS)  # a level without its agent is none
        x, y = self._one(name, at)
        cells = self.cells.copy()
        cells[y, x] = self.game.editing.LEGEND[EMPTY]
        return replace(self, cells=cells, looks=self._details((x, y)))._uncovered()

    def added(self, name: str, at: Cell) -> Level:
        """Return the level with one more object, in the cell `at`.

        Raises:
            ValueError: If there is no such object, or the cell is not empty.
        """
        one_of("object", name, self.game.editing.OBJECTS)
        self._check_free(at)
        cells = self.cells.copy()
        cells[at[1], at[0]] = self.game.editing.LEGEND[self.game.editing.OBJECTS[name]]
        return replace(self, cells=cells, looks=self._details(check_cell(at)))

    def _details(
        self, at: Cell, before: Level | None = None, where: Cell | None = None
    ) -> Mapping[str, Any]:
        """Return the looks without those of cell `at`, or with those of `where` in `before`."""
        here, there = (one.looks.get("details") if one else [] for one in (self, before))
        if not _is_of_cells(here) or not _is_of_cells(there):
            return self.looks  # `state` says what is wrong with them
        kept = [one for one in here if tuple(one[:2]) != at]
        kept += [[*at, *one[2:]] for one in there if tuple(one[:2]) == where]
        return {**self.looks, "details": sorted(kept, key=lambda one: one[1::-1])}

    def _uncovered(self) -> Level:
        """Return the level with what looks alone put into a cell that is empty now."""
        lists = (x for name, x in self.looks.items() if name != "details" and _is_of_cells(x))
        shared = {(one[0], one[1]) for several in lists for one in several}
        empty = self.game.editing.LEGEND[EMPTY]
        if not any(self._is_inside((x, y)) and self.cells[y, x] == empty for x, y in shared):
            return self
        s = self._built()
        looks = self.game.editing.describe(s)["looks"]
        return replace(self, cells=self.game.editing.grid(s), looks=looks)

    def splay(self, name: str, at: Cell | None = None) -> list[Level]:
        """Return a level for each cell that "agent" or an object could be in, lowest row first.

        These are the empty cells that the agent can reach, and its own cell.
        """
        at = None if name == "agent" else self._one(name, at)
        lifted = self if at is None else self.removed(name, at)
        free = self.game.places.stand(lifted.state(solvable=False))
        free[self.agent[1], self.agent[0]] = name == "agent"
        cells = [(int(x), int(y)) for y, x in np.argwhere(free)]
        if at is None:
            return [replace(self, agent=cell) for cell in cells]
        return [self.moved(name, cell, at) for cell in cells]

    def _one(self, name: str, at: Cell | None) -> Cell:
        """Return the cell of the object called `name`: its only one, or `at`."""
        there, at = self.where(name), None if at is None else check_cell(at)
        if at in there or (at is None and len(there) == 1):
            return at or there[0]
        where = ", ".join(map(str, there)) or "nowhere"
        raise ValueError(f"which {name}? given {at}; there are: {where}")

    def _is_inside(self, cell: Cell) -> bool:
        x, y = cell
        return 0 <= x < self.cells.shape[1] and 0 <= y < self.cells.shape[0]

    def _check_stands(self) -> None:
        """Raise ValueError unless the agent may stand in its cell."""
        x, y = self.agent
        if self._char(x, y) not in self.game.editing.STOOD_ON:
            self._check_free(self.agent)

    def _check_free(self, cell: Cell) -> None:
        self._check_cells()
        x, y = cell = check_cell(cell)
        if not self._is_inside(cell):
            raise ValueError(f"cell {cell} is outside of the level")
        if self.cells[y, x] != self.game.editing.LEGEND[EMPTY]:
            raise ValueError(f"cell {cell} holds {self._char(x, y)!r}")

    def _char(self, x: int, y: int) -> str:
        return self._chars()[int(self.cells[y, x])]

    def _chars(self) -> dict[int, str]:
        return {code: char for char, code in self.game.editing.LEGEND.items()}


def _cell(place: Any) -> Cell:
    """Return the cell that contains a place (x, y)."""
    return int(np.floor(place[0])), int(np.floor(place[1]))


def _is_of_cells(value: Any) -> TypeGuard[list[list[Any]]]:
    """Return whether looks are lists [x, y, ...] of cells."""
    return isinstance(value, list) and all(
        isinstance(one, list) and len(one) > 1 and type(one[0]) is type(one[1]) is int
        for one in value
    )


def _is_number(value: Any) -> TypeGuard[int | float]:
    return type(value) in (int, float) and abs(value) < 1e9  # neither infinite nor NaN


def _is_alike(given: Any, true: Any) -> bool:
    """Return whether plain data are equal up to the rounding of 32-bit floats."""
    if isinstance(given, list) and isinstance(true, list):
        return len(given) == len(true) and all(map(_is_alike, given, true))
    if isinstance(true, float) and _is_number(given):
        return abs(given - true) < CLOSE
    return given == true and isinstance(given, bool) == isinstance(true, bool)


def _check_told(given: Mapping[str, Any], true: Mapping[str, Any], what: str) -> None:
    """Raise ValueError unless a level's `given` redundant fields agree with the `true` ones."""
    for name, value in given.items():
        one_of("field", name, true, of=what)
        if not _is_alike(value, true[name]):
            raise ValueError(f"{name} is {shown(value)}, but in this level {shown(true[name])}")
