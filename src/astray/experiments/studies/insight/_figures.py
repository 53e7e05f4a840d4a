"""The figures of studies that look into agents."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from astray.experiments import figures

GREY = "#8c8c88"
PALE = 0.2  # opacity of an interval


@matplotlib.rc_context(figures.STYLE)
def depth(table: pl.DataFrame, plain: float, without: float) -> Figure:
    """A probability by the layer that is changed, beside that of no change and of no cheese.

    table  columns layer, mean, low, high, in the network's order
    """
    figure = Figure(figsize=(figures.WIDTH, 1.1 + 0.34 * len(table)))
    axes = figure.subplots()
    y = np.arange(len(table))
    axes.errorbar(
        table["mean"], y, xerr=_whiskers(table), fmt="o", color=figures.OTHERS[0], capsize=3
    )
    axes.axvline(plain, color=figures.INK, linestyle="--", linewidth=1, label="nothing changed")
    axes.axvline(without, color=figures.INK, linestyle=":", linewidth=1.4, label="no cheese")
    axes.set_yticks(y, table["layer"].to_list())
    axes.set_ylim(len(table) - 0.5, -0.5)
    axes.set_xlim(0, 1)
    axes.grid(axis="x")
    axes.set_xlabel("probability of the next step to the cheese")
    figure.legend(loc="outside upper left", ncols=2)
    return figure


@matplotlib.rc_context(figures.STYLE)
def dose(table: pl.DataFrame, random: pl.DataFrame) -> Figure:
    """A probability by the coefficient of a vector, and of random ones.

    table, random  columns coefficient, mean, low, high
    """
    figure = Figure(figsize=(figures.WIDTH, 3.4))
    axes = figure.subplots()
    for part, colour, name in (
        (random, GREY, "random vectors of the same length"),
        (table, figures.OTHERS[0], "cheese vectors"),
    ):
        x = part["coefficient"].to_numpy()
        axes.plot(x, part["mean"], color=colour, marker="o", linewidth=2, label=name)
        axes.fill_between(x, part["low"], part["high"], color=colour, alpha=PALE, linewidth=0)
    axes.axvline(0, color=figures.INK, linewidth=0.8)
    axes.set_ylim(0, 1)
    axes.grid(axis="y")
    axes.set_xlabel("coefficient")
    axes.set_title("probability of the next step to the cheese", fontweight="normal", fontsize=10.5)
    figure.legend(loc="outside upper left", ncols=2)
    return figure


@matplotlib.rc_context(figures.STYLE)
def targets(panels: Mapping[str, pl.DataFrame], side: int) -> Figure:
    """How an agent takes to each cell, by how it is to be sent there: a heat map a panel.

    panels  columns x, y, mean: of all levels, in cells of a world of `side`
    """
    figure = Figure(figsize=(2.45 * len(panels), 3.0))
    row = figure.subplots(1, len(panels), squeeze=False)[0]
    shown: Any = None
    for axes, (title, table) in zip(row, panels.items(), strict=True):
        grid = np.full((side, side), np.nan)
        grid[table["y"].to_numpy(), table["x"].to_numpy()] = table["mean"].to_numpy()
        axes.set_facecolor("#eeeeec")  # where there is no target
        shown = axes.imshow(grid, origin="lower", vmin=0, vmax=1, cmap="magma")
        axes.set_title(title, fontsize=9.5)
        axes.set_xticks([])
        axes.set_yticks([])
        axes.spines[["left", "bottom"]].set_visible(False)
    figure.colorbar(shown, ax=list(row), shrink=0.75, label="path probability", pad=0.01)
    return figure


@matplotlib.rc_context(figures.STYLE)
def probes(table: pl.DataFrame, labels: list[str]) -> Figure:
    """What probes read, layer by layer, beside their controls: a panel a label.

    table  as `probes.summary` returns it
    """
    columns = 2 if len(labels) > 1 else 1
    count = -(-len(labels) // columns)
    figure = Figure(figsize=(figures.WIDTH, 0.6 + 2.6 * count))
    grid = figure.subplots(count, columns, squeeze=False, sharex=True)
    for axes, label in zip(grid.flat, labels, strict=False):
        _probe(axes, table.filter(label=label), label)
    for axes in list(grid.flat)[len(labels) :]:
        axes.set_visible(False)
    handles, names = grid.flat[0].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside upper left", ncols=4, handlelength=1.6)
    return figure


def _probe(axes: Axes, table: pl.DataFrame, label: str) -> None:
    x = np.arange(len(table))
    for name, colour, marker, called in (
        ("score", figures.OTHERS[0], "o", "trained network"),
        ("untrained", figures.OTHERS[1], "s", "never trained"),
        ("shuffled", GREY, "v", "labels shuffled"),
    ):
        means = table[name].cast(pl.Float64).fill_null(float("nan")).to_numpy()
        axes.plot(x, means, color=colour, marker=marker, linewidth=1.6, label=called)
        low, high = (
            table[f"{name} {end}"].cast(pl.Float64).fill_null(float("nan")).to_numpy()
            for end in ("low", "high")
        )
        axes.fill_between(x, low, high, color=colour, alpha=PALE, linewidth=0)
    axes.axhline(
        table["chance"][0], color=figures.INK, linestyle=":", linewidth=1.2, label="without looking"
    )
    axes.set_xticks(x, table["layer"].to_list(), rotation=50, ha="right", fontsize=8.5)
    numbers = table["kind"][0] == "number"
    axes.set_ylim(-0.25 if numbers else 0, 1.03)
    axes.set_title(f"{label} ({'R squared' if numbers else 'balanced accuracy'})", fontsize=9.5)
    axes.grid(axis="y")


@matplotlib.rc_context(figures.STYLE)
def coefficients(table: pl.DataFrame) -> Figure:
    """What predicts an outcome: coefficients with intervals, the largest on top.

    table  as `behaviour.Prediction.features`
    """
    table = table.sort(pl.col("coefficient").abs(), descending=True)
    figure = Figure(figsize=(figures.WIDTH, 1.0 + 0.34 * len(table)))
    axes = figure.subplots()
    y = np.arange(len(table))
    x = table["coefficient"].to_numpy()
    low, high = table["low"].to_numpy(), table["high"].to_numpy()
    axes.hlines(y, low, high, color=figures.OTHERS[0], linewidth=1.6)
    axes.plot(x, y, "o", color=figures.OTHERS[0])
    axes.axvline(0, color=figures.INK, linewidth=0.8)
    axes.set_yticks(y, table["feature"].to_list())
    axes.set_ylim(len(table) - 0.5, -0.5)
    axes.grid(axis="x")
    axes.set_xlabel("log odds of the cheese, a standard deviation more")
    return figure


def _whiskers(part: pl.DataFrame) -> np.ndarray:
    low, mean, high = (part[column].to_numpy() for column in ("low", "mean", "high"))
    return np.stack([np.maximum(mean - low, 0), np.maximum(high - mean, 0)])
