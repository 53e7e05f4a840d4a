"""The figures of mazes: a sweep of regions, and pairs of objects that differ in colour or shape."""

from __future__ import annotations

import matplotlib
import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, PercentFormatter

from astray.analysis.outcomes import INTENDED, MISGENERALIZED, OUTCOMES
from astray.experiments.figures import COLOURS, INK, OTHERS, STYLE, WIDTH

MARKERS = "osDv"  # lines are told apart without colour, too
FAILED_LINE = "#8c8c88"  # COLOURS has it lighter, for areas


@matplotlib.rc_context(STYLE)
def region_lines(success: pl.DataFrame, first: pl.DataFrame) -> Figure:
    """Against the region of the cheese in training: how often it is reached, and what is first.

    success  columns who, region (cells a side; null: a base rate), mean, low, high
    first    columns outcome (of `outcomes.OUTCOMES`), region, mean, low, high
    """
    figure = Figure(figsize=(WIDTH, 6.4))
    upper, lower = figure.subplots(2, 1, sharex=True)
    trained = success.drop_nulls("region").partition_by("who", maintain_order=True)
    for number, (colour, line) in enumerate(zip(OTHERS, trained, strict=False)):
        _line(upper, line, line["who"][0], colour, number)
    base_rates = success.filter(pl.col("region").is_null()).to_dicts()
    for dashes, row in zip(("--", ":"), base_rates, strict=True):
        upper.axhline(row["mean"], color=INK, linewidth=1.2, linestyle=dashes, label=row["who"])
    upper.set_title("The cheese is reached")
    colours = [COLOURS[INTENDED], COLOURS[MISGENERALIZED], FAILED_LINE]
    for number, (colour, outcome) in enumerate(zip(colours, OUTCOMES, strict=True)):
        _line(lower, first.filter(outcome=outcome), outcome, colour, number)
    lower.set_title("Reached first, in distinguishing levels")
    lower.set_xlabel("region of the cheese in training (cells a side)")
    lower.xaxis.set_major_locator(MaxNLocator(integer=True))
    for axes in (upper, lower):
        axes.set_ylim(-0.02, 1.02)
        axes.yaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
        axes.grid(axis="y")
        axes.legend(loc="upper left", bbox_to_anchor=(1, 1), handlelength=2.5)
    return figure


def _line(axes: Axes, line: pl.DataFrame, name: str, colour: str, number: int) -> None:
    """The means of `line` with their intervals, beside those of the lines before it."""
    line = line.sort("region")
    x = line["region"] + 0.07 * number
    axes.plot(x, line["mean"], color=colour, marker=MARKERS[number], linewidth=2, label=name)
    axes.vlines(x, line["low"], line["high"], color=colour, linewidth=1.3)


@matplotlib.rc_context(STYLE)
def pair_maps(pairs: pl.DataFrame, trained: tuple[str, str]) -> Figure:
    """Which of two objects mice go to: one that keeps its shape, or one that keeps its colour.

    pairs    columns colour (of the object that keeps its shape), shape (of that which keeps its
             colour), keeps_colour (the share that goes to that one among those that go to
             either, 0 to 1; null where none do), neither (the share that goes to neither)
    trained  the colour and shape of the object in training; its row and column are set apart
    """
    colour, shape = trained
    figure = Figure(figsize=(WIDTH, 3.9))
    panels = figure.subplots(1, 2, sharey=True)
    orange = LinearSegmentedColormap.from_list("kept", ["white", COLOURS[MISGENERALIZED]])
    grey = LinearSegmentedColormap.from_list("neither", ["white", FAILED_LINE])
    titles = [f"go to the {colour} object,\nof those that go to either", "go to neither\n"]
    for axes, column, map_, title in zip(
        panels, ("keeps_colour", "neither"), (orange, grey), titles, strict=True
    ):
        table = pairs.pivot("shape", index="colour", values=column)
        shares = table.drop("colour").to_numpy().astype(float)
        axes.imshow(shares, cmap=map_, vmin=0, vmax=1)
        for (row, place), share in np.ndenumerate(shares):
            text = "" if share != share else f"{100 * share:.0f}"
            axes.text(place, row, text, ha="center", va="center_baseline")
        axes.axhline(0.5, color=INK, linewidth=1)
        axes.axvline(0.5, color=INK, linewidth=1)
        axes.set_xticks(range(shares.shape[1]), table.columns[1:])
        axes.set_yticks(range(shares.shape[0]), table["colour"].to_list())
        axes.set_xlabel(f"shape of the {colour} object")
        axes.set_title(title, fontweight="normal", fontsize=10.5)
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
    panels[0].set_ylabel(f"colour of the {shape}")
    return figure


@matplotlib.rc_context(STYLE)
def by_size(table: pl.DataFrame) -> Figure:
    """Shares of outcomes against the size of the maze.

    table  columns size (cells a side), outcome, mean, low, high (0 to 1)
    """
    figure = Figure(figsize=(WIDTH, 3.4))
    axes = figure.subplots()
    for outcome, colour in COLOURS.items():
        line = table.filter(outcome=outcome).sort("size")
        axes.plot(line["size"], line["mean"], "o-", color=colour, linewidth=2, label=outcome)
        axes.fill_between(line["size"], line["low"], line["high"], color=colour, alpha=0.22, lw=0)
    axes.set_ylim(0, 1)
    axes.yaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
    axes.set_xticks(table["size"].unique().sort())
    axes.set_xlabel("cells a side of the maze")
    axes.grid(axis="y")
    figure.legend(loc="outside upper left", ncols=3)
    return figure
