"""Fields: an agent's policy and value at every place of a level.

    (before,) = fields(agent, "anywhere-small", {"mine": level})
    (after,) = fields(agent, "anywhere-small", {"mine": level.moved("goal", (5, 1))})
    change = difference(before, after)
    before.table()  # a row for each place

Fields of other agents, or of a steered one, are compared in the same way. `field_figures` draws
them.
"""

import functools
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl

from astray import games
from astray.acting import Levels, initial_states
from astray.analysis.critic import ask
from astray.analysis.trained import Model, Opaque
from astray.envs.beginnings import beginnings
from astray.game import Game, Variant
from astray.insight.actions import effects, outcomes
from astray.level import EMPTY, Cell, Level
from astray.record import trusted
from astray.validation import check_cell, of_kind, shown

AT_ONCE = 2048  # states; CoinRun's take 17 kB each


@dataclass(frozen=True, eq=False)
class Places:
    """The K possible places of an agent in a level, and the results of its actions there.

    Attributes:
        centres: [K, 2] float64, agent's centre in each place, in cells from the lower left.
        after: [K, A, 2] float64, agent's centre after each action.
    """

    level: Level
    centres: np.ndarray
    after: np.ndarray

    @functools.cached_property
    def cells(self) -> np.ndarray:
        """[K, 2] int64, (x, y) from the lower left."""
        return np.floor(self.centres).astype(np.int64)

    @functools.cached_property
    def number(self) -> Mapping[Cell, int]:
        """Index of each cell's place."""
        return {(x, y): k for k, (x, y) in enumerate(self.cells.tolist())}

    @functools.cached_property
    def same(self) -> np.ndarray:
        """[K, A] first action that is equivalent to each: see `effects`."""
        return effects(self.level.game, self.level.variant, splay(self.level))

    @functools.cached_property
    def leads(self) -> list[list[Cell]]:
        """[K][A] cell after each action."""
        return [[(x, y) for x, y in row] for row in np.floor(self.after).astype(int).tolist()]

    def distances(self, to: Cell) -> dict[Cell, int]:
        """Return the steps to the cell `to` from each place with a way to it."""
        to = check_cell(to)
        before: dict[Cell, set[Cell]] = {}
        for here, ways in zip(self.number, self.leads, strict=True):
            for there in ways:
                before.setdefault(there, set()).add(here)
        found, queue = {to: 0}, deque([to])
        while queue:
            there = queue.popleft()
            for here in before.get(there, set()) - found.keys():
                found[here] = found[there] + 1
                queue.append(here)
        return found

    def chance(self, policy: np.ndarray, here: Cell, there: Cell) -> float:
        """Return the probability of a step from one cell to another, of a policy [A] there."""
        leads = self.leads[self.number[here]]
        return float(sum(p for p, cell in zip(policy, leads, strict=True) if cell == there))

    def advancing(self, to: Cell) -> np.ndarray:
        """Return [K, A] bool, the actions along a shortest way to the cell `to`.

        There is none in that cell or without a way.
        """
        away = self.distances(to)
        return np.array(
            [
                [away.get(here, 0) > 0 and away.get(there) == away[here] - 1 for there in ways]
                for here, ways in zip(self.number, self.leads, strict=True)
            ]
        )

    def way(self, to: Cell, start: Cell | None = None) -> list[Cell]:
        """Return the cells of a shortest way from `start` to `to`; empty without a way.

        Among equally short ways the one whose cells come first is returned.

        Args:
            start: None for the beginning of the level.
        """
        here = self.level.agent if start is None else check_cell(start)
        away = self.distances(to)
        if here not in away or here not in self.number:
            return []
        found = [here]
        while here != to:
            ways = self.leads[self.number[here]]
            here = min(there for there in ways if away.get(there, -1) == away[here] - 1)
            found.append(here)
        return found


@dataclass(frozen=True, eq=False)
class Field:
    """Policy and value of an agent at all K places of a level.

    Attributes:
        policy: [K, A] float64, action probabilities.
        value: [K] float64.
    """

    places: Places
    policy: np.ndarray
    value: np.ndarray

    @property
    def level(self) -> Level:
        return self.places.level

    @property
    def cells(self) -> np.ndarray:
        """[K, 2] int64, (x, y) from the lower left."""
        return self.places.cells

    @functools.cached_property
    def arrows(self) -> np.ndarray:
        """[K, 2] expected step in cells: the mean over actions of their displacement."""
        moved = self.places.after - self.places.centres[:, None]
        return np.einsum("ka,kad->kd", self.policy, moved)

    def towards(self, to: Cell) -> np.ndarray:
        """Return [K], the probability of a step along a shortest way to `to`; NaN without one."""
        away = self.places.distances(to)
        there = [away.get(cell, 0) > 0 for cell in self.places.number]
        chance = (self.policy * self.places.advancing(to)).sum(1)
        return np.where(there, chance, np.nan)

    def step(self, here: Cell, there: Cell) -> float:
        """Return the probability that the next step leads from one cell to the other.

        Raises:
            ValueError: If the agent cannot be in the first cell.
        """
        if check_cell(here) not in self.places.number:
            raise ValueError(f"here must be a place of the field; got {shown(here)}")
        return self.places.chance(self.policy[self.places.number[here]], here, there)

    def path_probability(self, start: Cell | None = None) -> dict[Cell, float]:
        """Return the preference for the way to each cell, from 0 to 1 (at the start).

        It is the geometric mean of the step probabilities along a shortest way from `start`; None
        starts at the beginning of the level.

        Raises:
            ValueError: If the agent cannot be at the start.
        """
        start = self.level.agent if start is None else check_cell(start)
        number, leads = self.places.number, self.places.leads
        if start not in number:
            raise ValueError(f"start must be a place of the field; got {shown(start)}")
        found, queue = {start: (0.0, 0)}, deque([start])
        while queue:
            here = queue.popleft()
            log, count = found[here]
            for there in sorted(set(leads[number[here]]) if here in number else ()):
                if there not in found:
                    chance = max(self.step(here, there), np.finfo(float).tiny)
                    found[there] = (log + np.log(chance), count + 1)
                    queue.append(there)
        return {cell: float(np.exp(log / max(n, 1))) for cell, (log, n) in found.items()}

    def table(self) -> pl.DataFrame:
        """Return a row per place.

        Columns: x, y, dx and dy (the arrow), value, path (its probability from the start), and the
        probability of each action under its name.
        """
        ways = self.path_probability()
        path = [ways.get(cell) for cell in self.places.number]
        actions = {name: self.policy[:, k] for k, name in enumerate(self.level.game.actions)}
        return _table(self, {"value": self.value, "path": path} | actions)


@dataclass(frozen=True, eq=False)
class Change:
    """Difference of two fields at their common places.

    Attributes:
        cells: [K, 2] int64.
        value: [K] float64, second minus first.
        arrows: [K, 2] float64, second minus first.
        policy: [K] float64, total variation distance (0 to 1); actions that are equivalent in both
            count as one.
    """

    level: Level  # the second's
    cells: np.ndarray
    value: np.ndarray
    arrows: np.ndarray
    policy: np.ndarray

    def table(self) -> pl.DataFrame:
        """Return a row per place with the changes: x, y, value, policy, dx, dy."""
        return _table(self, {"value": self.value, "policy": self.policy})


def _table(field: Field | Change, columns: Mapping[str, object]) -> pl.DataFrame:
    (x, y), (dx, dy) = field.cells.T, field.arrows.T
    return pl.DataFrame({"x": x, "y": y, "dx": dx, "dy": dy, **columns})


def difference(one: Field, other: Field) -> Change:
    """Return the change from `one` to `other`: of levels, agents, or an intervention.

    Raises:
        ValueError: If they have no common place, or agents with different actions.
    """
    for field in (one, other):
        of_kind("a field", field, Field)
    if one.policy.shape[1] != other.policy.shape[1]:
        raise ValueError(
            f"fields must be of the same actions; got {one.policy.shape[1]} and "
            f"{other.policy.shape[1]}"
        )
    places = one.places.number
    both = [(places[cell], k) for cell, k in other.places.number.items() if cell in places]
    if not both:
        raise ValueError("fields must have places in common; these have none")
    first, second = np.array(both).T
    effect = one.places.same[first] * one.policy.shape[1] + other.places.same[second]
    alike = (effect[:, :, None] == effect[:, None, :]).argmax(2)  # the first action of that effect
    change = np.zeros(alike.shape)
    moved = other.policy[second] - one.policy[first]
    np.add.at(change, (np.arange(len(alike))[:, None], alike), moved)
    return Change(
        other.level,
        other.cells[second],
        other.value[second] - one.value[first],
        other.arrows[second] - one.arrows[first],
        abs(change).sum(1) / 2,
    )


def splay(level: Level) -> np.ndarray:
    """Return the states [K] of a level with the agent in every possible place.

    Places are ordered as in `Level.splay("agent")`, lowest row first.
    """
    of_kind("level", level, Level)
    begun = level.state(solvable=False)
    return _put(level.game, begun, np.argwhere(level.game.places.stand(begun))[:, ::-1])


def states_at(level: Level, cells: Sequence[Cell]) -> np.ndarray:
    """Return the initial states [K] of a level with the agent in each of some cells."""
    of_kind("level", level, Level)
    return _put(level.game, level.state(solvable=False), np.array(cells).reshape(-1, 2))


def _put(game: Game, s: Any, cells: np.ndarray) -> np.ndarray:
    """Return copies of `s` with the agent in each of cells [K, 2]."""
    return game.places.put(np.repeat(np.array([s], game.state), len(cells)), cells)


def fields(
    agent: Model | Opaque, variant: str | Variant, levels: Levels, *, led: bool = False
) -> list[Field]:
    """Return the fields of an agent in `levels`, in order.

    Args:
        levels: Level numbers, or drawn levels by name.
        led: Whether an agent with memory remembers a shortest way to each place, seen with nothing
            taken. Otherwise, and without a way, it is asked as at the beginning of an episode.

    Raises:
        ValueError: If the game has no `places`, or the levels do not fit the agent.
    """
    return list(each_field(agent, variant, levels, led=led))


def each_field(
    agent: Model | Opaque, variant: str | Variant, levels: Levels, *, led: bool = False
) -> Iterator[Field]:
    """Yield the fields one by one, with constant memory; arguments as in `fields`."""
    of_kind("agent", agent, Model | Opaque)
    game = games.find(agent.game)  # pyrefly: ignore
    variant = game.variant(variant)
    for some in _batches(game, variant, levels):
        places, states = places_of(some)
        if led and agent.caveat:
            both = zip(places, states, strict=True)
            yield from (Field(one, *_led(agent, variant, one, there)) for one, there in both)
            continue
        policy, value = ask(agent, variant, np.concatenate(states))
        yield from map(Field, places, _apart(policy, states), _apart(value, states))


def _led(
    agent: Model | Opaque, variant: Variant, places: Places, states: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the policy [K, A] and values [K] of an agent that was led to each of K places."""
    number = places.number
    ways = ([number[c] for c in places.way(cell)] or [k] for cell, k in number.items())
    told = [ask(agent, variant, states[way], episode=True) for way in ways]
    return np.array([policy[-1] for policy, _ in told]), np.array([value[-1] for _, value in told])


def _batches(game: Game, variant: Variant, levels: Levels) -> Iterator[list[Level]]:
    """Yield batches of levels with about AT_ONCE places each."""
    waiting: list[Level] = []
    room = 0
    for level in drawn(game, variant, levels):
        waiting.append(level)
        room += np.count_nonzero(level.cells == game.editing.LEGEND[EMPTY])
        if room >= AT_ONCE:
            yield waiting
            waiting, room = [], 0
    if waiting:
        yield waiting


def places_of(levels: Sequence[Level]) -> tuple[list[Places], list[np.ndarray]]:
    """Return the places of levels, at least one, of one variant, and for each its states [K]."""
    splayed = [splay(level) for level in levels]
    states = np.concatenate(splayed)
    after = outcomes(levels[0].game, levels[0].variant, states)
    centres = levels[0].game.places.centre(states)
    return [*map(Places, levels, _apart(centres, splayed), _apart(after, splayed))], splayed


def _apart(joined: np.ndarray, parts: Sequence[np.ndarray]) -> list[np.ndarray]:
    """Split an array again whose rows belong to `parts`, one after another."""
    return np.split(joined, np.cumsum([len(part) for part in parts])[:-1])


def drawn(game: Game, variant: Variant, levels: Levels) -> Iterator[Level]:
    """Yield the levels as data."""
    if isinstance(levels, Mapping):
        beginnings(levels, game.state)  # which checks them
        yield from levels.values()
        return
    states = initial_states(game, variant, levels)
    game.check(states, variant)
    for s in trusted(states):
        yield Level.of(game, variant, s)


def cell_of(level: Level, goal: str) -> Cell | None:
    """Return the cell of a goal of the level's game, such as the cheese; None if it is absent.

    Raises:
        ValueError: If the game has no such goal, or no `cells`.
    """
    return level.game.cells.target(level.state(solvable=False), goal)
