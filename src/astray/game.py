"""What a game is. Read this first, then `games/maze/rules.py`."""

from __future__ import annotations

import functools
import math
import reprlib
import typing
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np

from astray.bounds import bounded
from astray.kernel.rng import RNG_FIELDS, WORDS

NEVER = -1  # the step of an event that has not happened; the number of a level that has none
LEVELS = range(2**31 - 1)  # all numbers that there are; the original has no others
OWN = "own"  # the art that is drawn here
MOST = 2**31 - 1  # of a knob, and of what is counted
KINDS = {int: np.int64, float: np.float64, bool: np.bool_}


def state_dtype(*own: tuple) -> np.dtype:
    """The record of one environment: what every game has, then the game's `own` fields.

    A record, so that a state can be copied, compared, saved and edited whole; `np.record`,
    so that `s.x` works compiled and interpreted alike.
    """
    common = [
        ("level", np.int64),  # its number
        ("shifted", np.bool_),  # the level comes from the variant's shifted distribution
        ("time", np.int64),  # steps since the level began
        ("time_limit", np.int64),  # steps
        ("ended", np.bool_),  # the episode is over
        ("seed", np.uint64),  # with `turn`, decides which level comes next
        ("turn", np.int64),  # episodes begun
        *RNG_FIELDS,
    ]
    return _record_dtype([*common, *own])


def _record_dtype(columns: list[tuple]) -> np.dtype:
    """A record of `columns`, aligned and without gaps, whose bytes no copy would keep."""
    taken = [name for name, *_ in columns if hasattr(np.record, name)]
    assert not taken, f"records have attributes of these names already: {taken}"
    columns = sorted(columns, key=lambda column: -np.dtype(column[1]).alignment)
    gap = -np.dtype(columns).itemsize % 8
    if gap:
        columns = [*columns, ("gap", np.uint8, (gap,))]
    return np.dtype((np.record, np.dtype(columns, align=True)))


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A distribution of levels. Each game adds its own knobs: numbers with units, and choices.

    shifted  another distribution of the same game, from which some levels come
    """

    about: str
    time_limit: int  # steps until an episode is truncated
    shift_probability: float = 0.0  # that a level comes from `shifted`
    shifted: Variant | None = None

    def __post_init__(self) -> None:
        self._check_kinds()
        if not 0 <= self.shift_probability <= 1:
            raise ValueError(f"shift_probability is {self.shift_probability}; it is from 0 to 1")
        if self.shift_probability and self.shifted is None:
            raise ValueError("shift_probability needs a `shifted` variant to shift to")
        if self.shifted is not None and type(self.shifted) is not type(self):
            raise ValueError("`shifted` is a variant of another game")
        if self.time_limit < 1:
            raise ValueError(f"time_limit is {self.time_limit}; it is at least 1 step")

    def _check_kinds(self) -> None:
        """See that each knob is what it is declared as: compiled code sees numbers cast to that."""
        for name, kind in knobs(type(self)).items():
            choices, given = typing.get_args(kind), getattr(self, name)
            if choices:
                if given not in choices:
                    raise ValueError(f"unknown {name} {given!r}; there are: {', '.join(choices)}")
            elif kind is bool:
                if not isinstance(given, bool | np.bool_):
                    raise ValueError(f"{name} must be a bool; got {given!r}")
            elif kind is int:
                bounded(name, given, -MOST, MOST)
            elif not isinstance(given, int | float | np.number) or not math.isfinite(given):
                raise ValueError(f"{name} must be a finite number; got {given!r}")

    def records(self) -> np.ndarray:
        """The knobs for compiled code, [2]: of this variant, and of the one it shifts to."""
        kinds = knobs(type(self))
        dtype = _record_dtype([(n, KINDS.get(k, np.int64)) for n, k in kinds.items()])
        records = np.zeros(2, dtype)
        for record, variant in zip(records, (self, self.shifted or self), strict=True):
            for name, kind in kinds.items():
                record[name] = _number(getattr(variant, name), kind)
        return records


@functools.cache
def knobs(variant: type[Variant]) -> Mapping[str, Any]:
    """The fields of a variant that compiled code sees, with their types."""
    hints = typing.get_type_hints(variant)
    return {f.name: hints[f.name] for f in fields(variant) if f.name not in ("about", "shifted")}


def _number(value: Any, kind: Any) -> Any:
    choices = typing.get_args(kind)
    return choices.index(value) if choices else value


@dataclass(frozen=True)
class Shift:
    """A training and a test variant, and the goals that come apart between them."""

    train: str  # variants
    test: str
    intended: str  # goals
    proxies: tuple[str, ...]


@dataclass(frozen=True)
class Looks:
    """How a game is drawn: two compiled functions, and the pictures that they draw with.

    `scene` is the part of an image that does not move, `art` what `art` gives, `image`
    [side, side, 3]; scenes and images are uint8.
    """

    name: str  # that compiled code is kept under; looks of one name have the same functions
    paint: Callable  # (s, art, scene)
    draw: Callable  # (s, art, scene, image)
    art: Callable[[Variant, int], tuple[np.ndarray, ...]]  # (variant, pixels a side of an image)
    scene_shape: Callable[[Variant, int], tuple[int, ...]]  # likewise


@dataclass(frozen=True)
class Game:
    """The rules, levels and looks of one game.

    World coordinates are cells, x to the right, y upward; arrays are indexed [y, x]; only
    drawing flips. `s` is a state, `p` a variant's record, `scene` the part of the symbolic
    observation that does not move. All pictures are uint8.
    """

    name: str
    about: str
    actions: tuple[str, ...]
    state: np.dtype
    variants: Mapping[str, Variant]
    shifts: Mapping[str, Shift]
    events: tuple[str, ...]  # fields of the state: the step each first happened, or NEVER
    goals: Mapping[str, str]  # goal -> the event that it is reached
    benchmark: str  # the variant that speed is measured on,
    envpool: str  # and the environment of EnvPool that is like it
    real_time: bool  # things move while the agent stays; else a person may take time to think

    # Compiled. `generate` is called with a state whose twister is seeded and whose common
    # fields are set.
    generate: Callable  # (s, p): fill `s` with a new level
    step: Callable  # (s, action) -> (reward, terminated)
    paint_planes: Callable  # (s, scene)
    draw_planes: Callable  # (s, scene, planes)

    looks: Mapping[str, Looks]  # by the name of the art; OWN is there always
    planes_scene_shape: Callable[[Variant], tuple[int, ...]]  # of `paint_planes`' scene
    planes: Callable[[Variant], np.ndarray]  # [C, H, W] the largest value of each plane
    facts: Callable[[np.ndarray, Variant], dict[str, np.ndarray]]  # what is true of states [N] of
    # a variant, and compiled code relies on: its name -> [N] bool; see `check`

    # Levels as data; see `level.Level`.
    legend: Mapping[str, int]  # what a cell may hold: its character in drawings -> its code
    objects: Mapping[str, str]  # what may be moved, added, removed: its name -> its character
    describe: Callable[[Any], dict[str, Any]]  # a state's level as plain, JSON-able data: "grid"
    # (codes, rows from the lowest up), "agent" (its centre), "looks" (all else that `build`
    # needs to build it again), and what follows from these
    build: Callable[[np.ndarray, Any, Any, Variant], Any]  # (grid, agent's cell, looks, variant)
    # -> the state that begins there; ValueError where none can
    reachable: Callable[[Any], np.ndarray]  # [H, W] bool, cells that the agent can get to

    # Solved; a goal is one of `goals`.
    guide: Callable[[Any, str], Callable[[Any], int]]  # (s, goal) -> a player: (a state of the
    # same episode) -> the action that leads to the goal; to stay where it was reached or none can
    optimal_return: Callable[[Any, str, float], float]  # (s, goal, gamma)

    def variant(self, name: str | Variant) -> Variant:
        """The variant called `name`; one of your own is itself, if it is of this game."""
        if isinstance(name, Variant):
            if not isinstance(name, tuple({type(v) for v in self.variants.values()})):
                raise ValueError(f"the variant is a {type(name).__name__}, none of {self.name}")
            return name
        if not isinstance(name, str) or name not in self.variants:
            there = ", ".join(self.variants)
            raise ValueError(f"unknown variant {name!r} of {self.name}; there are: {there}")
        return self.variants[name]

    def drawn(self, art: str) -> Looks:
        """How the game looks with the art of that name."""
        if art not in self.looks:
            there = ", ".join(self.looks)
            raise ValueError(f"unknown art {art!r} of {self.name}; there are: {there}")
        return self.looks[art]

    def check(self, states: np.ndarray, variant: Variant) -> None:
        """Raise ValueError if one of states [N] is none of `variant`: compiled code trusts them."""
        if not isinstance(states, np.ndarray) or states.dtype != self.state or states.ndim != 1:
            kind, shape = getattr(states, "dtype", type(states)), np.shape(states)
            raise ValueError(f"states must be [N] records of {self.name}; got {kind} of {shape}")
        s = states.view(np.ndarray)  # a recarray's fields are slow
        facts = {
            "mt_next": within(s["mt_next"], 0, WORDS),
            "turn": s["turn"] >= 0,
            "level": within(s["level"], NEVER, LEVELS.stop),
            "time_limit": s["time_limit"] >= 1,
            "time": (s["time"] >= 0) & (s["time"] <= s["time_limit"]),
        } | {event: (s[event] >= NEVER) & (s[event] <= s["time"]) for event in self.events}
        for name, holds in (facts | self.facts(s, variant)).items():
            if not holds.all():
                i = int(np.argmin(holds))
                raise ValueError(f"state {i} is none of this variant: its {name} cannot be")


def integers(given: Any, name: str) -> np.ndarray:
    """`given` as an array, if it holds integers; ValueError where it does not.

    A float would be cut short in silence, and a boolean be 0 or 1.
    """
    numbers = np.asarray(given)
    several = isinstance(given, Sequence) and not isinstance(given, str | range)
    if numbers.dtype.kind not in "iu" or (several and any(isinstance(x, bool) for x in given)):
        raise ValueError(f"{name} are integers; given {reprlib.repr(given)}")
    return numbers


def level_numbers(given: Any) -> np.ndarray:
    """`given` (a sequence, a range, an array) as numbers of levels, [N] int64, at least one."""
    if not np.size(given):
        raise ValueError("levels are numbers, at least one; none is given")
    numbers = integers(given, "levels")
    if numbers.ndim != 1 or numbers.min() < LEVELS.start or numbers.max() >= LEVELS.stop:
        raise ValueError(
            f"levels are numbers from 0 to {LEVELS.stop - 1}; given {reprlib.repr(given)}"
        )
    return numbers.astype(np.int64)


def within(numbers: np.ndarray, first: int, after: int) -> np.ndarray:
    """Which of `numbers` are from `first` on and before `after`."""
    return (numbers >= first) & (numbers < after)
