"""Objects of others by name, "module:attribute", as entry points write them."""

from __future__ import annotations

import importlib
import re
import sys
from importlib.metadata import entry_points
from typing import Any

NAME = re.compile(r"[^\W\d][\w.]*:[^\W\d][\w.]*")


def is_name(text: str) -> bool:
    """Whether `text` may name an object: "module:attribute"."""
    return bool(NAME.fullmatch(text))


def name_of(thing: Any) -> str:
    """The name of a function or a class.

    Raises ValueError where it has none that leads back to it, as what is defined in a function.
    """
    name = f"{getattr(thing, '__module__', None)}:{getattr(thing, '__qualname__', None)}"
    try:
        found = _attribute(sys.modules[name.partition(":")[0]], name)
    except (KeyError, AttributeError):
        found = None
    if found is not thing:
        raise ValueError(f"{thing!r} must be a function or a class at the top of a module")
    return name


def find(name: str) -> Any:
    """What a name of the user's own leads to; its module is imported, which runs it.

    Raises ValueError where there is nothing.
    """
    if not is_name(name):
        raise ValueError(f"{name!r} must be a module and what is in it; as module:attribute")
    try:
        return _attribute(importlib.import_module(name.partition(":")[0]), name)
    except (ImportError, AttributeError, ValueError) as error:
        raise ValueError(f"{name!r} must be a module and what is in it; {error}") from error


def known(name: str, group: str, kind: type) -> Any:
    """What a name out of a file leads to: nothing is imported that nobody asked for.

    An installed package offers it as one of the entry points of `group`, or its module has been
    imported in this process and it is a class derived from `kind`: a file that could name any
    function of the modules that happen to be there would have it called.

    Raises ValueError where neither is so.
    """
    if name in {p.value for p in entry_points(group=group)}:
        return find(name)
    module = name.partition(":")[0]
    if module not in sys.modules:
        raise ValueError(
            f"{name} is not astray's own: import {module} first, or install a package that "
            f"offers it as one of the entry points {group!r}"
        )
    found = find(name)
    if not isinstance(found, type) or not issubclass(found, kind):
        raise ValueError(
            f"{name} must be a class derived from {kind.__name__}, or one of the entry points "
            f"{group!r}; got {found!r}"
        )
    return found


def missing(need: str, extra: str) -> ImportError:
    """Return the error that names the extra which brings a library that is not installed.

    astray is on no package index, so that its name there could be anybody's.
    """
    return ImportError(f"{need}: pip install '.[{extra}]' in a clone of astray")


def needed_by(thing: str, error: ModuleNotFoundError) -> ImportError:
    """Return the error that names the extra of a library that more than environments needs."""
    library = f"{error.name}".partition(".")[0]
    if library == "astray":
        return error
    return missing(f"{thing} needs {library}", "train")


def _attribute(thing: Any, name: str) -> Any:
    for part in name.partition(":")[2].split("."):
        thing = getattr(thing, part)
    return thing
