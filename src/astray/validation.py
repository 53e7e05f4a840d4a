"""Validation of arguments, and safe display of what was given."""

import functools
import itertools
import json
import math
import os
import re
import reprlib
import shlex
import sys
import typing
from collections.abc import Collection, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np

MOST = 2**31 - 1  # of a knob, and of what is counted
AT_ONCE = 10_000_000  # numbers of a range that are written out
NUMBERS = int | float | np.integer | np.floating
UNCOUNTED = bool | np.bool_ | np.timedelta64  # that are integers to Python or numpy
types_of = functools.cache(typing.get_type_hints)  # of fields, whose checks take less time


def bounded(name: str, given: Any, least: float, most: float) -> None:
    """Raise ValueError unless the argument `name` is an integer from `least` to `most`."""
    is_integer = isinstance(given, int | np.integer) and not isinstance(given, UNCOUNTED)
    if not is_integer or not least <= given <= most:
        raise ValueError(f"{name} must be an integer from {least} to {most}; got {shown(given)}")


def finite(name: str, given: Any, least: float = -math.inf, most: float = math.inf) -> None:
    """Raise ValueError unless the argument `name` is a finite number from `least` to `most`."""
    is_number = isinstance(given, NUMBERS) and not isinstance(given, UNCOUNTED)
    if not is_number or not abs(given) <= sys.float_info.max or not least <= given <= most:
        said = f" from {least:g} on" if math.isfinite(least) else ""
        said = f" from {least:g} to {most:g}" if math.isfinite(most - least) else said
        raise ValueError(f"{name} must be a finite number{said}; got {shown(given)}")


def of_kind(name: str, given: Any, kind: Any) -> None:
    """Raise ValueError unless the argument `name` is an instance of `kind`: a class or `A | B`."""
    if not isinstance(given, kind):
        words = " or ".join(k.__name__ for k in getattr(kind, "__args__", (kind,)))
        words = words.replace("Callable", "function").replace("NoneType", "None")
        raise ValueError(f"{name} must be a {words}; got {shown(given)}")


def of_numbers(name: str, given: Any) -> None:
    """Raise ValueError unless the argument `name` is an array of numbers."""
    of_kind(name, given, np.ndarray)
    if given.dtype.kind not in "biuf":
        raise ValueError(f"{name} must be of numbers; got {shown(given)}")


def plain(given: Any) -> Any:
    """Return a number or a truth value of NumPy's as Python's, and anything else as it is."""
    return given.item() if isinstance(given, np.generic) else given


def read_value(text: str) -> Any:
    """Return the number, truth value or null that a text says, or any other text as it is."""
    try:
        found = json.loads(text.lower())
    except (ValueError, RecursionError):
        return text
    return text if isinstance(found, str | list | dict) else found


def path_of(name: str, given: Any) -> Path:
    """Return the argument `name` as a path; raise ValueError unless it is one: "" names nothing."""
    if not isinstance(given, str | os.PathLike) or not f"{given}" or "\0" in f"{given}":
        raise ValueError(f"{name} must be the path of a file or folder; got {shown(given)}")
    return Path(given)


def one_of(kind: str, given: Any, there: Any, of: str = "") -> None:
    """Raise ValueError unless `given` is one of the names of a `kind`.

    Args:
        kind: The noun for such a name, such as "goal".
        given: The argument.
        there: The names: a collection, or a `Literal`.
        of: Whatever has such names.
    """
    names: Collection[str] = typing.get_args(there) or there
    if not isinstance(given, str) or given not in names:
        whose = f" of {of}" if of else ""
        raise ValueError(
            f"unknown {kind} {shown(given)}{whose}; there are: {', '.join(names) or 'none'}"
        )


def check_words(record: Any) -> None:
    """Raise ValueError unless the `Literal`, bool and str fields of a dataclass `record` are such.

    A misspelt word would otherwise be read as another one, and "no" as yes. Other fields are not
    checked.
    """
    for name, kind in types_of(type(record)).items():
        if typing.get_origin(kind) is Literal:
            one_of(name, getattr(record, name), kind)
        elif kind in (bool, str):
            of_kind(name, getattr(record, name), kind)


def integers(given: Any, name: str) -> np.ndarray:
    """Return `given` as an array of integers of the same shape.

    A float would be truncated silently, a boolean would become 0 or 1, and a mask be forgotten.

    Raises:
        ValueError: If it holds anything else, larger integers, or a range of more than `AT_ONCE`.
    """
    if isinstance(given, range) and given[AT_ONCE:]:
        raise ValueError(f"at most {AT_ONCE:,} {name} are taken at once; got {given}")
    try:
        numbers = np.asarray(given)
    except ValueError:  # a ragged list
        numbers = np.empty(1, object)
    several = isinstance(given, Sequence) and not isinstance(given, str | range)
    is_bool = several and any(isinstance(x, UNCOUNTED) for x in given)
    if numbers.size and (numbers.dtype.kind not in "iu" or is_bool or np.ma.is_masked(given)):
        raise ValueError(f"{name} must be integers of at most 64 bits; got {reprlib.repr(given)}")
    return numbers if numbers.size else numbers.astype(np.int64)


def check_cell(place: Any) -> tuple[int, int]:
    """Return `place` as a cell (x, y); raise ValueError unless it is two integers."""
    is_pair = np.shape(place) == (2,) and np.asarray(place).dtype.kind in "iu"
    if not is_pair or any(isinstance(one, UNCOUNTED) for one in place):
        raise ValueError(f"a cell must be two integers, x and y; got {shown(place)}")
    x, y = place
    return int(x), int(y)


def shown(given: Any, most: int = 80) -> str:
    """Return `given` as text of at most `most` characters, for an error."""
    text = re.sub(r"\s*\n\s*", " ", _Bounded().repr(given))  # numpy writes an array in lines
    return text if len(text) <= most else f"{text[: most - 3]}..."


class _Bounded(reprlib.Repr):
    """Representation that is cut off, since a value may be unboundedly large."""

    def __init__(self) -> None:
        super().__init__()
        self.maxlevel, self.left = 100, 100  # levels and parts; each is a character at least
        for kind in ("tuple", "list", "array", "dict", "set", "frozenset", "deque"):
            setattr(self, f"max{kind}", 100)
        self.maxstring = self.maxlong = self.maxother = 400

    def repr1(self, x: Any, level: int) -> str:
        self.left -= 1
        if isinstance(x, int) and x.bit_length() > 10_000:  # more than Python writes out
            return f"a number of {x.bit_length()} bits"
        return super().repr1(x, level) if self.left >= 0 else "..."

    def repr_instance(self, x: Any, level: int) -> str:
        try:
            return super().repr_instance(x, level)
        except BaseException:  # a stranger's object may even exit
            return f"<{type(x).__name__} that cannot be shown>"

    def repr_ndarray(self, x: np.ndarray, level: int) -> str:
        if x.size > self.maxother:  # numpy writes out all of an array [2, 2, 2, ...]
            return f"an array of shape {x.shape}"
        return self.repr_instance(x, level)

    def repr_dict(self, x: dict[Any, Any], level: int) -> str:
        if level <= 0:
            return "{...}"
        parts = itertools.islice(x.items(), self.maxdict)
        return "{" + ", ".join(
            f"{self.repr1(key, level - 1)}: {self.repr1(value, level - 1)}" for key, value in parts
        ) + "}"  # fmt: skip


def printable(text: str) -> str:
    """Remove control characters from `text`: file names may have them, and terminals obey them."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def slug(text: str) -> str:
    """Return the letters and digits of `text` as a part of a file's name, joined by dashes."""
    return re.sub(r"[\W_]+", "-", text.lower()).strip("-")


def brief(error: object) -> str:
    """Return an error, or other text of a stranger, cut off because it may be long."""
    text = str(error)
    return text if len(text) <= 300 else f"{text[:297]}..."


def counted(count: int, thing: str) -> str:
    """Return a number of things, such as "1 level" or "2,000 levels"."""
    return f"{count:,} {thing}{'s' * (count != 1)}"


def command_of(*words: str) -> str:
    """Return a command line that bash, cmd and PowerShell read alike, as far as words allow it.

    Words are in double quotes where need be, since cmd takes single ones for letters.
    """
    plain, quotable = r"[\w%+=:./-][\w@%+=:,./-]*", r'([^"$`!\\\n]|\\(?!\\|$))*'
    return " ".join(
        word if re.fullmatch(plain, word, re.ASCII)
        else f'"{word}"' if re.fullmatch(quotable, word)
        else shlex.quote(word)
        for word in words
    )  # fmt: skip
