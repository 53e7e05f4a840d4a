"""Whether losses and networks are still those that accelerations were written for.

An acceleration does not follow an edit of what it computes. A comparison of numbers can miss an
edit, which may change only what is done with some of them. So the code is compared.
"""

import ast
import hashlib
import inspect
import textwrap
from collections.abc import Callable
from types import CodeType, FunctionType, ModuleType
from typing import Any

from astray.provenance import ITSELF

# Their digests. After an edit of one, check that `training.fast`, and the lab's page for MLP, still
# compute the same, and note the new digest.
WRITTEN = {
    "astray.training.ppo.loss": "8b13054d18856c49",
    "astray.training.teacher.loss": "a6b784347f726934",
    "astray.agents.cells.Cells": "225aa7b3269c8f59",
    "astray.agents.clear.Clear": "e236d92764025acb",
    "astray.agents.impala.Impala": "655d81b032f7e7be",
    "astray.agents.mlp.MLP": "a2b1c65eb526ed3a",
    "astray.agents.patch.Convolutions": "1c3803defc239510",
}
FREE = ("initialise",)  # functions that decide what weights are at first


def is_unedited(thing: Callable) -> bool:
    """Return whether a function, or a class with all that it is made of, is one of `WRITTEN`."""
    try:
        return digest(thing) == WRITTEN.get(_name(thing))
    except (OSError, SyntaxError):  # it has no source, or one that was edited since it was loaded
        return False


def digest(thing: Callable) -> str:
    """Return a digest of the code of a function or class and of what it names in turn.

    Only astray's own code counts, without comments, docstrings and layout.

    Raises:
        OSError: If a source cannot be read.
    """
    found: dict[str, str] = {}
    todo: list[Any] = [thing]
    for one in todo:
        if (name := _name(one)) in found or not _counts(one):
            continue
        if isinstance(one, type):
            found[name] = ""
            todo += [*one.__bases__, *filter(callable, map(_plain, vars(one).values()))]
        else:
            found[name] = _code(one)
            todo += _named(one)
    return hashlib.sha256(repr(sorted(found.items())).encode()).hexdigest()[:16]


def _name(thing: Any) -> str:
    return f"{getattr(thing, '__module__', '')}.{getattr(thing, '__qualname__', '')}"


def _counts(thing: Any) -> bool:
    """Return whether a thing is a class of astray, or a function that somebody wrote in it."""
    if not isinstance(thing, type | FunctionType) or thing.__name__ in FREE:
        return False
    is_made = isinstance(thing, FunctionType) and thing.__code__.co_filename == "<string>"
    if is_made or thing.__name__.startswith("__annotate"):  # of a dataclass, and by Python 3.14
        return False
    return _name(thing).startswith(f"{ITSELF}.")


def _plain(thing: Any) -> Any:
    """Return the function of a method or property without what decorates it."""
    return inspect.unwrap(getattr(thing, "fget", getattr(thing, "__func__", thing)))


def _code(function: Any) -> str:
    tree = ast.parse(textwrap.dedent(inspect.getsource(function)))
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef) and ast.get_docstring(node, clean=False):
            node.body = node.body[1:] or [ast.Pass()]
    return ast.unparse(tree)


def _named(function: Any) -> list[Any]:
    """Return what a function names in its module, and in modules of astray that it names."""
    names, there = {*_names(function.__code__)}, function.__globals__
    modules = [x for x in map(there.get, names) if isinstance(x, ModuleType)]
    scopes = [there, *(vars(x) for x in modules if x.__name__.startswith(ITSELF))]
    return [_plain(scope[name]) for scope in scopes for name in sorted(names & scope.keys())]


def _names(code: CodeType) -> list[str]:
    within = [x for x in code.co_consts if isinstance(x, CodeType)]
    return [*code.co_names, *(name for one in within for name in _names(one))]
