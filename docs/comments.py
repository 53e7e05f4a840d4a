"""Show comments behind fields, and docstrings as they are, in the reference.

Of a module's constants, those that other modules use have a place there.
"""

from __future__ import annotations

import ast
import re
from functools import cache
from pathlib import Path
from typing import Any

from griffe import Attribute, Docstring, Extension, Object

import astray


class Comments(Extension):
    """Give fields the comments behind them, and keep marks in docstrings from being markup."""

    def on_attribute_instance(self, *, attr: Attribute, **_: Any) -> None:
        said = [line.partition("  # ")[2] for line in attr.lines]
        if not any(said) and attr.lineno and attr.parent is not None and attr.parent.is_class:
            above = attr.lines_collection[Path(str(attr.filepath))][attr.lineno - 2]
            said = [above.removeprefix("    # ") if above.startswith("    # ") else ""]
        of_module = attr.parent is not None and attr.parent.is_module
        if attr.docstring is None and any(said) and (not of_module or attr.name in used()):
            attr.docstring = Docstring(" ".join(filter(None, said)), parent=attr)

    def on_object(self, *, obj: Object, **_: Any) -> None:
        if obj.docstring is not None and not obj.is_alias:
            obj.docstring.value = plain(obj.docstring.value)


@cache
def used() -> set[str]:
    """The names that modules import from others of astray, or read as attributes of them."""
    names = set(astray.FACE)  # the package itself loads its names late
    for path in Path("src/astray").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_bytes())):
            if isinstance(node, ast.ImportFrom) and str(node.module).startswith("astray"):
                names.update(name.name for name in node.names)
            elif isinstance(node, ast.Attribute):
                names.add(node.attr)
    return names


def plain(text: str) -> str:
    """Return `text` with no tag and no link outside of code: `<`, and `a[b][c]`."""
    parts = re.split(r"(`[^`]*`|^ *>>>.*$)", text, flags=re.MULTILINE)
    parts[::2] = [part.replace("<", "&lt;").replace("][", "]&#91;") for part in parts[::2]]
    return "".join(parts)
