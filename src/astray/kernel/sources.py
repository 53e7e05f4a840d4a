"""Digests of what compiled code depends on, so that it is of these functions as they are now."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import inspect
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import ModuleType

ITSELF = "astray"  # the folder of compiled code is named after its sources: `jit.source_digest`
# What is not followed: Python's own modules, and libraries that no game's kernels come from.
FOREIGN = {"gymnasium", "llvmlite", "matplotlib", "numba", "numpy", "scipy", "torch", ITSELF}


def digest_of(functions: Mapping[str, Callable], *more: object) -> str | None:
    """Of which functions stand for which names, and of `more`.

    And of the sources of all modules that these come from but astray's own, and of what those
    import. None where a function has no file, as in a notebook, or was made by another: then nobody
    can tell whether it has changed.
    """
    told, modules = [repr(more)], []
    for bound, function in functions.items():
        function = inspect.unwrap(getattr(function, "py_func", function))
        if getattr(function, "__closure__", None) or not hasattr(function, "__code__"):
            return None
        name, code = function.__module__, function.__code__
        told += [bound, name, function.__qualname__, code.co_firstlineno, code.co_code.hex()]
        modules.append(name)
    sources = digest_of_modules(modules)
    whole = hashlib.sha256(repr([*told, sources]).encode())
    return None if sources is None else whole.hexdigest()[:16]


def digest_of_modules(names: Iterable[str]) -> str | None:
    """Of the sources of modules that are not astray's own, and of all that these import.

    "" where all are astray's own; None where one has no file.
    """
    found: dict[str, ModuleType] = {}
    for name in names:
        if name.partition(".")[0] != ITSELF or ".tests." in name:
            _follow(name, found)
    if not found:
        return ""
    digest = hashlib.sha256()
    for name in sorted(found):
        path = getattr(found[name], "__file__", None)
        if path is None or not Path(path).is_file():
            return None
        digest.update(name.encode() + Path(path).read_bytes())
    return digest.hexdigest()[:16]


def _follow(name: str, found: dict[str, ModuleType]) -> None:
    """Add the module called `name`, and those that it imports, to what was `found`."""
    module = sys.modules.get(name)
    if name in found or module is None:
        return
    found[name] = module
    path = getattr(module, "__file__", None)
    if path is None or not path.endswith(".py") or not Path(path).is_file():
        return
    for other in _imported(ast.parse(Path(path).read_bytes()), module.__package__ or ""):
        root = other.partition(".")[0]
        if root not in FOREIGN and root not in sys.stdlib_module_names:
            _follow(other, found)


def _imported(tree: ast.AST, package: str) -> Iterator[str]:
    """The full names of all that a source imports: modules, and what may be one."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            name = "." * node.level + (node.module or "")
            module = importlib.util.resolve_name(name, package) if node.level else name
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)
