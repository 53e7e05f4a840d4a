"""Words that are of a closed set, and no other; and text of any kind, to be shown."""

from __future__ import annotations

import typing
from typing import Any, Literal


def check_word(name: str, value: Any, kind: Any) -> None:
    """ValueError where `value` is none of the words of `kind`, a `Literal`."""
    words = typing.get_args(kind)
    if not isinstance(value, str) or value not in words:
        raise ValueError(f"unknown {name} {value!r}; there are: {', '.join(words)}")


def printable(text: str) -> str:
    """`text` without control characters, which names of files may have and terminals obey."""
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)


def check_words(record: Any) -> None:
    """ValueError where a field of the dataclass `record` is none of the words it is declared with.

    Fields of other types are left alone. A word that is misspelt would else be read as another.
    """
    for name, kind in typing.get_type_hints(type(record)).items():
        if typing.get_origin(kind) is Literal:
            check_word(name, getattr(record, name), kind)
