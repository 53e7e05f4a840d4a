"""The figures of the studies of CoinRun."""

from __future__ import annotations

import textwrap
from collections.abc import Sequence
from typing import Any

import matplotlib
import numpy as np
import polars as pl
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from astray.analysis.outcomes import FAILED, INTENDED, MISGENERALIZED
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
SHADES = ("#1f4e79", "#6fa3cf", "#cfd8de")  # of methods, told apart in grey too
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


@matplotlib.rc_context(figures.STYLE)
def stages(bars: pl.DataFrame) -> Figure:
    """Bars of values by stage, with a coin in view and without.

    bars  columns stage, coin (bool), mean, low, high, rows (how many states)
    """
    figure = Figure(figsize=(figures.WIDTH, 3.6))
    axes = figure.subplots()
    names = bars["stage"].unique(maintain_order=True).to_list()
    looks = {
        False: ("no coin in view", figures.COLOURS[FAILED], -0.2),
        True: ("coin in view", figures.COLOURS[INTENDED], 0.2),
    }
    lowest = min(0.0, bars["low"].min() or 0.0)  # type: ignore[type-var]
    for coin, (label, colour, shift) in looks.items():
        part = bars.filter(coin=coin)
        x = np.array([names.index(stage) for stage in part["stage"]]) + shift
        axes.bar(x, part["mean"], 0.38, color=colour, label=label)
        axes.errorbar(
            x,
            part["mean"],
            yerr=_whiskers(part),
            fmt="none",
            ecolor=figures.INK,
            elinewidth=1.3,
            capsize=3,
        )
        for at, rows in zip(x, part["rows"], strict=True):
            axes.annotate(
                f"n = {rows:,}",
                (at, lowest),
                (0, 3),
                textcoords="offset points",
                ha="center",
                fontsize=8,
            )
    axes.set_xticks(range(len(names)), names)
    axes.tick_params(axis="x", length=0)
    axes.grid(axis="y")
    axes.set_title("the critic's value", fontweight="normal", fontsize=10.5)
    figure.legend(loc="outside upper left", ncols=2, handlelength=1, handleheight=1)
    return figure


@matplotlib.rc_context(figures.STYLE)
def effects(table: pl.DataFrame) -> Figure:
    """What a coin adds, by stage and by how it came or went.

    table  columns stage, coin_is, mean, low, high
    """
    figure = Figure(figsize=(figures.WIDTH, 3.0))
    axes = figure.subplots()
    names = table["stage"].unique(maintain_order=True).to_list()
    kinds = table["coin_is"].unique().sort().to_list()
    for k, (kind, marker) in enumerate(zip(kinds, "os", strict=False)):
        part = table.filter(coin_is=kind)
        x = np.array([names.index(stage) for stage in part["stage"]]) + 0.16 * (k - 0.5)
        axes.errorbar(
            x,
            part["mean"],
            yerr=_whiskers(part),
            fmt=marker,
            color=figures.OTHERS[k],
            capsize=3,
            label=f"coin {kind}",
        )
    axes.axhline(0, color=figures.INK, linewidth=0.8)
    axes.set_xticks(range(len(names)), names)
    axes.set_xlim(-0.5, len(names) - 0.5)
    axes.grid(axis="y")
    axes.set_title("value with the coin, less without it", fontweight="normal", fontsize=10.5)
    figure.legend(loc="outside upper left", ncols=2)
    return figure


def _whiskers(part: pl.DataFrame) -> np.ndarray:
    """How far intervals go below and above their means, [2, N]."""
    low, mean, high = (part[column].to_numpy() for column in ("low", "mean", "high"))
    return np.stack([mean - low, high - mean])


@matplotlib.rc_context(figures.STYLE)
def approach(ways: pl.DataFrame, columns: int) -> Figure:
    """The value by the distance to the wall.

    ways     columns cells (from the wall's face, negative before it), mean, low, high
    columns  of the wall
    """
    figure = Figure(figsize=(figures.WIDTH, 3.4))
    axes = figure.subplots()
    x, colour = ways["cells"] + 0.5, figures.OTHERS[0]
    axes.axvspan(0, columns, color=figures.FAINT, alpha=0.5, lw=0)
    axes.plot(x, ways["mean"], color=colour, linewidth=2.4)
    axes.fill_between(x, ways["low"], ways["high"], color=colour, alpha=PALE, lw=0)
    axes.margins(x=0)
    axes.grid(axis="y")
    axes.set_xlabel("cells from the wall's face to the runner's front; shaded: the wall")
    axes.set_title("the critic's value", fontweight="normal", fontsize=10.5)
    return figure


@matplotlib.rc_context(figures.STYLE)
def episode(data: pl.DataFrame, drawn: Sequence[int], pictures: np.ndarray) -> Figure:
    """The value along an episode, below pictures of some of its steps.

    data      columns step, value, to_wall (cells, below 0 in the wall)
    drawn     the steps of `pictures` [N, P, P, 3] uint8, in order
    """
    figure = Figure(figsize=(figures.WIDTH, 4.2))
    grid = figure.add_gridspec(2, len(drawn), height_ratios=[1, 2.2])
    axes = figure.add_subplot(grid[1, :])
    colour = figures.OTHERS[0]
    axes.plot(data["step"], data["value"], color=colour, linewidth=2)
    inside = data.filter(pl.col("to_wall") < 0)["step"]
    if len(inside):
        axes.axvspan(inside[0], data["step"][-1], color=figures.FAINT, alpha=0.5, lw=0)
    values = data["value"].to_numpy()[list(drawn)]
    axes.plot(drawn, values, "o", color=colour, markersize=6)
    for k, (step, picture) in enumerate(zip(drawn, pictures, strict=True)):
        small = figure.add_subplot(grid[0, k])
        small.imshow(picture)
        small.set_xticks([])
        small.set_yticks([])
        small.spines[:].set_visible(False)
        small.set_title(f"step {step}", fontweight="normal", fontsize=10, pad=4)
    axes.margins(x=0.01)
    axes.grid(axis="y")
    axes.set_xlabel("step")
    axes.set_title("the critic's value", fontweight="normal", fontsize=10.5)
    return figure


@matplotlib.rc_context(figures.STYLE)
def parts(bars: pl.DataFrame, sizes: pl.DataFrame) -> Figure:
    """Shares of attribution: a panel a test, a group of bars a part, a bar a method.

    bars   columns test, method, part, mean, low, high (0 to 1)
    sizes  columns test, part, area: marked beside the bars
    """
    panels = sizes["test"].unique(maintain_order=True).to_list()
    names = sizes["part"].unique(maintain_order=True).to_list()
    methods = bars["method"].unique(maintain_order=True).sort().to_list()
    figure = Figure(figsize=(figures.WIDTH, 0.9 + 3.1 * len(panels)))
    rows = figure.subplots(len(panels), 1, sharex=True, squeeze=False)[:, 0]
    height = 0.8 / len(methods)
    for axes, test in zip(rows, panels, strict=True):
        for number, (method, colour) in enumerate(zip(methods, SHADES, strict=True)):
            part = bars.filter(test=test, method=method)
            y = np.array([names.index(name) for name in part["part"]])
            at = y + height * (number - (len(methods) - 1) / 2)
            axes.barh(
                at,
                part["mean"],
                height * 0.9,
                color=colour,
                label=method,
                xerr=_whiskers(part),
                error_kw={"ecolor": figures.INK, "elinewidth": 1},
            )
        size = sizes.filter(test=test)
        axes.plot(
            size["area"],
            [names.index(name) for name in size["part"]],
            "D",
            markersize=4.5,
            color=figures.INK,
            markerfacecolor="white",
            label="share of what is seen",
        )
        axes.set_yticks(range(len(names)), names)
        axes.set_ylim(len(names) - 0.5, -0.5)
        axes.xaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
        axes.grid(axis="x")
        axes.set_title(test)
    rows[-1].set_xlabel("share of attribution")
    figure.legend(
        *rows[0].get_legend_handles_labels(), loc="outside upper left", ncols=4, handlelength=1
    )
    return figure


@matplotlib.rc_context(figures.STYLE)
def maps(examples: pl.DataFrame) -> Figure:
    """A row for each example: its picture, then its map by each method over it.

    examples  columns name, picture (rows of grey, 0 to 255), and maps by method (rows of -1 to 1)
    """
    methods = [name for name in examples.columns if name not in ("name", "picture")]
    figure = Figure(figsize=(figures.WIDTH, 0.3 + 1.95 * len(examples)))
    grid = figure.subplots(len(examples), 1 + len(methods), squeeze=False)
    for axes, example in zip(grid, examples.to_dicts(), strict=True):
        image = np.array(example["picture"], float)
        for panel, method in zip(axes, (None, *methods), strict=True):
            panel.imshow(image, cmap="gray", vmin=0, vmax=255, alpha=1 if method is None else 0.35)
            if method:
                one = np.array(example[method])
                side = (-0.5, image.shape[1] - 0.5, image.shape[0] - 0.5, -0.5)
                panel.imshow(
                    one, cmap="RdBu", vmin=-1, vmax=1, alpha=np.sqrt(abs(one)), extent=side
                )
            panel.set_xticks([])
            panel.set_yticks([])
            panel.spines[:].set_visible(True)
        axes[0].set_ylabel(textwrap.fill(example["name"], 16), fontsize=9)
    for panel, method in zip(grid[0], ("state", *methods), strict=True):
        panel.set_title(method, fontsize=9.5)
    return figure


@matplotlib.rc_context(figures.STYLE)
def calibration(table: pl.DataFrame) -> Figure:
    """Returns against the values that expected them.

    table  columns expected, mean, low, high
    """
    figure = Figure(figsize=(4.6, 3.9))
    axes = figure.subplots()
    both = table.select("expected", "mean").to_numpy()
    axes.axline((both.min(), both.min()), slope=1, color=figures.INK, linewidth=0.8)
    axes.errorbar(
        table["expected"],
        table["mean"],
        yerr=_whiskers(table),
        fmt="o",
        capsize=3,
        color=figures.OTHERS[0],
    )
    axes.grid()
    axes.set_xlabel("the critic's value")
    axes.set_title("discounted return that came", fontweight="normal", fontsize=10.5)
    return figure


FATE_SHADES = ("#2fa393", "#f0a03c", "#8c8c92", "#d2d2ce")  # as of outcomes; who died is darker


@matplotlib.rc_context(figures.STYLE)
def fates(table: pl.DataFrame, order: Sequence[str]) -> Figure:
    """A bar for each test, of what became of its episodes.

    table  columns test, fate (of `order`), mean (0 to 1)
    """
    tests = table["test"].unique(maintain_order=True).to_list()
    figure = Figure(figsize=(figures.WIDTH, 0.9 + 0.5 * len(tests)))
    axes = figure.subplots()
    left = np.zeros(len(tests))
    for name, colour in zip(order, FATE_SHADES, strict=True):
        part = dict(table.filter(fate=name).select("test", "mean").iter_rows())
        share = np.array([part.get(test, 0.0) for test in tests])
        axes.barh(tests, share, 0.66, left, color=colour, edgecolor="white", label=name)
        for y, (begin, size) in enumerate(zip(left, share, strict=True)):
            if size >= figures.NARROWEST:
                axes.text(begin + size / 2, y, f"{100 * size:.0f} %", ha="center", va="center")
        left += share
    axes.invert_yaxis()
    axes.set_xlim(0, 1)
    axes.xaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
    axes.tick_params(length=0)
    axes.spines[["left", "bottom"]].set_visible(False)
    axes.set_xlabel("share of episodes")
    figure.legend(loc="outside upper left", ncols=4, handlelength=1, handleheight=1)
    return figure


@matplotlib.rc_context(figures.STYLE)
def gains(table: pl.DataFrame) -> Figure:
    """Differences of shares with their intervals, a line for each group.

    table  columns by, group, mean, low, high (-1 to 1), rows
    """
    figure = Figure(figsize=(figures.WIDTH, 0.8 + 0.36 * len(table)))
    axes = figure.subplots()
    names = [f"{row['group']} (n = {row['rows']:,})" for row in table.to_dicts()]
    axes.errorbar(
        table["mean"],
        range(len(table)),
        xerr=_whiskers(table),
        fmt="o",
        capsize=3,
        color=figures.OTHERS[0],
    )
    axes.axvline(0, color=figures.INK, linewidth=0.8)
    axes.set_yticks(range(len(table)), names)
    axes.set_ylim(len(table) - 0.5, -0.5)
    axes.xaxis.set_major_formatter(PercentFormatter(1, symbol=" %"))
    axes.grid(axis="x")
    axes.set_xlabel("taken where it is seen, less touched where it is not")
    return figure
