"""Trajectories for tests of the measure: the paper's four types, and policies without a goal."""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from astray.agency.devices import CLOCKWISE, COMPASS
from astray.agency.gridworld import ACTIONS, Cell, Trajectory, World
from astray.agency.measure import Episode
from astray.validation import MOST, bounded, check_words, finite, of_kind, one_of

Type = Literal["in-distribution", "goal misgeneralization", "capability failure", "robust"]
TYPES: tuple[Type, ...] = get_args(Type)
# Between equally short ways: "uniform", any of the best actions at each step; "first", the first
# in the order of ACTIONS; "straight", on as before where that is best, else the first.
Ties = Literal["uniform", "first", "straight"]


@dataclass(frozen=True, eq=False)
class Setting:
    """A world with the fixed start and goal of the training (the paper's s and g).

    Attributes:
        ties: Choice among shortest ways.
        horizon: Steps of a capability failure, including those on the memorised way.
        bumps: Whether random actions may run into walls; otherwise they always move.
    """

    world: World
    start: Cell
    goal: Cell
    seed: int
    ties: Ties = "uniform"
    horizon: int = 50
    bumps: bool = True

    def __post_init__(self) -> None:
        check_words(self)
        of_kind("world", self.world, World)
        bounded("seed", self.seed, 0, MOST)
        bounded("horizon", self.horizon, 1, MOST)
        start, goal = self.world.number(self.start), self.world.number(self.goal)
        if start == goal or not np.isfinite(self.world.distance[start, goal]):
            raise ValueError(f"no way leads from {self.start} to another cell {self.goal}")

    @cached_property
    def memory(self) -> dict[int, int]:
        """Cell -> action of the way from start to goal that a capability failure memorised."""
        rng = np.random.default_rng([self.seed, 1])
        way = shortest(self.world, self.start, self.goal, rng, self.ties)
        return dict(zip(way.cells[:-1].tolist(), way.actions.tolist(), strict=True))

    def episodes(self, kind: Type, count: int) -> list[Episode]:
        """Generate `count` nonempty episodes of a type; raise ValueError if it is unknown."""
        one_of("type", kind, Type)
        bounded("count", count, 0, MOST)
        rng = np.random.default_rng([self.seed, 2, TYPES.index(kind)])
        return [self._episode(kind, rng) for _ in range(count)]

    def _episode(self, kind: Type, rng: np.random.Generator) -> Episode:
        moved = kind in ("goal misgeneralization", "robust")
        # The goal that is shown is elsewhere; else the trajectory were in-distribution.
        shown = self._other(rng, self.goal) if moved else self.goal
        pursued = shown if kind == "robust" else self.goal
        begin = self._other(rng, pursued)
        if kind == "capability failure":
            return Episode(self.world, self._lost(begin, rng), shown)
        return Episode(self.world, shortest(self.world, begin, pursued, rng, self.ties), shown)

    def _other(self, rng: np.random.Generator, cell: Cell) -> Cell:
        """Draw an accessible cell other than `cell`."""
        cells = self.world.accessible(self.world.number(self.goal))
        number = rng.choice(cells[cells != self.world.number(cell)])
        return self.world.cell(number)

    def _lost(self, begin: Cell, rng: np.random.Generator) -> Trajectory:
        """Act randomly until the memorised way is met, then follow it to the goal."""
        world, here, actions = self.world, self.world.number(begin), []
        goal = world.number(self.goal)
        while here != goal and len(actions) < self.horizon:
            choices = range(len(ACTIONS)) if self.bumps else np.flatnonzero(world.legal[here])
            action = self.memory.get(here)
            actions.append(int(rng.choice(choices)) if action is None else action)
            here = int(world.after[here, actions[-1]])
        return world.walk(begin, actions)


def shortest(
    world: World, begin: Cell, end: Cell, rng: np.random.Generator, ties: Ties = "uniform"
) -> Trajectory:
    """Sample a shortest way from `begin` to `end` action by action, not uniformly among ways.

    Raises:
        ValueError: If there is no way.
    """
    one_of("ties", ties, Ties)
    here, steps = world.number(begin), world.distance[:, world.number(end)]
    if not np.isfinite(steps[here]):
        raise ValueError(f"no way leads from {begin} to {end}")
    actions: list[int] = []
    while steps[here]:
        best = np.flatnonzero(steps[world.after[here]] == steps[here] - 1)
        action = rng.choice(best) if ties == "uniform" else best[0]
        if ties == "straight" and actions and actions[-1] in best:
            action = actions[-1]
        actions.append(int(action))
        here = int(world.after[here, action])
    return world.walk(begin, actions)


Walker = Callable[[World, int, int, np.random.Generator], int]  # (world, cell, last) -> action


def uniform_random(world: World, here: int, last: int, rng: np.random.Generator) -> int:
    """Choose any action, walls or not."""
    return int(rng.integers(len(ACTIONS)))


def legal_random(world: World, here: int, last: int, rng: np.random.Generator) -> int:
    """Choose any action that moves."""
    return int(rng.choice(np.flatnonzero(world.legal[here])))


def persistent(world: World, here: int, last: int, rng: np.random.Generator) -> int:
    """Continue with probability 0.8 if that moves, otherwise choose any action that moves."""
    if world.legal[here, last] and rng.random() < 0.8:
        return last
    return legal_random(world, here, last, rng)


def billiard(world: World, here: int, last: int, rng: np.random.Generator) -> int:
    """Continue until there is a wall, then choose any action that moves."""
    return last if world.legal[here, last] else legal_random(world, here, last, rng)


def wall_follower(world: World, here: int, last: int, rng: np.random.Generator) -> int:
    """Keep the right hand on the wall."""
    for turn in (1, 0, 3, 2):  # right, ahead, left, back
        action = int(COMPASS[(CLOCKWISE[last] + turn) % len(ACTIONS)])
        if world.legal[here, action]:
            return action
    return last


def wander(
    world: World, walker: Walker, begin: Cell, steps: int, rng: np.random.Generator
) -> Trajectory:
    """Return the trajectory of `steps` actions of `walker`."""
    bounded("steps", steps, 0, MOST)
    here, actions, last = world.number(begin), [], int(rng.integers(len(ACTIONS)))
    for _ in range(steps):
        last = walker(world, here, last, rng)
        actions.append(last)
        here = int(world.after[here, last])
    return world.walk(begin, actions)


def erring(goal: Cell, eps: float) -> Walker:
    """Return an agent for `goal` that takes any action with probability `eps`."""
    finite("eps", eps, 0, 1)

    def walker(world: World, here: int, last: int, rng: np.random.Generator) -> int:
        steps = world.distance[:, world.number(goal)]
        best = np.flatnonzero(steps[world.after[here]] == steps[here] - 1)
        greedy = len(best) and rng.random() >= eps
        return int(rng.choice(best)) if greedy else int(rng.integers(len(ACTIONS)))

    return walker
