"""Show comments behind fields, and docstrings as they are, in the reference."""

from __future__ import annotations

import re
from typing import Any

from griffe import Attribute, Docstring, Extension, Object


class Comments(Extension):
    """Give fields the comments behind them, and keep marks in docstrings from being markup."""

    def on_attribute_instance(self, *, attr: Attribute, **_: Any) -> None:
        said = [line.partition("  # ")[2] for line in attr.lines]
        if attr.docstring is None and any(said):
            attr.docstring = Docstring(" ".join(filter(None, said)), parent=attr)

    def on_object(self, *, obj: Object, **_: Any) -> None:
        if obj.docstring is not None and not obj.is_alias:
            obj.docstring.value = plain(obj.docstring.value)


def plain(text: str) -> str:
    """Return `text` with no tag and no link outside of code: `<`, and `a[b][c]`."""
    parts = re.split(r"(`[^`]*`|^ *>>>.*$)", text, flags=re.MULTILINE)
    parts[::2] = [part.replace("<", "&lt;").replace("][", "]&#91;") for part in parts[::2]]
    return "".join(parts)
