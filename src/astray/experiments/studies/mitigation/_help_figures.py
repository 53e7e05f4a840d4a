"""The figures of asking for help."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import cycle

import matplotlib
import numpy as np
import polars as pl
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from astray.experiments import figures

NEVER = "never"
STYLES = ("-", "--", ":")
MARKERS = "osD^v<>P*X"
SHADES = {
    "before it was seen": "#2fa393",
    "seen, not passed": "#9fd3c7",
    "after it was passed": "#f0a03c",
    NEVER: "#d2d2ce",
}


@matplotlib.rc_context(figures.STYLE)
def help_curves(table: pl.DataFrame) -> Figure:
    """Return against the share of help, a panel for each agent and granularity.

    table  columns agent, granularity, score, help (0 to 1), return
    """
    panels = table.partition_by("agent", "granularity", maintain_order=True)
    rows = -(-len(panels) // 2)
    figure = Figure(figsize=(figures.WIDTH, 1.2 + 2.9 * rows))
    grid = figure.subplots(rows, 2, squeeze=False)
    for axes in grid.flat[len(panels) :]:
        axes.remove()
    scores = table["score"].unique(maintain_order=True).to_list()
    colours = [c for c, _ in zip(cycle(figures.OTHERS), scores, strict=False)]
    looks = {
        score: {
            "color": colour,
            "linestyle": STYLES[k // len(figures.OTHERS)],
            "marker": MARKERS[k],
        }
        for k, (score, colour) in enumerate(zip(scores, colours, strict=True))
    }
    for axes, panel in zip(grid.flat, panels, strict=False):
        for (score,), line in panel.group_by(["score"], maintain_order=True):
            line = line.sort("help")
            axes.plot(line["help"], line["return"], label=score, lw=1.5, ms=3.5, **looks[score])  # pyright: ignore
        axes.set_title(f"{panel['agent'][0]}: help by the {panel['granularity'][0]}")
        axes.set_xlabel(f"share of {panel['granularity'][0]}s with help")
        axes.xaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
        axes.grid()
    for axes in grid[:, 0]:
        axes.set_ylabel("return")
    labels = {}
    for axes in figure.axes:
        labels |= dict(zip(*axes.get_legend_handles_labels()[::-1], strict=True))
    figure.legend(labels.values(), labels.keys(), loc="outside upper left", ncols=3, fontsize=9)
    return figure


@matplotlib.rc_context(figures.STYLE)
def moments(table: pl.DataFrame, order: Sequence[str]) -> Figure:
    """When help would first have been asked for: a panel an agent, a bar a score.

    table  columns agent, score, moment (of `order`), share (0 to 1)
    """
    panels = table.partition_by("agent", maintain_order=True)
    bars = [panel["score"].n_unique() for panel in panels]
    figure = Figure(figsize=(figures.WIDTH, 1.0 + sum(0.34 * n + 0.6 for n in bars)))
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False, height_ratios=bars)[:, 0]
    for axes, panel in zip(rows, panels, strict=True):
        names = panel["score"].unique(maintain_order=True).to_list()
        left = np.zeros(len(names))
        for moment in order:
            share = dict(panel.filter(moment=moment).select("score", "share").iter_rows())
            width = np.array([share.get(name, 0.0) for name in names])
            axes.barh(
                names, width, 0.7, left, color=SHADES[moment], edgecolor="white", label=moment
            )
            for y, (begin, size) in enumerate(zip(left, width, strict=True)):
                if size >= figures.NARROWEST:
                    axes.text(
                        begin + size / 2,
                        y,
                        f"{100 * size:.0f} %",
                        ha="center",
                        va="center_baseline",
                        fontsize=9,
                    )
            left += width
        axes.invert_yaxis()
        axes.set_xlim(0, 1)
        axes.set_title(panel["agent"][0])
        axes.tick_params(length=0)
        axes.spines[["left", "bottom"]].set_visible(False)
    rows[-1].xaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
    rows[-1].set_xlabel("share of the episodes that misgeneralize without help")
    figure.legend(
        *rows[0].get_legend_handles_labels(),
        loc="outside upper left",
        ncols=4,
        handlelength=1,
        handleheight=1,
    )
    return figure
