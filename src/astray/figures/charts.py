"""Charts of measured values: stacked bars of outcomes, points in rows, and curves.

Each takes a table in long form and the names of its columns: of rows and their parts, of groups,
lines and panels. The values are in columns mean, low and high; low and high are null without an
interval. Panels, rows and series follow the table's order. Series differ in marker, dashes or
hatching as well as in colour. `label` is that of the axis of values, `limits` are its ends, and
`columns` is the number of panels side by side.
"""

from collections.abc import Mapping, Sequence
from itertools import cycle
from textwrap import fill
from typing import Any

import matplotlib
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from astray.figures.axes import (
    BASES,
    COLOURS,
    as_percent,
    beside,
    call_places,
    grid_of,
    looks_of,
    name_rows,
    names_of,
    parts_of,
    places_of,
    ticks_of,
    whiskers_of,
    write_legend,
)
from astray.figures.style import FAINT, INK, ON_COLOUR, STYLE, WIDTH
from astray.outcome import FAILED, INTENDED, MISGENERALIZED

ENDS = ("#a3a39d", "#c9b8a4", "#8f9aa8", "#b9a9b9")  # of other ends than those of all games
HATCHES = ("//", "", "..", "\\\\", "xx", "--", "||")
NARROWEST = 0.07  # fraction of a bar that has room for its percentage
PALE = 0.2  # opacity of an interval
TITLE = 66  # letters of panels' titles side by side
FEW = 25  # points of a curve that are marked
PLAIN: dict[str, Any] = {"fontweight": "normal", "fontsize": 10.5}  # of a title that is a label


@matplotlib.rc_context(STYLE)
def bars(
    data: pl.DataFrame,
    colours: Mapping[str, str],
    *,
    row: str,
    part: str,
    label: str,
    panel: str | None = None,
    interval: str | None = None,
) -> Figure:
    """Draw a stacked bar of fractions for each row.

    Args:
        colours: The colour of each part, in the order of a bar.
        panel: Column of panels, drawn one below the other.
        interval: The part whose interval is drawn.

    Raises:
        ValueError: If the table is empty.
    """
    if data.is_empty():
        raise ValueError("there are no bars to draw; got an empty table")
    panels = parts_of(data, panel)
    counts = [table[row].n_unique() for table in panels.values()]
    figure = Figure(figsize=(WIDTH, 0.85 + sum(0.5 * n + 0.5 * bool(panel) for n in counts)))
    grid = figure.subplots(len(panels), 1, sharex=True, squeeze=False, height_ratios=counts)[:, 0]
    for axes, (title, table) in zip(grid, panels.items(), strict=True):
        axes.set_title(title)
        _stack(axes, parts_of(table, row), part, colours)
        for one in table.to_dicts() if interval else ():
            if one[part] == interval and one["low"] != one["high"]:
                y = [names_of(table, row).index(one[row]) + 0.23] * 2  # where nothing is written
                axes.plot([one["low"], one["high"]], y, "|-", color=INK, lw=1.3, ms=6,
                          clip_on=False, label="95 % interval")  # fmt: skip
        axes.tick_params(length=0)
        axes.spines[["left", "bottom"]].set_visible(False)
    as_percent(grid[-1].xaxis)
    grid[-1].set_xlabel(label)
    write_legend(figure, handlelength=1.5, handleheight=1)
    return figure


def outcome_bars(rates: pl.DataFrame) -> Figure:
    """Draw the outcomes of episodes: a panel for each `where`, with a bar for each `who`.

    Args:
        rates: Columns who, where, outcome (as in `outcomes.rates`), mean, low, high.
    """
    colours = outcome_colours(names_of(rates, "outcome"))
    return bars(
        rates, colours, row="who", part="outcome", panel="where", label="fraction of episodes",
        interval=MISGENERALIZED,
    )  # fmt: skip


def outcome_colours(outcomes: Sequence[str]) -> dict[str, str]:
    """Return each outcome's colour in the order of a bar: goals, other ends, failure.

    The three common outcomes are always included.
    """
    others = [name for name in outcomes if name not in COLOURS]
    goals = {name: COLOURS[name] for name in (MISGENERALIZED, INTENDED)}
    return goals | dict(zip(others, cycle(ENDS), strict=False)) | {FAILED: COLOURS[FAILED]}


@matplotlib.rc_context(STYLE)
def points(
    data: pl.DataFrame,
    *,
    row: str,
    label: str,
    group: str | None = None,
    panel: str | None = None,
    note: str | None = None,
    at: Mapping[str, float] | None = None,
    percent: bool = False,
    limits: tuple[float, float] | None = None,
    symlog: float | None = None,
    columns: int = 1,
    sharex: bool = True,
) -> Figure:
    """Draw points with intervals, a row for each `row` with a mark for each `group`.

    Args:
        note: Column of text written at the end of rows.
        at: Values of reference lines, by label.
        percent: Whether the values are fractions, shown in percent.
        symlog: Value up to which the axis is linear; beyond, it is logarithmic.
        sharex: Whether all panels share the axis of values.
    """
    names, looks = names_of(data, row), looks_of(names_of(data, group))
    panels = parts_of(data, panel)
    height = len(names) * (0.22 + 0.1 * len(looks)) + 0.4
    figure, grid = grid_of(len(panels), columns, height, sharey=True, sharex=sharex)
    for axes, (title, table) in zip(grid, panels.items(), strict=True):
        for dashes, (name, value) in zip(cycle(BASES), (at or {}).items(), strict=False):
            axes.axvline(value, color=INK, linestyle=dashes if name else "-", lw=1, label=name)
        for k, (name, look) in enumerate(looks.items()):
            part = table.filter(pl.col(group) == name) if group else table
            y = places_of(part[row], names) + min(0.3, 0.7 / len(looks)) * beside(k, looks)
            told = look | {"linestyle": "none", "label": name, "capsize": 3, "markersize": 4.5}
            axes.errorbar(part["mean"], y, xerr=whiskers_of(part), **told)
            for place, text in zip(y, part[note] if note else (), strict=False):
                axes.text(1.01, place, text, transform=axes.get_yaxis_transform(), va="center",
                          fontsize=8)  # fmt: skip
        axes.set_title(fill(title, TITLE // min(columns, len(grid))))
        if symlog:
            axes.set_xscale("symlog", linthresh=symlog)
            ticks = [0, *(s * x for x in (1, 2, 5, 10, 20, 50) for s in (-1, 1))]
            low, high = axes.get_xlim()
            axes.set_xticks(sorted(x for x in ticks if low <= x <= high))
            axes.xaxis.set_major_formatter("{x:g}")  # words would stand for the values, too
        if limits:
            axes.set_xlim(limits)
        if percent:
            as_percent(axes.xaxis)
        name_rows(axes, names)
        axes.grid(axis="x")
    for axes in grid[-1:] if sharex and columns == 1 else grid:
        axes.set_xlabel(label)
    write_legend(figure)
    return figure


@matplotlib.rc_context(STYLE)
def curves(
    data: pl.DataFrame,
    *,
    x: str,
    label: str,
    line: str | None = None,
    panel: str | None = None,
    each: str | None = None,
    x_label: str = "",
    at: Mapping[str, float] | None = None,
    shade: tuple[float, float] | None = None,
    even: bool = False,
    whiskers: bool = False,
    percent: str = "",
    limits: tuple[float, float] | None = None,
    columns: int = 2,
    sharey: bool = True,
    base: Sequence[str] = (),
) -> Figure:
    """Draw values against `x`, a line for each `line`, with bands or whiskers as intervals.

    Rows without an x are horizontal lines, such as base rates.

    Args:
        data: The table; a NaN breaks a line, a null does not.
        x: Column of places: numbers, or words, which are spaced evenly.
        each: Column of a series' single members, drawn thin; null for the thick line.
        x_label: Label of the axis of places.
        at: Places of reference lines, by label.
        shade: Ends of a shaded range.
        even: Whether numbers are spaced evenly, too.
        whiskers: Whether intervals are whiskers.
        percent: Axes of fractions: "y", "x" or "xy".
        sharey: Whether all panels share the axis of values.
        base: Series for comparison, dashed and dark.
    """
    panels, series = parts_of(data, panel), names_of(data, line)
    level = [one for one in series if line and not data.filter(pl.col(line) == one)[x].count()]
    looks, places = looks_of(series, [*level, *base]), ticks_of(data[x], even)
    figure, grid = grid_of(
        len(panels), columns, 2.4 if panel else 3.2, sharey=sharey, sharex=columns == 1
    )
    for axes, (title, table) in zip(grid, panels.items(), strict=True):
        if shade:
            axes.axvspan(*shade, color=FAINT, alpha=0.5, lw=0)
        for place in (at or {}).values():
            axes.axvline(place, color=INK, linestyle=":", linewidth=1)
        for k, (name, look) in enumerate(looks.items()):
            part = table.filter(pl.col(line) == name) if line else table
            for value in part.filter(pl.col(x).is_null())["mean"]:
                axes.axhline(value, label=name, lw=1.4, color=INK, ls=look["linestyle"])
            shift = 0.06 * beside(k, looks) if whiskers and places else 0.0
            _series(axes, part.drop_nulls([x, "mean"]), name, look, (x, places, shift), each,
                    whiskers)  # fmt: skip
        named = fill(title, TITLE // min(columns, len(grid)))
        axes.set_title(named or label, **{} if title else PLAIN)
        if places:
            axes.set_xticks(range(len(places)), [f"{one}" for one in places])
            if max(len(f"{one}") for one in places) * len(places) * min(columns, len(grid)) > 90:
                axes.tick_params("x", labelrotation=50, labelsize=8.5)
        elif data[x].dtype.is_integer():
            axes.xaxis.set_major_locator(MaxNLocator(9, integer=True, steps=[1, 2, 5, 10]))
        if limits:
            axes.set_ylim(limits)
        for which in percent:
            as_percent(axes.yaxis if which == "y" else axes.xaxis)
        if "x" in percent:
            axes.set_xlim(-0.03, 1.03)
        if not whiskers:
            axes.margins(x=0.01)
        axes.grid(axis="y")
    for axes in grid[-1:] if columns == 1 else grid:
        axes.set_xlabel(x_label)
    for axes in grid if panel else ():
        if axes.get_subplotspec().is_first_col():  # pyrefly: ignore
            axes.set_ylabel(label)
    write_legend(figure)
    call_places(grid[0], at or {})
    return figure


def _series(
    axes: Axes,
    part: pl.DataFrame,
    name: str,
    look: dict[str, Any],
    placed: tuple[str, Sequence[Any], float],
    each: str | None,
    whiskers: bool,
) -> None:
    """Draw a series: single members thin, the others thick, with intervals."""
    x, places, shift = placed
    part = part.with_columns(_x=pl.Series(places_of(part[x], places) + shift, dtype=pl.Float64))
    part = part.sort("_x", maintain_order=True)
    thick = part.filter(pl.col(each).is_null()) if each else part
    thin = part.filter(pl.col(each).is_not_null()).partition_by(each) if each else []
    bare: dict[str, Any] = look | {"marker": ""}
    for k, one in enumerate(thin):
        told = name if thick.is_empty() and not k else None
        marked = look if len(one) <= FEW else bare
        axes.plot(one["_x"], one["mean"], lw=0.8, ms=3.5, alpha=0.6, label=told, **marked)
    if thick.is_empty():
        return
    marked = look if len(thick) <= FEW and not thin else bare
    if whiskers:
        axes.errorbar(thick["_x"], thick["mean"], whiskers_of(thick), lw=1.8, ms=4.5, capsize=3,
                      label=name, **marked)  # fmt: skip
        return
    axes.plot(thick["_x"], thick["mean"], lw=2, ms=4.5, label=name, **marked)
    if {"low", "high"} <= {*thick.columns}:
        band = thick.drop_nulls(["low", "high"])
        axes.fill_between(band["_x"], band["low"], band["high"], color=look["color"], alpha=PALE,
                          lw=0)  # fmt: skip


def _stack(
    axes: Axes, rows: Mapping[str, pl.DataFrame], part: str, colours: Mapping[str, str]
) -> None:
    """Draw one bar for each row, the first on top."""
    for y, table in enumerate(rows.values()):
        rates, left = dict(table.select(part, "mean").iter_rows()), 0.0
        for (name, colour), hatch in zip(colours.items(), cycle(HATCHES), strict=False):
            rate = rates.get(name) or 0.0
            axes.barh(y, rate, 0.66, left, color=colour, edgecolor="white", linewidth=0.8,
                      hatch=hatch, label=f"_{name}" if y else name)  # fmt: skip
            if rate >= NARROWEST:
                axes.text(left + rate / 2, y, f"{100 * rate:.0f} %", ha="center",
                          va="center_baseline", color=ON_COLOUR)  # fmt: skip
            left += rate
    name_rows(axes, list(rows))
    axes.set_xlim(0, 1)
