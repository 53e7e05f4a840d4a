"""The figures of the studies of CoinRun."""

from __future__ import annotations

from typing import Any

import matplotlib
import numpy as np
import polars as pl
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from astray.analysis.outcomes import FAILED, MISGENERALIZED
from astray.experiments import figures

DARK = "#77777a"  # of a line that stands for capability failure, whose own grey is too light
LINES: dict[str, dict[str, Any]] = {
    MISGENERALIZED: {"color": figures.COLOURS[MISGENERALIZED], "marker": "o", "linestyle": "-"},
    FAILED: {"color": DARK, "marker": "s", "linestyle": "-"},
}
BASES: tuple[dict[str, Any], ...] = (
    {"color": figures.INK, "linestyle": "--"},
    {"color": figures.INK, "linestyle": ":"},
)
PALE = 0.22  # opacity of an interval


@matplotlib.rc_context(figures.STYLE)
def diversity(table: pl.DataFrame) -> Figure:
    """Shares of episodes against random_coins, a panel a test; a base rate is a level line.

    table  columns test, random_coins (%, null for a base rate), what, mean, low, high (0 to 1)
    """
    panels = table.partition_by("test", maintain_order=True)
    figure = Figure(figsize=(figures.WIDTH, 3.9))
    row = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, panel in zip(row, panels, strict=True):
        lines = panel.filter(pl.col("random_coins").is_not_null()).partition_by(
            "what", as_dict=True, maintain_order=True
        )
        for (what,), line in lines.items():
            look, x = LINES[what], line["random_coins"]
            axes.plot(x, line["mean"], markersize=4.5, linewidth=2, label=what, **look)
            axes.fill_between(x, line["low"], line["high"], color=look["color"], alpha=PALE, lw=0)
        bases = panel.filter(pl.col("random_coins").is_null()).to_dicts()
        for base, look in zip(bases, BASES, strict=True):
            axes.axhline(base["mean"], linewidth=1.4, label=base["what"], **look)
        axes.set_title(panel["test"][0])
        axes.set_xlabel("training levels with a random coin (%)")
        axes.set_ylim(0, 1)
        axes.yaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
        axes.grid(axis="y")
        axes.set_xticks(np.arange(0, 21, 5))
        axes.tick_params(labelleft=True)
    figure.legend(*row[0].get_legend_handles_labels(), loc="outside upper left", ncols=2)
    return figure
