"""Digests of sources: what compiled code depends on, so that it is never older than they are."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from types import ModuleType

ITSELF = "astray"  # the folder of compiled code is named after its sources: `jit.source_digest`
# What is not followed: Python's own modules, and libraries that no game's kernels come from.
FOREIGN = {"gymnasium", "llvmlite", "matplotlib", "numba", "numpy", "scipy", "torch", ITSELF}


def digest_of(functions: Iterable[Callable]) -> str | None:
    """Of the sources of all modules that functions come from, and of all that these import.

    "" where all are astray's own; None where one has no file, as in a notebook: then nobody can
    tell whether it has changed.
    """
    found: dict[str, ModuleType] = {}
    for function in functions:
        name = function.__module__
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
    if path is None or not Path(path).is_file():
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
