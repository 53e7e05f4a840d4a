"""Steering vectors: mean activation differences, with and without an object or between sets.

    cheese = object_vectors(agent, "anywhere-easy", range(200), "block2.residual1")
    with steer(agent, {cheese.layer: cheese.mean}, -1.0): ...

`effects` measures steering by such vectors, compared with random vectors of the same length.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import polars as pl

from astray import games
from astray.acting import Levels
from astray.analysis.critic import observe, policy_and_value
from astray.analysis.trained import Model, check_network
from astray.game import Variant
from astray.insight.activations import activations
from astray.insight.fields import Places, cell_of, drawn, places_of
from astray.insight.interventions import steer
from astray.level import Cell, Level
from astray.record import count_levels
from astray.validation import MOST, bounded, check_cell, finite, of_kind, shown

Edit = Callable[[Level], Level]


@dataclass(frozen=True, eq=False)
class Vectors:
    """Activation differences of a layer for N pairs of states.

    Attributes:
        each: [N, ...] float32.
    """

    layer: str
    each: np.ndarray

    @functools.cached_property
    def mean(self) -> np.ndarray:
        """Mean vector over the pairs, [...]."""
        return self.each.mean(0)

    @property
    def norms(self) -> np.ndarray:
        """Lengths of the vectors, [N]."""
        return np.linalg.norm(self._flat, axis=1)

    @property
    def cosines(self) -> np.ndarray:
        """Cosines between the vectors, [N, N]; 0 for a vector of length 0."""
        lengths = np.maximum(self.norms, np.finfo(np.float32).tiny)
        unit = self._flat / lengths[:, None]
        return unit @ unit.T

    @property
    def _flat(self) -> np.ndarray:
        return self.each.reshape(len(self.each), -1).astype(np.float64)

    def alike(self) -> float:
        """Return the mean cosine between different vectors: 1 if all directions are equal."""
        n = len(self.each)
        if n < 2:
            return np.nan
        return float((self.cosines.sum() - np.trace(self.cosines)) / (n * (n - 1)))

    def random(self, seed: int) -> Vectors:
        """Return vectors of the same lengths in uniformly random directions."""
        bounded("seed", seed, 0, MOST)
        drawn_at = np.random.default_rng(seed).normal(size=self._flat.shape)
        drawn_at *= (self.norms / np.linalg.norm(drawn_at, axis=1))[:, None]
        return Vectors(self.layer, drawn_at.reshape(self.each.shape).astype(np.float32))


def pair_vectors(
    agent: Model, variant: str | Variant, layer: str, states: np.ndarray, others: np.ndarray
) -> Vectors:
    """Return activations of `layer` in each of `states` [N] minus those in `others` [N].

    Raises:
        ValueError: If the numbers of states differ, or a state or layer is invalid.
    """
    if np.shape(states) != np.shape(others):
        raise ValueError(f"states must be pairs; got {np.shape(states)} and {np.shape(others)}")
    one, other = (_of(agent, variant, layer, some) for some in (states, others))
    return Vectors(layer, one - other)


def set_vector(
    agent: Model, variant: str | Variant, layer: str, states: np.ndarray, others: np.ndarray
) -> Vectors:
    """Return the difference [...] of mean activations of `layer` between sets of states [N]."""
    one, other = (_of(agent, variant, layer, some).mean(0) for some in (states, others))
    return Vectors(layer, (one - other)[None])


def _of(agent: Model, variant: str | Variant, layer: str, states: np.ndarray) -> np.ndarray:
    return activations(agent, observe(agent, variant, states), [layer])[layer]


def object_vectors(
    agent: Model, variant: str | Variant, levels: Levels, layer: str, name: str = "goal"
) -> Vectors:
    """Return activation differences at the beginning of levels: with minus without an object.

    Maze's cheese is its "goal".

    Raises:
        ValueError: If a level has no such object, or several.
    """
    return edit_vectors(agent, variant, levels, layer, lambda level: level.removed(name))


def edit_vectors(
    agent: Model,
    variant: str | Variant,
    levels: Levels,
    layer: str,
    edit: Edit,
    first: Edit | None = None,
) -> Vectors:
    """Return each level's activations, `first` applied, minus those with `edit` applied.

    Raises:
        ValueError: If `edit` is not a function of levels.
    """
    check_network(agent)
    for function in (edit, first):
        if function is not None and not callable(function):
            raise ValueError(f"an edit must be a function of levels; got {shown(function)}")
    game = games.find(agent.game)  # pyrefly: ignore
    whole = list(drawn(game, game.variant(variant), levels))
    pairs = [
        np.array([made.state(solvable=False) for made in map(make, whole)], game.state)
        for make in (first or (lambda level: level), edit)
    ]
    return pair_vectors(agent, variant, layer, *pairs)


@dataclass(frozen=True, eq=False)
class Condition:
    """Change of agent or levels, for `effects`.

    Attributes:
        vectors: Vectors to add to their layer's output: one per level, or the mean of all. Those
            of one layer add up.
    """

    vectors: Sequence[Vectors] = ()
    coefficient: float = 1.0
    own: bool = True  # each level is steered by its own vector; else all by the mean
    edit: Edit = field(default=lambda level: level)

    def __post_init__(self) -> None:
        of_kind("vectors", self.vectors, Sequence)
        for one in self.vectors:
            of_kind("each of the vectors", one, Vectors)
        finite("coefficient", self.coefficient)
        of_kind("own", self.own, bool)
        of_kind("edit", self.edit, Callable)


def effects(
    agent: Model,
    variant: str | Variant,
    levels: Levels,
    goal: str,
    conditions: Mapping[str, Condition],
    *,
    places: int = 16,
    at: Callable[[Any], Cell | None] | None = None,
    seed: int = 0,
) -> pl.DataFrame:
    """Return the probability of a step towards `goal` in each level under each condition.

    Columns: level (index in `levels`), condition, towards (mean over places of the probability of
    a step along a shortest way to the goal's place in the unedited level), start (that at the
    beginning), at (that at the further place, or null), value (mean over places), places. Levels
    without the goal, or that begin at it, are left out. `estimates.group_means` gives means with
    intervals.

    Args:
        places: Places per level: its beginning, then random ones drawn with `seed`. Multiples of
            16 are fastest for networks that see images.
        at: Function from a level's initial state to one more place, such as the decision square,
            or None.

    Raises:
        ValueError: If an argument is invalid.
    """
    check_network(agent)
    count = count_levels(levels)
    of_kind("conditions", conditions, Mapping)
    for condition in conditions.values():
        of_kind("a condition", condition, Condition)
        least = min((len(v.each) for v in condition.vectors if condition.own), default=count)
        if least < count:
            raise ValueError(f"own vectors must be one for each of {count} levels; got {least}")
    bounded("places", places, 1, MOST)
    game = games.find(agent.game)  # pyrefly: ignore
    variant = game.variant(variant)
    rows = []
    for k, level in enumerate(drawn(game, variant, levels)):
        to = cell_of(level, goal)
        if to is None or to == level.agent:
            continue
        (around,), _ = places_of([level])
        if level.agent not in around.distances(to):
            continue
        extra = at(level.state(solvable=False)) if at else None
        if extra is not None and (extra := check_cell(extra)) not in around.number:
            raise ValueError(f"at must return a place of the agent in level {k}; got {extra}")
        count = places - (extra is not None)
        some = _some(around, to, count, np.random.default_rng([seed, k]))
        looked_at = [*some, *([] if extra is None else [extra])]
        shown: dict[Edit, tuple[np.ndarray, np.ndarray]] = {}
        for name, condition in conditions.items():
            if condition.edit not in shown:
                shown[condition.edit] = _seen(agent, variant, condition.edit(level), looked_at, to)
            observations, advancing = shown[condition.edit]
            with ExitStack() as stack:
                for v in condition.vectors:
                    vector = v.each[k] if condition.own else v.mean
                    stack.enter_context(steer(agent, {v.layer: vector}, condition.coefficient))
                policy, value = policy_and_value(agent, observations)
            chance = (policy * advancing).sum(1)
            n = len(some)
            rows.append(
                {
                    "level": k,
                    "condition": name,
                    "towards": chance[:n].mean(),
                    "start": chance[0],
                    "at": None if extra is None else chance[n],
                    "value": value[:n].mean(),
                    "places": n,
                }
            )
    if not rows:
        raise ValueError(f"no level has a way from its beginning to the goal {goal!r}")
    return pl.DataFrame(rows, schema_overrides={"at": pl.Float64})


def _some(around: Places, to: Cell, count: int, random: np.random.Generator) -> list[Cell]:
    """Return the beginning of a level and other random places with a way."""
    away = around.distances(to)
    others = [c for c in around.number if away.get(c, 0) > 0 and c != around.level.agent]
    drawn_at = random.permutation(len(others))[: max(count - 1, 0)]
    return [around.level.agent, *(others[k] for k in sorted(drawn_at))]


def _seen(
    agent: Model, variant: Variant, level: Level, cells: Sequence[Cell], to: Cell
) -> tuple[np.ndarray, np.ndarray]:
    """Return the observations at some places of a level, and the actions towards a cell."""
    (around,), (states,) = places_of([level])
    which = [around.number[cell] for cell in cells]
    return observe(agent, variant, states[which]), around.advancing(to)[which]
