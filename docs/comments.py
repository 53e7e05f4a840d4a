"""What mkdocstrings shows of the sources: comments behind fields, and lists in docstrings."""

from __future__ import annotations

import re
from typing import Any

from griffe import Attribute, Docstring, Extension, Object

ENTRY = re.compile(r"([\w<][\w<>./, ]*?)  +(\S.*)")  # a name, two blanks or more, what it is


class Comments(Extension):
    """Give fields the comments behind them, and make lists of the names in docstrings."""

    def on_attribute_instance(self, *, attr: Attribute, **_: Any) -> None:
        said = [line.partition("  # ")[2] for line in attr.lines]
        if attr.docstring is None and any(said):
            attr.docstring = Docstring(" ".join(filter(None, said)), parent=attr)

    def on_object(self, *, obj: Object, **_: Any) -> None:
        if obj.docstring is not None and not obj.is_alias:
            obj.docstring.value = listed(obj.docstring.value)


def listed(text: str) -> str:
    """`text` with its paragraphs of names and explanations as a list."""
    made = "\n\n".join(map(_paragraph, text.split("\n\n")))
    plain = re.split(r"(`[^`]*`)", made)
    # Not code: no tag, and `a[b][c]` no link.
    plain[::2] = [part.replace("<", "&lt;").replace("][", "]&#91;") for part in plain[::2]]
    return "".join(plain)


def _paragraph(text: str) -> str:
    lines = text.split("\n")
    if not ENTRY.fullmatch(lines[0]):
        return text
    items: list[str] = []
    for line in lines:
        if entry := ENTRY.fullmatch(line):  # not one that begins with a blank
            items.append(f"- `{entry[1]}`: {entry[2]}")
        else:
            items[-1] += " " + line.strip()
    return "\n".join(items)
