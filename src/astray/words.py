"""Validation of words from a closed set, and safe display of text."""

from __future__ import annotations

import typing
from typing import Any, Literal


def check_word(name: str, value: Any, kind: Any) -> None:
    """Raise ValueError unless `value` is one of the words of `kind`, a `Literal`."""
    words = typing.get_args(kind)
    if not isinstance(value, str) or value not in words:
        raise ValueError(f"unknown {name} {value!r}; there are: {', '.join(words)}")


def printable(text: str) -> str:
    """Remove control characters from `text`: file names may have them, and terminals obey them."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def check_words(record: Any) -> None:
    """Raise ValueError unless the dataclass `record` has allowed words in all `Literal` fields.

    A misspelt word would otherwise be read as another one. Other fields are not checked.
    """
    for name, kind in typing.get_type_hints(type(record)).items():
        if typing.get_origin(kind) is Literal:
            check_word(name, getattr(record, name), kind)
