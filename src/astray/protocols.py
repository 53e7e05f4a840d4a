"""Protocols for the parts of a game; modules or any objects with these names satisfy them.

`s` is a state, `p` the record of a variant. Compiled functions are made by `kernel.jit.kernel`.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np


@dataclass(frozen=True)
class Classes:
    """A label of states that is the index of a name, or -1 for none.

    Examples:
        >>> astray.games.find("maze").labels["cheese direction"].names
        ('left', 'right', 'down', 'up')
    """

    find: Callable[[np.ndarray], np.ndarray]
    names: tuple[str, ...]

    def __call__(self, states: np.ndarray) -> np.ndarray:
        """Return the index of each state's name, [N]."""
        return self.find(states)


class Rules(Protocol):
    """Transitions, rewards and events of a game.

    Examples:
        >>> astray.games.find("maze").rules.EVENTS
        ('reached_goal', 'reached_corner', 'reached_other')
    """

    @property
    def ACTIONS(self) -> tuple[str, ...]:
        """Names of the actions; "stay" takes a step and does nothing."""
        ...

    @property
    def STATE(self) -> np.dtype:
        """The dtype of a state, made by `record.state_dtype`."""
        ...

    @property
    def EVENTS(self) -> tuple[str, ...]:
        """Integer fields of the state: the step at which each event first happened, or NEVER."""
        ...

    def step(self, s: Any, action: Any, /) -> tuple[float, bool]:
        """Take a step in compiled code; return its reward, and whether it ended the episode."""
        ...


class Levels(Protocol):
    """The generator of a game's levels.

    Examples:
        >>> maze = astray.games.find("maze")
        >>> s = astray.record.fresh(maze.rules)[0]
        >>> maze.levels.generate(s, maze.variant("corner").records()[0])
    """

    def generate(self, s: Any, p: Any, /) -> None:
        """Fill `s` with a new level, in compiled code.

        The random generator in `s` is seeded and the common fields are set. All other fields are 0,
        and events have not happened.
        """
        ...


class Symbols(Protocol):
    """Symbolic observations: planes [C, H, W] uint8 instead of images.

    Examples:
        >>> maze = astray.games.find("maze")
        >>> maze.symbols.planes(maze.variant("corner-small")).shape
        (4, 7, 7)
    """

    def planes(self, variant: Any, /) -> np.ndarray:
        """Return the largest values, [C, H, W] uint8; binary planes first."""
        ...

    def planes_scene_shape(self, variant: Any, /) -> tuple[int, ...]:
        """Return the shape of the scene."""
        ...

    def background_planes(self, s: Any, scene: Any, /) -> None:
        """Write the background, which does not move, in compiled code."""
        ...

    def foreground_planes(self, s: Any, scene: Any, planes: Any, /) -> None:
        """Write the planes, in compiled code."""
        ...


class Editing(Protocol):
    """Conversion between states and levels as data; see `level.Level`.

    Examples:
        >>> astray.games.find("maze").editing.OBJECTS
        {'goal': 'G', 'other': 'o', 'goal on other': 'O'}
    """

    @property
    def LEGEND(self) -> Mapping[str, int]:
        """Character in drawings -> code of a cell's contents; `level.EMPTY` is among them."""
        ...

    @property
    def OBJECTS(self) -> Mapping[str, str]:
        """Objects that can be moved, added and removed: name -> character in drawings."""
        ...

    @property
    def STOOD_ON(self) -> str:
        """Characters that the agent can stand on during an episode; it begins on `level.EMPTY`."""
        ...

    def grid(self, s: Any, /) -> np.ndarray:
        """Return codes of the cells' contents, [H, W] uint8, lowest row first."""
        ...

    def centre(self, s: Any, /) -> list[float]:
        """Return x and y of the agent, in cells."""
        ...

    def describe(self, s: Any, /) -> dict[str, Any]:
        """Return its level as JSON-serialisable data, with derived fields.

        "grid" and "agent" (its centre) are lists; "looks" holds everything else that `build` needs.
        Its "details" are lists [x, y, ...], one per cell: they are moved and removed with the
        object in the cell. Other lists of this form name a second object in a cell, which appears
        in `grid` once the first is gone.
        """
        ...

    def build(self, grid: Any, agent: Any, looks: Any, variant: Any, /) -> Any:
        """Return the state that begins with this grid [H, W], agent's cell and looks.

        It raises ValueError if there is no such state.
        """
        ...


class Places(Protocol):
    """Actual and possible positions of the agent, x to the right, y upward.

    Examples:
        >>> maze = astray.games.find("maze")
        >>> maze.places.centre(astray.acting.initial_states("maze", "corner-small", [7])).shape
        (1, 2)
    """

    def centre(self, states: np.ndarray, /) -> np.ndarray:
        """Return the agents' centres in states [N], [N, 2] float64 in cells."""
        ...

    def stand(self, s: Any, /) -> np.ndarray:
        """Return the cells in which the agent can be put, [H, W] bool.

        These are the empty cells that it can reach, and its own.
        """
        ...

    def put(self, states: np.ndarray, cells: np.ndarray, /) -> np.ndarray:
        """Return states [N] with the agents in cells [N, 2] int64, at rest.

        Everything else is copied from the given states, which stay unchanged.
        """
        ...


class Cells(Protocol):
    """Grid geometry for games whose agent moves from cell to cell; the agency measure needs it.

    Examples:
        >>> maze = astray.games.find("maze")
        >>> s = astray.acting.initial_states("maze", "corner-small", [7])[0]
        >>> maze.cells.target(s, "corner")
        (5, 5)
    """

    def free(self, s: Any, /) -> np.ndarray:
        """Return the cells that an agent can stand in, [H, W] bool."""
        ...

    def target(self, s: Any, goal: str, /) -> tuple[int, int] | None:
        """Return the cell of the goal, or None if the level lacks it."""
        ...


class Sprites(Protocol):
    """Vector drawings of a game of cells, with which the lab draws it.

    Examples:
        >>> lava = astray.games.find("lavaland").sprites
        >>> lava.PICTURES["G"], lava.agent(astray.acting.initial_states("lavaland", "dry", [0])[0])
        (('cheese',), 'mouse')
    """

    @property
    def DRAWINGS(self) -> Mapping[str, Path]:
        """Name of a drawing -> its SVG file."""
        ...

    @property
    def FLOORS(self) -> Sequence[str]:
        """Names of the drawings below everything, which take turns like a chessboard's."""
        ...

    @property
    def PICTURES(self) -> Mapping[str, Sequence[str]]:
        """Character of `Editing.LEGEND` -> names of the drawings in such a cell, lowest first."""
        ...

    def agent(self, s: Any, /) -> str:
        """Return the name of the agent's drawing."""
        ...


class Solver(Protocol):
    """Shortest paths and optimal policies for the goals of a game.

    Solvers call `check_record` before compiled code sees a record.

    Examples:
        >>> maze = astray.games.find("maze")
        >>> s = astray.acting.initial_states("maze", "corner-small", [7])[0]
        >>> maze.actions[maze.solver.expert(s, "cheese")(s)]
        'up'
    """

    def reachable(self, s: Any, /) -> np.ndarray:
        """Return the cells that the agent can reach, [H, W] bool."""
        ...

    def expert(self, s: Any, goal: str, /) -> Callable[[Any], int]:
        """Return a policy, which maps a state of the episode to an optimal action.

        The policy stays in place if the goal was reached or cannot be reached.
        """
        ...

    def optimal_return(self, s: Any, goal: str, gamma: float, /) -> float:
        """Return the largest discounted return."""
        ...


class Mutating(Protocol):
    """Small random edits of levels, for curricula such as ACCEL.

    Examples:
        >>> maze = astray.games.find("maze")
        >>> states = astray.acting.initial_states("maze", "corner-small", range(3))
        >>> seeds = np.arange(3, dtype=np.uint32)
        >>> len(maze.mutation.mutate(states, maze.variant("corner-small"), seeds, 5, "identity"))
        3
    """

    def mutate(
        self, states: np.ndarray, variant: Any, seeds: np.ndarray, edits: int, kind: Any, /
    ) -> np.ndarray:
        """Return edited states [N], given states [N], seeds [N] uint32 and the number of edits.

        The given states are initial states of levels, and `kind` is one of `game.MUTATIONS`. In
        each result the agent can reach the goal, `level` is NEVER, and `shifted` says whether the
        goal was placed as in the variant's shifted levels.
        """
        ...
