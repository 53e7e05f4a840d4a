"""Agents: policies that take shortest ways to a goal and err with probability eps."""

from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import Literal

import numpy as np

from astray.agency.gridworld import Trajectory, World
from astray.agency.steps import IMPOSSIBLE, KIND
from astray.validation import check_words

AtGoal = Literal["uniform", "stay", "done", "absorb"]


@dataclass(frozen=True, eq=False)
class Agents:
    """Agents of G goals in one world, which choose uniformly among best actions.

    Attributes:
        distance: [F, G] float64, steps from each free cell to each goal; inf without a way.
        legal: Whether only moves that change the cell are actions.
        at_goal: Behaviour on the goal, where no action keeps the agent there. "uniform": any
            action, then back; "stay": bump into a wall, or any action without walls; "done": from
            then on any action everywhere; "absorb": the trajectory ends.
    """

    world: World
    distance: np.ndarray
    legal: bool = False
    at_goal: AtGoal = "uniform"

    def __post_init__(self) -> None:
        check_words(self)

    @cached_property
    def possible(self) -> np.ndarray:
        """[F] int64, number of possible actions in each cell."""
        legal = self.world.legal
        return legal.sum(1) if self.legal else np.full(len(legal), legal.shape[1])

    @cached_property
    def best(self) -> np.ndarray:
        """[F, 4, G] bool, actions that come one step nearer to each goal."""
        finite = np.isfinite(self.distance)  # else inf is a step nearer than inf
        return (self.distance[self.world.after] == (self.distance - 1)[:, None]) & finite[:, None]

    @cached_property
    def kinds(self) -> np.ndarray:
        """[F, 4, G] uint8, kind of every step; impossible if no way leads to the goal."""
        on_goal, actions = self.distance == 0, self.possible[:, None]
        bumps = (~self.world.legal).sum(1)[:, None]
        stays = on_goal & (bumps > 0) & (self.at_goal == "stay" and not self.legal)
        best = (
            self.best
            | (on_goal & ~stays)[:, None]
            | (stays[:, None] & ~self.world.legal[:, :, None])
        )
        k = np.where(stays, bumps, np.where(on_goal, actions, self.best.sum(1)))
        return KIND[best.astype(int), k[:, None], actions[:, None]]

    def steps(self, trajectory: Trajectory) -> np.ndarray:
        """Return the kind of each step of `trajectory` for each goal, [T, G] uint8."""
        before = trajectory.cells[:-1]
        taken = self.kinds[before, trajectory.actions]
        if self.at_goal in ("uniform", "stay"):
            return taken
        arrived = np.logical_or.accumulate(self.distance[before] == 0, axis=0)
        actions = self.possible[before][:, None]
        after = IMPOSSIBLE if self.at_goal == "absorb" else KIND[1, actions, actions]
        return np.where(arrived, after, taken)


@lru_cache(maxsize=8)  # of the last few worlds; it is by far the longest part of a measurement
def of_every_cell(world: World, legal: bool, at_goal: AtGoal) -> Agents:
    """Return the agents whose goals are all free cells, in order."""
    return Agents(world, world.distance, legal, at_goal)
