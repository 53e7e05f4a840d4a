"""Games, variants and shifts. Read this first, then `protocols.py` and `games/maze/rules.py`."""

from __future__ import annotations

import typing
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal, Self

import numpy as np

from astray import protocols
from astray.imports import guarded
from astray.outcome import COLUMNS, check_ends
from astray.record import check_states
from astray.validation import check_words, finite, of_kind, one_of, shown
from astray.variant import Variant as Variant

OWN = "own"  # name of astray's own art
Mutation = Literal["constant", "identity", "binomial"]  # kind of edits, and how often
MUTATIONS: tuple[Mutation, ...] = typing.get_args(Mutation)
MOST_EDITS = 10_000  # of a level; some 50 ms
ABILITIES = (
    "symbols", "editing", "solver", "mutation", "places", "cells", "sprites", "benchmark"
)  # fmt: skip
PARTS = {
    "rules": protocols.Rules, "levels": protocols.Levels, "symbols": protocols.Symbols,
    "editing": protocols.Editing, "solver": protocols.Solver, "mutation": protocols.Mutating,
    "places": protocols.Places, "cells": protocols.Cells, "sprites": protocols.Sprites,
}  # fmt: skip


@dataclass(frozen=True)
class Never:
    """An event that did not happen by the end of an episode."""

    event: str


@dataclass(frozen=True)
class More:
    """A measure that is larger at the end of an episode than a number or another measure.

    A count is a measure. So is a rate, which divides by the number of steps of the episode.
    """

    measure: str
    than: float | str = 0.0


@dataclass(frozen=True)
class Truncated:
    """An episode that the rules did not end: its time was up, or it was left."""


# A goal or another end of an episode: an event, reached when it first happens, or a condition
# that is known, and reached, only at the end of the episode.
Outcome = str | Never | More | Truncated


@dataclass(frozen=True)
class Shift:
    """A training and a test variant, and the goals that come apart between them.

    Raises:
        ValueError: If the intended goal is one of the proxies.

    Examples:
        >>> astray.Shift("corner", "anywhere", intended="cheese", proxies=("corner",)).test
        'anywhere'
    """

    train: str  # names of variants
    test: str
    intended: str  # names of goals
    proxies: tuple[str, ...]

    def __post_init__(self) -> None:
        if self.intended in self.proxies:
            raise ValueError(f"a proxy must not be the intended goal, {self.intended!r}")


@dataclass(frozen=True)
class Looks:
    """Appearance of a game: two compiled drawing functions and their pictures.

    The scene is the part of an image that does not move. Images are [side, side, 3] uint8, scenes
    are uint8 of `scene_shape`.
    """

    name: str  # key of compiled code; looks of one name have the same functions
    background: Callable  # (s, art, scene)
    foreground: Callable  # (s, art, scene, image)
    art: Callable[[Variant, int], tuple[np.ndarray, ...]]  # (variant, pixels a side of an image)
    scene_shape: Callable[[Variant, int], tuple[int, ...]]  # (variant, pixels)
    check: Callable[[np.ndarray, Variant], None] = lambda states, variant: None
    # raises ValueError if a picture for one of states [N] is missing

    def pictures(self, variant: Variant, pixels: int) -> tuple[np.ndarray, ...]:
        """Return the result of `art`, of the game's own shapes; raise ValueError if it fails."""
        with guarded(f"the art of {self.name!r}", ValueError, MemoryError, OSError):
            return self.art(variant, pixels)


@dataclass(frozen=True)
class Benchmark:
    """The variant on which a game's speed is measured."""

    variant: str
    envpool: str | None = None  # corresponding environment of EnvPool


class Missing:
    """Placeholder for an ability that a game lacks: it is false, and any use raises ValueError."""

    def __init__(self, game: str, ability: str):
        self._said = f"the game {game!r} has no {ability}, which this needs"

    def __bool__(self) -> bool:
        return False

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):  # what Python itself asks for
            raise AttributeError(name)
        raise ValueError(self._said)


def check_names(rules: Any, *more: str) -> None:
    """Raise ValueError unless named parts of a game or World are mappings whose names are texts."""
    for name in ("variants", "goals", "shifts", "ends", "measures", *more):
        of_kind(name, getattr(rules, name), Mapping)
        for one in getattr(rules, name):
            of_kind(f"each name of {name}", one, str)
    if not rules.variants:
        raise ValueError("variants must be at least one; got none")


def check_goals(rules: Any) -> None:
    """Raise ValueError if a goal, an end or a shift of a game or World names what it lacks.

    Events and measures are columns of one table: they differ in name from each other and from its
    other columns. Goals and ends differ in name, too.
    """
    check_ends(rules.ends, rules.goals)
    if taken := {*COLUMNS} & {*rules.events, *rules.measures}:
        named = ", ".join(sorted(taken))
        raise ValueError(f"events or measures of {rules.name} have the names of columns: {named}")
    if both := {*rules.events} & {*rules.measures}:  # columns of one table
        raise ValueError(f"measures must have other names than events; got {', '.join(both)}")
    if both := [end for end, one in rules.ends.items() if rules.goals.get(end, one) != one]:
        raise ValueError(f"ends must have other names than goals; got {', '.join(both)}")
    for outcome in (*rules.goals.values(), *rules.ends.values()):
        match outcome:
            case More(measure, than):
                one_of("measure of a goal", measure, rules.measures)
                if isinstance(than, str):
                    one_of("measure of a goal", than, rules.measures)
                else:
                    finite("what a measure is more than", than)
            case Truncated():
                pass
            case Never(event) | event:
                one_of("event of a goal", event, rules.events)
    for shift in rules.shifts.values():
        of_kind("a shift", shift, Shift)
        for variant in (shift.train, shift.test):
            one_of("variant of a shift", variant, rules.variants)
        for goal in (shift.intended, *shift.proxies):
            one_of("goal of a shift", goal, rules.goals)


@dataclass(frozen=True, eq=False)
class Game:
    """The rules, levels and appearance of one game, and its optional abilities.

    Rules, levels and abilities are modules, or any objects with the same names. The rules, levels,
    looks and variants are required. A missing ability raises an error when it is needed.

    World coordinates are cells, x to the right and y upward. Arrays are indexed [y, x]; only
    drawing flips them. `s` is a state, `p` a variant's record, `scene` the part of an image that
    does not move.

    Raises:
        ValueError: If a part lacks something, or a goal, an end or a shift names what is not there.

    Examples:
        >>> maze = astray.games.find("maze")
        >>> maze.goals["corner"], maze.shifts["corner"].test
        ('reached_corner', 'anywhere')
    """

    name: str
    about: str
    rules: protocols.Rules
    levels: protocols.Levels
    looks: Mapping[str, Looks]  # by name of the art; OWN is required
    variants: Mapping[str, Any]  # name -> a `Variant`, all of one class
    goals: Mapping[str, Outcome]  # goal -> its event, or its condition at the end
    shifts: Mapping[str, Shift]

    symbols: protocols.Symbols = None  # pyrefly: ignore
    editing: protocols.Editing = None  # pyrefly: ignore
    solver: protocols.Solver = None  # pyrefly: ignore
    mutation: protocols.Mutating = None  # pyrefly: ignore
    places: protocols.Places = None  # pyrefly: ignore
    cells: protocols.Cells = None  # pyrefly: ignore
    sprites: protocols.Sprites = None  # pyrefly: ignore
    benchmark: Benchmark = None  # pyrefly: ignore
    ends: Mapping[str, Outcome] = field(default_factory=dict)  # neither goals nor proxies,
    # for instance "died": labels of episodes that reached no goal, instead of failure
    measures: Mapping[str, Callable[[np.ndarray], np.ndarray]] = field(default_factory=dict)
    # counts and rates of an episode: name -> function (final states [N]) -> [N]
    invariants: Callable[[np.ndarray, Any], dict[str, np.ndarray]] = lambda s, variant: {}
    # facts about states [N] of a variant that compiled code relies on: name -> [N] bool
    labels: Mapping[str, Callable[[np.ndarray], np.ndarray]] = field(default_factory=dict)
    # targets for probes: name -> function (states [N]) -> [N]. Booleans and integers are classes,
    # reals are numbers; -1 and NaN mark states without a value. `Classes` gives classes names
    features: Callable[[np.ndarray], dict[str, np.ndarray]] | None = None
    # optional per-level features for predicting behaviour: function (initial states [N]) ->
    # {name: float array [N]}, NaN where undefined
    real_time: bool = False  # things move while the agent stays; otherwise a player may take time

    def __post_init__(self) -> None:
        check_words(self)
        of_kind("benchmark", self.benchmark or None, Benchmark | None)
        for part, kind in PARTS.items():
            given = getattr(self, part)
            if part not in ABILITIES or not isinstance(given, Missing | None):
                lacks = [n for n in vars(kind) if not n.startswith("_") and not hasattr(given, n)]
                if lacks:
                    raise ValueError(
                        f"{part} of the game {self.name!r} must have {', '.join(lacks)}, as "
                        f"astray.protocols.{kind.__name__} says; got {shown(given)}"
                    )
        check_names(self, "looks", "labels")
        for art, one in self.looks.items():  # code is compiled under the name alone
            of_kind("looks", one, Looks)
            same = self.looks.get(one.name)
            if not same or (same.background, same.foreground) != (one.background, one.foreground):
                raise ValueError(
                    f"the looks {art!r} of the game {self.name!r} must be named so, or after looks "
                    f"with the same functions; got {shown(one.name)}"
                )
        check_goals(self)
        for ability in ABILITIES:
            if getattr(self, ability) is None:
                object.__setattr__(self, ability, Missing(self.name, ability))

    def __deepcopy__(self, memo: Any) -> Self:
        return self  # nothing in a game changes

    def __reduce__(self) -> Any:
        raise TypeError(
            f"a game goes to another process by its name alone; {self.name!r} must be registered "
            "there: astray.register"
        )

    @property
    def actions(self) -> tuple[str, ...]:
        return self.rules.ACTIONS

    @property
    def state(self) -> np.dtype:
        return self.rules.STATE

    @property
    def events(self) -> tuple[str, ...]:
        return self.rules.EVENTS

    @property
    def event_goals(self) -> dict[str, str]:
        """The goals that are events, without those that are known only at an episode's end."""
        return {goal: event for goal, event in self.goals.items() if isinstance(event, str)}

    @property
    def walked(self) -> tuple[str, ...]:
        """The goals that scripted policies walk to, for base rates."""
        return tuple(self.event_goals) if self.solver else ()

    @property
    def of_states(self) -> Mapping[str, Callable[[np.ndarray], np.ndarray]]:
        """The measures, as functions of the states [N] that episodes ended in."""
        return self.measures

    def event(self, goal: str) -> str:
        """Return the event by which a goal is reached.

        Raises:
            ValueError: If the game has no such goal, or it is not an event.
        """
        if goal not in self.event_goals:
            there = ", ".join(self.event_goals)
            raise ValueError(
                f"a goal that is an event of {self.name} is needed; got {shown(goal)}; there are: "
                f"{there}"
            )
        return self.event_goals[goal]

    def variant(self, name: str | Variant) -> Variant:
        """Return the variant called `name`; a `Variant` of this game is returned unchanged.

        Raises:
            ValueError: If there is none.
        """
        if isinstance(name, Variant):
            if not isinstance(name, tuple({type(v) for v in self.variants.values()})):
                raise ValueError(f"the variant is a {type(name).__name__}, not one of {self.name}")
            return name
        one_of("variant", name, self.variants, of=self.name)
        return self.variants[name]

    def drawn(self, art: str, variant: Variant | None = None) -> Looks:
        """Return the appearance with the art of that name; check the pictures for a `variant`.

        Raises:
            ValueError: If the game has no such art.
        """
        one_of("art", art, self.looks, of=self.name)
        if variant is not None and art != OWN:
            self.looks[art].pictures(variant, 64)
        return self.looks[art]

    def check(self, states: np.ndarray, variant: Variant, art: str = OWN) -> None:
        """Check that states [N] are valid, because compiled code does not check them.

        Raises:
            ValueError: If a state is not one of `variant`, or cannot be drawn with `art`.
        """
        check_states(states, self.name, self.rules, lambda s: self.invariants(s, variant))
        self.drawn(art).check(states, variant)
