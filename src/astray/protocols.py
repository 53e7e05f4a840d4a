"""What the parts of a game have; a module or any object that has the same names will do.

`s` is a state, `p` the record of a variant. Compiled functions are made by `kernel.jit.kernel`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np


class Rules(Protocol):
    """What moves, and what comes of it."""

    @property
    def ACTIONS(self) -> tuple[str, ...]:
        """Names; what "stay" does takes a step, and no more."""
        ...

    @property
    def STATE(self) -> np.dtype:
        """What `state_dtype` makes."""
        ...

    @property
    def EVENTS(self) -> tuple[str, ...]:
        """Fields of the state, int64: the step that each first happened, or NEVER."""
        ...

    @property
    def step(self) -> Callable:
        """Compiled: (s, action) -> (reward, terminated)."""
        ...


class Levels(Protocol):
    """What a level's number decides."""

    @property
    def generate(self) -> Callable:
        """Compiled: (s, p), fill `s` with a new level.

        Its twister is seeded, and its common fields are set; all others are as the level before
        left them.
        """
        ...


class Symbols(Protocol):
    """Symbolic observations: planes [C, H, W] uint8 in the place of images."""

    @property
    def planes(self) -> Callable[..., np.ndarray]:
        """(variant) -> [C, H, W] the largest values."""
        ...

    @property
    def planes_scene_shape(self) -> Callable[..., tuple[int, ...]]:
        """(variant) -> the scene's."""
        ...

    @property
    def paint_planes(self) -> Callable:
        """Compiled: (s, scene), what does not move."""
        ...

    @property
    def draw_planes(self) -> Callable:
        """Compiled: (s, scene, planes)."""
        ...


class Editing(Protocol):
    """Levels as data; see `level.Level`."""

    @property
    def LEGEND(self) -> Mapping[str, int]:
        """Character in drawings -> code of what a cell holds; `level.EMPTY` is among them."""
        ...

    @property
    def OBJECTS(self) -> Mapping[str, str]:
        """What may be moved, added, removed: its name -> its character."""
        ...

    @property
    def STOOD_ON(self) -> str:
        """Characters of what the agent may stand on amid an episode; it begins on `level.EMPTY`."""
        ...

    @property
    def grid(self) -> Callable[[Any], np.ndarray]:
        """(s) -> [H, W] uint8, the codes of what its cells hold, rows from the lowest up."""
        ...

    @property
    def centre(self) -> Callable[[Any], list[float]]:
        """(s) -> x and y of the agent, in cells."""
        ...

    @property
    def describe(self) -> Callable[[Any], dict[str, Any]]:
        """(s) -> its level as plain, JSON-able data, and what follows from that.

        "grid" and "agent" (its centre), as lists; "looks" (all else that `build` needs to build
        it again). Of these, "details" are lists [x, y, ...] of single cells: they go where the
        object in that cell is moved to, and are removed with it.
        """
        ...

    @property
    def build(self) -> Callable[..., Any]:
        """(grid, agent's cell, looks, variant) -> the state that begins there.

        ValueError where none can.
        """
        ...


class Places(Protocol):
    """Where the agent of a game is, and where else it could be: x to the right, y upward."""

    @property
    def centre(self) -> Callable[[np.ndarray], np.ndarray]:
        """(states [N]) -> [N, 2] float64, the centres of the agents, in cells."""
        ...

    @property
    def stand(self) -> Callable[[Any], np.ndarray]:
        """(s) -> [H, W] bool, the cells that the agent can be put in.

        Those with nothing in them that it can get to, and its own.
        """
        ...

    @property
    def put(self) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        """(states [N], cells [N, 2] int64) -> states [N]: the agents in these cells, at rest.

        All else is as in the states given, which stay as they are.
        """
        ...


class Cells(Protocol):
    """Games whose agent goes from cell to cell, (x, y): those the agency measure is for."""

    @property
    def free(self) -> Callable[[Any], np.ndarray]:
        """(s) -> [H, W] bool, the cells that an agent may stand in."""
        ...

    @property
    def target(self) -> Callable[[Any, str], tuple[int, int] | None]:
        """(s, goal) -> the cell of one of the game's goals; None where the level has none."""
        ...


class Solver(Protocol):
    """What can be reached, and how; a goal is one of the game's goals.

    Whoever trusts a record to compiled code sees it first: `check_record`.
    """

    @property
    def reachable(self) -> Callable[[Any], np.ndarray]:
        """(s) -> [H, W] bool, the cells that the agent can get to."""
        ...

    @property
    def expert(self) -> Callable[[Any, str], Callable[[Any], int]]:
        """(s, goal) -> a policy: (a state of the same episode) -> the action that leads there.

        To stay where the goal was reached or cannot be.
        """
        ...

    @property
    def optimal_return(self) -> Callable[[Any, str, float], float]:
        """(s, goal, gamma) -> the return."""
        ...


class Mutating(Protocol):
    """Levels made of others by small edits, for curricula that search among them."""

    @property
    def mutate(self) -> Callable[..., np.ndarray]:
        """(states [N], variant, seeds [N] uint32, edits, kind) -> states [N], the edited levels.

        States are those that levels begin in; `kind` is one of `game.MUTATIONS`. The agent can
        reach the goal in each, its `level` is NEVER, and `shifted` says whether its goal was
        placed as in the variant's shifted levels.
        """
        ...
