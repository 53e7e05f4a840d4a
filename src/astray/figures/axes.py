"""Shared parts of charts: styles of series, axes, and legends."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.ticker import PercentFormatter

from astray.figures.style import INK, OTHERS, PAGE, WIDTH
from astray.outcome import FAILED, INTENDED, MISGENERALIZED

# Told apart by every kind of colour vision, and light enough to be written on.
COLOURS = {MISGENERALIZED: "#f0a03c", INTENDED: "#2fa393", FAILED: "#d2d2ce"}
LINES = COLOURS | {FAILED: "#77777a"}  # its own grey is too light for a line
MARKERS, DASHES, BASES = "osD^v<>P*X", ("-", "--", "-.", ":"), ("--", ":", "-.")


def looks_of(names: Iterable[str], level: Sequence[str] = ()) -> dict[str, dict[str, Any]]:
    """Return the line style of each name: outcomes have fixed ones, `level` ones are dark."""
    looks: dict[str, dict[str, Any]] = {}
    for k, name in enumerate(names):
        outcome = [colour for of, colour in LINES.items() if name.startswith(of)]
        own = k - sum(one in level for one in looks)
        looks[name] = {
            "color": (outcome or [OTHERS[own % len(OTHERS)]])[0],
            "marker": MARKERS[own % len(MARKERS)],
            "linestyle": DASHES[own // len(OTHERS) % len(DASHES)],
        }
        if name in level:
            looks[name] = {"color": INK, "marker": "", "linestyle": BASES[level.index(name)]}
    return looks


def names_of(data: pl.DataFrame, column: str | None) -> list[Any]:
    return data[column].unique(maintain_order=True).to_list() if column else [""]


def parts_of(data: pl.DataFrame, column: str | None) -> dict[str, pl.DataFrame]:
    """Split the table by a column, in the table's order, or return it whole if there is none."""
    if not column or data.is_empty():
        return {"": data}
    return {one: data.filter(pl.col(column) == one) for one in names_of(data, column)}


def grid_of(count: int, columns: int, height: float, **shared: Any) -> tuple[Figure, list[Axes]]:
    """Return a figure with `count` axes of a common height in inches."""
    columns = min(columns, count)
    rows = -(-count // columns)
    figure = Figure(figsize=(WIDTH, 0.6 + height * rows))
    grid = list(figure.subplots(rows, columns, squeeze=False, **shared).flat)
    for unused in grid[count:]:
        unused.remove()
    return figure, grid[:count]


def write_legend(figure: Figure, **look: Any) -> None:
    """Write one legend above all axes, with as many columns as fit."""
    found: dict[str, Any] = {}
    for axes in figure.axes:
        for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
            found.setdefault(name, handle)
    found = dict(sorted(found.items(), key=lambda one: isinstance(one[1], Line2D)))
    if found:
        room = int(92 / (max(map(len, found)) + 6))
        figure.legend(found.values(), found.keys(), loc="outside upper left",
                      ncols=min(len(found), max(1, room)), **look)  # fmt: skip


def call_places(axes: Axes, at: Mapping[str, float]) -> None:
    """Label lines at given positions along them, no label over another or behind a curve."""
    low, high = axes.get_xlim()
    line = 0.025 * (high - low)  # a little more than the height of the text
    there, before = high + line, []
    for name, place in sorted(at.items(), key=lambda one: -one[1]):
        there = min(place, there - line)
        before.append((there, place, name))
    taken = low
    for there, place, name in reversed(before):
        near = there - line < max(taken, low + 1.4 * line)  # to the axis, or what stands there
        x = max(place, taken) if near else there
        taken = x + line * near
        axes.annotate(name, (x, 1.0), (3 if near else -3, -2), ha="left" if near else "right",
                      va="top", xycoords=("data", "axes fraction"), textcoords="offset points",
                      fontsize=8.5, rotation=90,
                      bbox={"fc": PAGE, "ec": "none", "pad": 0.5, "alpha": 0.8})  # fmt: skip


def name_rows(axes: Axes, names: Sequence[str]) -> None:
    """Label the rows, the first on top."""
    axes.set_yticks(range(len(names)), [textwrap.fill(f"{name}", 24) for name in names])
    axes.set_ylim(len(names) - 0.5, -0.5)


def ticks_of(column: pl.Series, even: bool) -> list[Any]:
    """Return the evenly spaced values: words in order of appearance, numbers ascending."""
    values = column.drop_nulls().unique(maintain_order=True)
    if not values.dtype.is_numeric():
        return values.to_list()
    return values.sort().to_list() if even else []


def places_of(column: pl.Series, places: Sequence[Any]) -> np.ndarray:
    """Return the positions [rows] of a column's values on an axis."""
    return np.array([places.index(one) for one in column] if places else column.to_list(), float)


def beside(k: int, all_: Mapping[str, Any]) -> float:
    """Return a series' offset from the middle series."""
    return k - (len(all_) - 1) / 2


def whiskers_of(part: pl.DataFrame) -> np.ndarray:
    """Return the distances of interval ends from means, [2, N]; 0 without an interval."""
    mean = part["mean"].cast(pl.Float64)
    ends = (mean - part["low"].fill_null(mean), part["high"].fill_null(mean) - mean)
    return np.stack([end.clip(0).to_numpy() for end in ends])


def as_percent(axis: Axis) -> None:
    axis.set_major_formatter(PercentFormatter(1, symbol=" %"))
