"""The record that holds one environment's state, and its validity checks."""

import reprlib
from collections.abc import Callable, Mapping, Sequence
from typing import Any
from weakref import WeakValueDictionary

import numpy as np

from astray.kernel.jit import kernel
from astray.kernel.rng import RNG_FIELDS, WORDS
from astray.protocols import Rules
from astray.validation import MOST, integers

NEVER = -1  # step of an event that has not happened; number of a level without one
LEVELS = range(2**31 - 1)  # all level numbers, as in the original
_TRUSTED: WeakValueDictionary[int, np.ndarray] = WeakValueDictionary()  # by their id


def state_dtype(*own: tuple, events: Sequence[str] = ()) -> np.dtype:
    """Return the dtype of a game's states: the common fields, the game's `own`, and its events.

    A record can be copied, compared, saved and edited as a whole. With `np.record`, `s.x` works in
    compiled and interpreted code alike.
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
    return record_dtype([*common, *own, *((event, np.int64) for event in events)])


def record_dtype(columns: list[tuple]) -> np.dtype:
    """Return an aligned record dtype without gaps; raise ValueError for a name that is reserved."""
    names = [name for name, *_ in columns]
    taken = [n for n in names if not n or names.count(n) > 1 or hasattr(np.record, n)]
    if taken:
        raise ValueError(f"fields, events and measures need other names than {sorted({*taken})}")
    columns = sorted(columns, key=lambda column: -np.dtype(column[1]).alignment)
    gap = -np.dtype(columns).itemsize % 8  # copies do not preserve its bytes
    if gap:
        columns = [*columns, ("gap", np.uint8, (gap,))]
    return np.dtype((np.record, np.dtype(columns, align=True)))


def fresh(rules: Rules) -> np.ndarray:
    """Return a state [1] of zeros, in which no event has happened."""
    states = np.zeros(1, rules.STATE)
    for event in rules.EVENTS:
        states[event] = NEVER
    return states


COMMON = frozenset(state_dtype().names or ())  # fields that the states of all games have


def check_states(
    states: Any, game: str, rules: Rules, truths: Callable[[np.ndarray], dict]
) -> None:
    """Check that every state [N] is valid under `rules` and satisfies all invariants.

    Args:
        truths: Function of states [N] that returns invariants as `Game.invariants` does.

    Raises:
        ValueError: If a state is invalid; the message names the state and the field.
    """
    if not isinstance(states, np.ndarray) or states.dtype != rules.STATE or states.ndim != 1:
        kind, shape = getattr(states, "dtype", type(states)), np.shape(states)
        raise ValueError(f"states must be [N] records of {game}; got {kind} of {shape}")
    s = states.view(np.ndarray)  # a recarray's fields are slow
    for name, holds in (_always(s, rules.EVENTS) | truths(s)).items():
        if not holds.all():
            i = int(np.argmin(holds))
            raise ValueError(f"state {i} is invalid for this variant: its {name} cannot be")


def check_record(s: Any, rules: Rules, truths: Callable[[np.ndarray], dict]) -> None:
    """Check that `s` is a valid record before a solver's compiled code, which trusts it, sees it.

    Records of `trusted` states are not checked again, because a check takes 1 ms.

    Args:
        truths: Function of states [N] of any variant that returns invariants as `Game.invariants`
            does.

    Raises:
        ValueError: If the record is invalid.
    """
    if not isinstance(s, np.void) or s.dtype != rules.STATE:
        raise ValueError(f"a state must be a record of this game; got {reprlib.repr(s)}")
    if is_trusted(s):
        return
    states = np.array([s], rules.STATE).view(np.ndarray)
    for name, holds in (_always(states, rules.EVENTS) | truths(states)).items():
        if not holds.all():
            raise ValueError(f"the state is invalid for this game: its {name} cannot be")


def trusted(states: np.ndarray) -> np.recarray:
    """Return a read-only view of states [N] that were checked or written by the rules alone.

    Args:
        states: Array that the caller must not change afterwards.
    """
    whole = _whole(states)
    _TRUSTED[id(whole)] = whole
    shown = states.view(np.recarray)
    shown.setflags(write=False)
    return shown


def is_trusted(s: np.void) -> bool:
    """Return whether `s` is a record of `trusted` states.

    A read-only record is not enough: files and bytes give read-only records with any contents.
    """
    whole = _whole(s)
    return not s.flags.writeable and _TRUSTED.get(id(whole)) is whole


def _whole(part: np.ndarray | np.void) -> Any:
    """Return the array that an array or a record is a view of."""
    while isinstance(part.base, np.ndarray):
        part = part.base
    return part


def _always(s: np.ndarray, events: Sequence[str]) -> dict[str, np.ndarray]:
    """Return the invariants of all games for states [N]: name -> [N] bool."""
    return {
        "mt_next": within(s["mt_next"], 0, WORDS),
        "turn": s["turn"] >= 0,
        "level": within(s["level"], NEVER, LEVELS.stop),
        "time_limit": within(s["time_limit"], 1, MOST + 1),
        "time": (s["time"] >= 0) & (s["time"] <= s["time_limit"]),
    } | {event: (s[event] >= NEVER) & (s[event] <= s["time"]) for event in events}


def level_numbers(given: Any) -> np.ndarray:
    """Return a sequence, range or array as level numbers, [N] int64 with N at least 1.

    Raises:
        ValueError: If it is empty, or not made of level numbers.
    """
    numbers = integers(given, "levels")
    if not numbers.size:
        raise ValueError("levels are numbers, at least one; none is given")
    wrong = numbers[(numbers < LEVELS.start) | (numbers >= LEVELS.stop)]
    if numbers.ndim != 1 or wrong.size:
        got = wrong[0] if wrong.size else reprlib.repr(given)
        raise ValueError(f"levels must be numbers from 0 to {LEVELS.stop - 1}; got {got}")
    return numbers.astype(np.int64)


def count_levels(levels: Any) -> int:
    """Return the number of `levels`, numbers or drawn ones by name.

    Raises:
        ValueError: If there are none, the numbers are not of levels, or one is given twice.
    """
    numbers = level_numbers(range(len(levels)) if isinstance(levels, Mapping) else levels)
    known, counts = np.unique(numbers, return_counts=True)
    if counts.max() > 1:  # intervals would count it as several
        raise ValueError(f"level {known[counts.argmax()]} is given {counts.max()} times")
    return len(known)


@kernel
def first(s, event, happens=True):
    """Return the step at which an event first happened, which is now if it `happens` only now."""
    return s.time if happens and event == NEVER else event


def centre(s: Any) -> list[float]:
    """Return the agent's x and y in a state that has fields of these names."""
    return [float(s.x), float(s.y)]


def within(numbers: np.ndarray, first: int | np.ndarray, after: int | np.ndarray) -> np.ndarray:
    """Return a mask [...] of the `numbers` [...] from `first` [...] to below `after` [...]."""
    return (numbers >= first) & (numbers < after)
