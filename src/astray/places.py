"""Positions of an agent in games whose states hold them as numbers x and y."""

from typing import Any

import numpy as np

from astray.protocols import Editing, Solver


class Placement:
    """The ability `places` of a game whose agent can be put into cells.

    An agent may stand in its own cell and in the empty cells that it can reach.
    """

    def __init__(
        self,
        editing: Editing,
        solver: Solver,
        within: tuple[float, float] = (0.5, 0.5),
        offset: float = 0,
        **at_rest: float,
    ):
        """Create the ability.

        Args:
            editing: The game's ability to describe levels.
            solver: The game's solver.
            within: Values of x and y of an agent in cell (0, 0).
            offset: Cells from x and y to the agent's centre.
            **at_rest: Values of further state fields after the agent was moved.
        """
        self._editing, self._solver = editing, solver
        self.within, self.offset, self.at_rest = within, offset, at_rest

    def centre(self, states: np.ndarray) -> np.ndarray:
        """Return the agents' centres [N, 2] float64 in `states` [N], in cells."""
        return np.stack([states["x"], states["y"]], -1).astype(np.float64) + self.offset

    def stand(self, s: Any) -> np.ndarray:
        """Return the cells in which the agent can be put, [H, W] bool."""
        empty = self._editing.grid(s) == self._editing.LEGEND["."]
        found = empty & self._solver.reachable(s)
        found[int(s.y), int(s.x)] = True
        return found

    def put(self, states: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """Return copies of states [N] with the agents in `cells` [N, 2], at rest."""
        found = states.copy()
        found["x"], found["y"] = (cells + self.within).T
        for name, value in self.at_rest.items():
            found[name] = value
        return found
