"""What is given, held against what is possible: words of a closed set, types, counts."""

from __future__ import annotations

import math
import operator
import types
import typing
from typing import Any, Literal


def check_word(name: str, value: Any, kind: Any) -> None:
    """ValueError where `value` is none of the words of `kind`, a `Literal`."""
    words = typing.get_args(kind)
    if not isinstance(value, str) or value not in words:
        raise ValueError(f"unknown {name} {value!r}; there are: {', '.join(words)}")


def check_words(record: Any) -> None:
    """ValueError where a field of the dataclass `record` is none of the words it is declared with.

    Fields of other types are left alone. A word that is misspelt would else be read as another.
    """
    for name, kind in typing.get_type_hints(type(record)).items():
        if typing.get_origin(kind) is Literal:
            check_word(name, getattr(record, name), kind)


def check_type(name: str, value: Any, kind: Any) -> None:
    """ValueError where `value` is not of the type `kind`; a real number is also to be finite."""
    if typing.get_origin(kind) is Literal:
        check_word(name, value, kind)
        return
    parts = typing.get_args(kind) if isinstance(kind, types.UnionType) else (kind,)
    kinds = [typing.get_origin(part) or part for part in parts]
    if float in kinds:
        kinds.append(int)
    if type(value) not in kinds:
        raise ValueError(f"{name} is {value!r}; it is a {kinds[0].__name__}")
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError(f"{name} is {value!r}; it is a {kinds[0].__name__}, and finite")


def check_count(name: str, value: Any, most: int | None = None) -> int:
    """`value` as an integer from 1 to `most`; ValueError where it is none."""
    said = "at least 1" if most is None else f"from 1 to {most:,}"
    try:
        count = operator.index(value)
    except TypeError:
        count = 0
    if isinstance(value, bool) or count < 1 or (most is not None and count > most):
        raise ValueError(f"{name} is {value!r}; it is a whole number, {said}")
    return count
