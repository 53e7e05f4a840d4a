"""Figures of sweeps: how a share depends on one setting, or on two."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
import polars as pl
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from astray.analysis.outcomes import INTENDED, MISGENERALIZED
from astray.experiments.figures import COLOURS, INK, STYLE, WIDTH


def _colour(what: str) -> str:
    return COLOURS[MISGENERALIZED if what.startswith(MISGENERALIZED) else INTENDED]


def _values(data: pl.DataFrame, name: str) -> list[Any]:
    """The values of a setting: numbers ascending, words as they come."""
    values = data[name].unique(maintain_order=True)
    return values.sort().to_list() if values.dtype.is_numeric() else values.to_list()


@matplotlib.rc_context(STYLE)
def grid(data: pl.DataFrame, across: str, up: str) -> Figure:
    """Two settings: a panel for each `what`, in it a cell for each two values, shaded by the share.

    data  columns of the two settings, what, mean, low, high (shares)
    """
    xs, ys = _values(data, across), _values(data, up)
    panels = data.partition_by("what", maintain_order=True)
    figure = Figure(figsize=(max(WIDTH, 1.2 + 2 * 1.05 * len(xs)), 1.3 + 0.62 * len(ys)))
    for axes, panel in zip(figure.subplots(1, len(panels), sharey=True), panels, strict=True):
        _cells(axes, panel, (across, xs), (up, ys))
    return figure


def _cells(axes: Axes, panel: pl.DataFrame, across: tuple[str, list], up: tuple[str, list]) -> None:
    """One panel of cells, each with its share and the interval of it."""
    what = panel["what"][0]
    shades = LinearSegmentedColormap.from_list(what, ["#ffffff", _colour(what)])
    shares = np.full((len(up[1]), len(across[1])), np.nan)
    for row in panel.to_dicts():
        y, x = up[1].index(row[up[0]]), across[1].index(row[across[0]])
        shares[y, x] = row["mean"]
        axes.text(x, y, f"{100 * row['mean']:.0f} %", ha="center", va="bottom", color=INK)
        axes.text(
            x,
            y + 0.08,
            f"{100 * row['low']:.0f} to {100 * row['high']:.0f}",
            ha="center",
            va="top",
            color=INK,
            fontsize=7.5,
        )
    axes.imshow(shares, cmap=shades, vmin=0, vmax=1, aspect="auto")
    axes.set_title(what, fontsize=9.5)
    axes.set_xticks(range(len(across[1])), [f"{x}" for x in across[1]])
    axes.set_yticks(range(len(up[1])), [f"{y}" for y in up[1]])
    axes.set_xlabel(across[0])
    if axes.get_subplotspec().is_first_col():  # pyright: ignore
        axes.set_ylabel(up[0])
    axes.tick_params(length=0)
    axes.spines[:].set_visible(False)


@matplotlib.rc_context(STYLE)
def line(data: pl.DataFrame, across: str) -> Figure:
    """One setting: a line of points with 95 % intervals for each `what`.

    data  columns of the setting, what, mean, low, high (shares)
    """
    xs = _values(data, across)
    figure = Figure(figsize=(WIDTH, 3.4))
    axes = figure.subplots()
    for panel in data.partition_by("what", maintain_order=True):
        rows = {row[across]: row for row in panel.to_dicts()}
        means = np.array([rows[x]["mean"] for x in xs])
        ends = np.array([[rows[x]["low"], rows[x]["high"]] for x in xs]).T
        what = panel["what"][0]
        axes.errorbar(
            range(len(xs)),
            means,
            np.abs(ends - means),
            color=_colour(what),
            label=what,
            marker="o",
            linewidth=2,
            capsize=3,
        )
    axes.set_xticks(range(len(xs)), [f"{x}" for x in xs])
    axes.set_xlabel(across)
    axes.set_xlim(-0.3, len(xs) - 0.7)
    axes.set_ylim(-0.03, 1.03)
    axes.yaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
    axes.grid(axis="y")
    figure.legend(loc="outside upper left", ncols=2)
    return figure
