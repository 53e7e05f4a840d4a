"""Settings of a training and options of verbs with their types, those of groups beside others."""

import typing
from dataclasses import is_dataclass

from tyro.conf import Positional

from astray.cli import verbs
from astray.training.config import RECORDS, Config

_POSITIONAL = typing.get_args(Positional[int])[-1]


def kinds():
    found = {}
    for name, kind in typing.get_type_hints(Config).items():
        if name in RECORDS:
            hints = typing.get_type_hints(RECORDS[name])
            found |= {name if own == "kind" else own: hint for own, hint in hints.items()}
        else:
            found[name] = kind
    return found


def options(verb):
    """The options of a verb and its groups: name in the code, type, whether positional."""
    function = verbs.find(verb)
    function = getattr(function, "func", function)
    yield from _fields(typing.get_type_hints(function, include_extras=True))


def _fields(hints):
    for name, hint in hints.items():
        kind = typing.get_args(hint)[0] if hasattr(hint, "__metadata__") else hint
        if name == "return":
            continue
        marks = getattr(hint, "__metadata__", ())
        makers = [
            mark.constructor_factory for mark in marks if hasattr(mark, "constructor_factory")
        ]
        kind = next((make() for make in makers if make), kind)
        if is_dataclass(kind):
            yield from _fields(typing.get_type_hints(kind, include_extras=True))
            continue
        given = [mark.name for mark in marks if getattr(mark, "name", None)]
        yield given[0] if given else name, kind, _POSITIONAL in marks
