"""Levels drawn in text: a character a cell, the top row first."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping

import numpy as np

from astray.game import NEVER


def draw(cells: np.ndarray, legend: Mapping[str, int], marks: Mapping[str, tuple[int, int]]) -> str:
    """`cells` [H, W], indexed [y, x], in the characters of `legend`; `marks` drawn over them."""
    names = {value: char for char, value in legend.items()}
    rows = [[names[int(value)] for value in row] for row in cells]
    for char, (x, y) in marks.items():
        rows[y][x] = char
    return "\n".join("".join(row) for row in reversed(rows))


def parse(
    text: str, legend: Mapping[str, int], mark: str, under: int
) -> tuple[np.ndarray, tuple[int, int]]:
    """The cells [H, W] uint8 that `text` draws, and the cell (x, y) of the one `mark` in it."""
    rows = textwrap.dedent(text).strip("\n").rstrip().splitlines()[::-1]
    if not rows or len({len(row) for row in rows}) != 1:
        raise ValueError(f"a level's rows are equally long; these have {[len(r) for r in rows]}")
    cells = np.empty((len(rows), len(rows[0])), np.uint8)
    marks = []
    for y, row in enumerate(rows):
        for x, char in enumerate(row):
            if char == mark:
                marks.append((x, y))
            elif char not in legend:
                there = " ".join([*legend, mark])
                raise ValueError(
                    f"unknown character {char!r} at cell ({x}, {y}); there are: {there}"
                )
            cells[y, x] = under if char == mark else legend[char]
    if len(marks) != 1:
        raise ValueError(f"a level has one {mark!r}; this has {len(marks)}")
    return cells, marks[0]


def only(cells: np.ndarray, value: int, char: str) -> tuple[int, int]:
    """The one cell (x, y) that holds `value`; (NEVER, NEVER) where none does."""
    found = np.argwhere(cells == value)
    if len(found) > 1:
        raise ValueError(f"a level has at most one {char!r}; this has {len(found)}")
    return (int(found[0, 1]), int(found[0, 0])) if len(found) else (NEVER, NEVER)
