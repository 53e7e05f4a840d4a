"""Figures: what agents do, and how they learned it. Everything is drawn in one style."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from itertools import cycle

import matplotlib
import numpy as np
import polars as pl
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch
from matplotlib.ticker import PercentFormatter

from astray.analysis.estimates import over_agents
from astray.analysis.outcomes import FAILED, INTENDED, MISGENERALIZED
from astray.analysis.style import FAINT, INK, OTHERS, STYLE, WIDTH, save

__all__ = ["FAINT", "INK", "OTHERS", "STYLE", "WIDTH", "save"]  # others take them from here

# Told apart by every kind of colour vision, and light enough to be written on.
COLOURS = {MISGENERALIZED: "#f0a03c", INTENDED: "#2fa393", FAILED: "#d2d2ce"}
ENDS = ("#a3a39d", "#c9b8a4", "#8f9aa8", "#b9a9b9")  # of other ends than these
NARROWEST = 0.07  # share of a segment that has room for its percentage


@matplotlib.rc_context(STYLE)
def outcome_bars(shares: pl.DataFrame) -> Figure:
    """How episodes end: a panel for each `where`, in it a bar for each `who`.

    shares  columns who, where, outcome (as `outcomes.shares` has them), mean, low, high: shares
            from 0 to 1 with their interval, null where there is none; panels and bars in the
            table's order
    """
    if shares.is_empty():
        raise ValueError("there are no outcomes to draw; got an empty table")
    colours = outcome_colours(shares["outcome"].unique(maintain_order=True).to_list())
    panels = shares.partition_by("where", maintain_order=True)
    bars = [panel["who"].n_unique() for panel in panels]
    figure = Figure(figsize=(WIDTH, 0.85 + sum(0.5 * n + 0.5 for n in bars)))
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False, height_ratios=bars)[:, 0]
    for axes, panel in zip(rows, panels, strict=True):
        _bars(axes, panel, colours)
        axes.set_title(panel["where"][0])
    rows[-1].set_xlabel("share of episodes")
    rows[-1].xaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
    keys: list[Artist] = [Patch(color=colour, label=outcome) for outcome, colour in colours.items()]
    if shares["low"].count():
        keys.append(_interval([], [], "95 % interval"))
    figure.legend(handles=keys, loc="outside upper left", ncols=4, handlelength=1, handleheight=1)
    return figure


def outcome_colours(outcomes: Sequence[str]) -> dict[str, str]:
    """Return the colour of each outcome in the order of a bar: goals, other ends, failure.

    The three of all games are there always.
    """
    others = [name for name in outcomes if name not in COLOURS]
    goals = {name: COLOURS[name] for name in (MISGENERALIZED, INTENDED)}
    return goals | dict(zip(others, cycle(ENDS), strict=False)) | {FAILED: COLOURS[FAILED]}


def _bars(axes: Axes, panel: pl.DataFrame, colours: Mapping[str, str]) -> None:
    """One stacked bar for each `who`, the first on top."""
    names = panel["who"].unique(maintain_order=True).to_list()
    for y, who in enumerate(names):
        of = {row["outcome"]: row for row in panel.filter(pl.col("who") == who).to_dicts()}
        left = 0.0
        for outcome, colour in colours.items():
            share = of[outcome]["mean"] if outcome in of else 0.0
            axes.barh(y, share, 0.66, left, color=colour, edgecolor="white", linewidth=0.8)
            if share >= NARROWEST:
                axes.text(
                    left + share / 2, y, f"{100 * share:.0f} %", ha="center", va="center_baseline"
                )
            left += share
        proxy = of.get(MISGENERALIZED, {"low": None, "high": None})
        if proxy["low"] != proxy["high"]:  # below the middle, where nothing is written
            axes.add_line(_interval([proxy["low"], proxy["high"]], [y + 0.23, y + 0.23]))
    axes.set_yticks(range(len(names)), [textwrap.fill(name, 24) for name in names])
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_xlim(0, 1)
    axes.tick_params(length=0)
    axes.spines[["left", "bottom"]].set_visible(False)


def _interval(x: list[float], y: list[float], label: str = "") -> Line2D:
    return Line2D(
        x, y, color=INK, linewidth=1.3, marker="|", markersize=6, clip_on=False, label=label
    )


@matplotlib.rc_context(STYLE)
def learning_curves(curves: pl.DataFrame, series: Mapping[str, str], y_label: str) -> Figure:
    """How something went during training: a thin line for each seed, a thick one for their mean.

    The band is the mean's 95 % interval, Student's over seeds.
    Agents of several names have axes of their own.

    curves  columns seed, steps (environment steps), those of `series`, and where there are several
            names agent; nulls are skipped
    series  column -> what it is called
    """
    names = curves["agent"].unique(maintain_order=True).to_list() if "agent" in curves else [None]
    columns = min(len(names), 3)
    rows = -(-len(names) // columns)
    figure = Figure(figsize=(WIDTH, 3.6 if len(names) == 1 else 0.6 + 2.4 * rows))
    grid = [*figure.subplots(rows, columns, sharey=True, squeeze=False).flat]
    others = cycle(OTHERS)
    colours = {name: COLOURS.get(name) or next(others) for name in series.values()}
    for axes, agent in zip(grid, names, strict=False):
        part = curves if agent is None else curves.filter(agent=agent)
        for column, name in series.items():
            value = pl.col(column).cast(pl.Float64).fill_nan(None)
            values = part.select("seed", "steps", value=value).drop_nulls("value")
            _curve(axes, values, name, colours[name])
        title = y_label if len(names) == 1 else f"{agent}: {y_label}"
        axes.set_title(title, fontweight="normal", fontsize=10.5)  # lies flat, unlike a y label
        axes.set_xlabel("million environment steps" if columns == 1 else "million steps")
        axes.grid(axis="y")
        axes.margins(x=0)
    for unused in grid[len(names) :]:
        unused.remove()
    if len(series) > 1:
        lines, labels = grid[0].get_legend_handles_labels()  # the same in all axes
        figure.legend(lines, labels, loc="outside upper left", ncols=3, handlelength=1.5)
    return figure


def _curve(axes: Axes, values: pl.DataFrame, name: str, colour: str) -> None:
    """`values`: seed, steps, value. The mean is of the steps at which every seed has a value."""
    seeds = values.partition_by("seed")
    for one in seeds if len(seeds) > 1 else ():
        one = one.sort("steps")
        axes.plot(one["steps"] / 1e6, one["value"], color=colour, linewidth=0.8, alpha=0.6)
    every = values.group_by("steps").agg("value").sort("steps")
    every = every.filter(pl.col("value").list.len() == len(seeds))
    million = every["steps"] / 1e6
    if len(seeds) > 1 and len(every):
        low, high = over_agents(np.array(every["value"].to_list()).T)[1:]
        axes.fill_between(million, low, high, color=colour, alpha=0.2, linewidth=0)
    axes.plot(million, every["value"].list.mean(), color=colour, linewidth=2.4, label=name)
