"""The record of one environment: what all games' have, and what compiled code trusts of it."""

from __future__ import annotations

import reprlib
from collections.abc import Callable, Sequence
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from astray.bounds import MOST, array_of, integers
from astray.kernel.rng import RNG_FIELDS, WORDS
from astray.protocols import Rules

NEVER = -1  # the step of an event that has not happened; the number of a level that has none
LEVELS = range(2**31 - 1)  # all numbers that there are; the original has no others
_TRUSTED: WeakValueDictionary[int, np.ndarray] = WeakValueDictionary()  # by their id


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
    return record_dtype([*common, *own])


def record_dtype(columns: list[tuple]) -> np.dtype:
    """A record of `columns`, aligned and without gaps, whose bytes no copy would keep."""
    taken = [name for name, *_ in columns if hasattr(np.record, name)]
    assert not taken, f"records have attributes of these names already: {taken}"
    columns = sorted(columns, key=lambda column: -np.dtype(column[1]).alignment)
    gap = -np.dtype(columns).itemsize % 8
    if gap:
        columns = [*columns, ("gap", np.uint8, (gap,))]
    return np.dtype((np.record, np.dtype(columns, align=True)))


COMMON = frozenset(state_dtype().names or ())  # fields that the states of all games have


def check_states(
    states: Any, game: str, rules: Rules, truths: Callable[[np.ndarray], dict]
) -> None:
    """Raise ValueError if one of states [N] is none that `rules` play, or of which not all is true.

    truths  of states [N], as `Game.invariants` tells them
    """
    if not isinstance(states, np.ndarray) or states.dtype != rules.STATE or states.ndim != 1:
        kind, shape = getattr(states, "dtype", type(states)), np.shape(states)
        raise ValueError(f"states must be [N] records of {game}; got {kind} of {shape}")
    s = states.view(np.ndarray)  # a recarray's fields are slow
    for name, holds in (_always(s, rules.EVENTS) | truths(s)).items():
        if not holds.all():
            i = int(np.argmin(holds))
            raise ValueError(f"state {i} is none of this variant: its {name} cannot be")


def check_record(s: Any, rules: Rules, truths: Callable[[np.ndarray], dict]) -> None:
    """Raise ValueError if `s` is no record that `rules` play: a solver's compiled code trusts it.

    One of `trusted` states is taken as it is: a check takes 1 ms.

    truths  of states [N] of any variant, as `Game.invariants` tells them of one
    """
    if not isinstance(s, np.void) or s.dtype != rules.STATE:
        raise ValueError(f"a state must be a record of this game; got {reprlib.repr(s)}")
    if is_trusted(s):
        return
    states = np.array([s], rules.STATE).view(np.ndarray)
    for name, holds in (_always(states, rules.EVENTS) | truths(states)).items():
        if not holds.all():
            raise ValueError(f"the state is none of this game: its {name} cannot be")


def trusted(states: np.ndarray) -> np.recarray:
    """A read-only view of states [N] that were checked, or that rules alone write to.

    states  not the caller's to change any more
    """
    whole = _whole(states)
    _TRUSTED[id(whole)] = whole
    shown = states.view(np.recarray)
    shown.setflags(write=False)
    return shown


def is_trusted(s: np.void) -> bool:
    """Whether `s` is a record of `trusted` states.

    Being read-only is not enough: so are records of a file or of bytes, whatever is in them.
    """
    whole = _whole(s)
    return not s.flags.writeable and _TRUSTED.get(id(whole)) is whole


def _whole(part: np.ndarray | np.void) -> Any:
    """The array that an array or a record is part of."""
    while isinstance(part.base, np.ndarray):
        part = part.base
    return part


def _always(s: np.ndarray, events: Sequence[str]) -> dict[str, np.ndarray]:
    """What is true of states [N] of all games: its name -> [N] bool."""
    return {
        "mt_next": within(s["mt_next"], 0, WORDS),
        "turn": s["turn"] >= 0,
        "level": within(s["level"], NEVER, LEVELS.stop),
        "time_limit": within(s["time_limit"], 1, MOST + 1),
        "time": (s["time"] >= 0) & (s["time"] <= s["time_limit"]),
    } | {event: (s[event] >= NEVER) & (s[event] <= s["time"]) for event in events}


def level_numbers(given: Any) -> np.ndarray:
    """`given` (a sequence, a range, an array) as numbers of levels, [N] int64, at least one."""
    if isinstance(given, range) and given:  # which may go on for long
        given = given if given[0] in LEVELS and given[-1] in LEVELS else [given[0], given[-1]]
    if not np.size(array_of(given)):
        raise ValueError("levels are numbers, at least one; none is given")
    numbers = integers(given, "levels")
    if numbers.ndim != 1 or numbers.min() < LEVELS.start or numbers.max() >= LEVELS.stop:
        raise ValueError(
            f"levels must be numbers from 0 to {LEVELS.stop - 1}; got {reprlib.repr(given)}"
        )
    return numbers.astype(np.int64)


def centre(s: Any) -> list[float]:
    """The agent's x and y in a state that has them by these names."""
    return [float(s.x), float(s.y)]


def centres(states: np.ndarray) -> np.ndarray:
    """[N, 2] float64, the centres of the agents in states [N] that have them as x and y."""
    return np.stack([states["x"], states["y"]], -1).astype(np.float64)


def within(numbers: np.ndarray, first: int, after: int | np.ndarray) -> np.ndarray:
    """Which of `numbers` are from `first` on and before `after`."""
    return (numbers >= first) & (numbers < after)
