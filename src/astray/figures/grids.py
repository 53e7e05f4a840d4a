"""Charts in cells: heat maps of two settings, and pictures with overlays."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import matplotlib
import numpy as np
import polars as pl
from matplotlib.colors import Colormap, LinearSegmentedColormap, ListedColormap
from matplotlib.figure import Figure

from astray.figures.axes import parts_of, ticks_of
from astray.figures.style import EMPTY, INK, ON_COLOUR, OTHERS, STYLE, WIDTH

# Colours of the sign and opacity of the size: 0 is clear, on light pages as on dark ones.
SIGNS = matplotlib.colormaps["coolwarm_r"].resampled(2)
FADED = np.sqrt(abs(np.arange(256) - 127.5) // 1 / 127)


@matplotlib.rc_context(STYLE)
def cells(
    data: pl.DataFrame,
    colours: Mapping[str, str],
    *,
    x: str,
    y: str,
    panel: str,
    x_label: str = "",
    y_label: str = "",
    apart: bool = False,
) -> Figure:
    """Draw fractions as cells, with intervals if there are any.

    Args:
        data: Columns `x` and `y` of the settings, `panel` and mean, low and high if there are
            intervals; a null cell is empty.
        colours: The colour of the largest fraction, by the beginning of the panel's name.
        apart: Whether a line separates the first row and column.
    """
    xs, ys, panels = ticks_of(data[x], True), ticks_of(data[y], True), parts_of(data, panel)
    wide = (1.05 if "low" in data else 0.55) * len(xs) * len(panels)
    figure = Figure(figsize=(max(WIDTH, 1.2 + wide), 1.3 + 0.62 * len(ys)))
    grid = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (name, table) in zip(grid, panels.items(), strict=True):
        (colour,) = (c for begins, c in colours.items() if name.startswith(begins))
        rates = np.full((len(ys), len(xs)), np.nan)
        for one in table.drop_nulls("mean").to_dicts():
            i, k = ys.index(one[y]), xs.index(one[x])
            rates[i, k] = one["mean"]
            interval = one.get("low") is not None
            look = {"ha": "center", "color": ON_COLOUR}
            above = "bottom" if interval else "center_baseline"
            axes.text(k, i, f"{100 * one['mean']:z.0f} %", va=above, **look)
            if interval:
                text = f"{100 * one['low']:z.0f} to {100 * one['high']:z.0f}"
                axes.text(k, i + 0.08, text, va="top", fontsize=7.5, **look)
        shades = LinearSegmentedColormap.from_list(name, ["#ffffff", colour])
        axes.imshow(rates, cmap=shades, vmin=0, vmax=1, aspect="auto")
        axes.set_title(name, fontsize=9.5)
        axes.set_xticks(range(len(xs)), [f"{one}" for one in xs])
        axes.set_yticks(range(len(ys)), [f"{one}" for one in ys])
        axes.set_xlabel(x_label or x)
        axes.tick_params(length=0)
        axes.spines[:].set_visible(False)
        if apart:
            axes.axhline(0.5, color=INK, linewidth=1)
            axes.axvline(0.5, color=INK, linewidth=1)
    grid[0].set_ylabel(y_label or y)
    return figure


@dataclass(frozen=True, eq=False)
class Picture:
    """A picture with overlays; a cell is a unit, x to the right, y upward.

    Attributes:
        title: Title above it.
        image: [H, W, 3] uint8, or grey [H, W] from 0 (black) to 1, NaN for nothing; None for no
            image.
        heat: [h, w] values shown as colours, highest row first; NaN for no colour.
        limits: The values at the ends of the colours.
        colours: matplotlib's colour map, or its name.
        label: Label of the colour bar; empty for no bar.
        opacity: Opacity of the colours: a number, or [256] from the lowest colour to the highest.
        front: [H, W, 4] uint8 of what is drawn between colours and arrows, with its opacity.
        arrows: Cells [N, 2] and arrows [N, 2] from their middles, at most a cell long.
        way: [N, 2] cells in order.
        marks: Colour of marked cells.
        letters: Letters of cells.
        window: Left, right, lowest and highest visible cells; None for all.
        note: Text below.
    """

    title: str = ""
    image: np.ndarray | None = None
    heat: np.ndarray | None = None
    limits: tuple[float, float] = (0.0, 1.0)
    colours: str | Colormap = "viridis"
    label: str = ""
    opacity: Any = 0.62
    front: np.ndarray | None = None
    arrows: tuple[np.ndarray, np.ndarray] | None = None
    way: np.ndarray | None = None
    marks: Mapping[Any, str] = field(default_factory=dict)
    letters: Mapping[Any, str] = field(default_factory=dict)
    window: tuple[float, float, float, float] | None = None
    note: str = ""


@matplotlib.rc_context(STYLE)
def images(rows: Sequence[Sequence[Picture]], size: tuple[float, float] = (2.3, 2.5)) -> Figure:
    """Draw pictures in rows, each of a size in inches."""
    width, height = size
    most = max(map(len, rows))
    figure = Figure(figsize=(width * most, height * len(rows)))
    grid = figure.subplots(len(rows), most, squeeze=False)
    for line, pictures in zip(grid, rows, strict=True):
        for axes in line[len(pictures) :]:
            axes.remove()
        for axes, one in zip(line, pictures, strict=False):
            _show(figure, axes, one)
    return figure


def _ground(one: Picture) -> Any:
    """Return the usual colour below the coloured cells."""
    if one.image is None or one.heat is None or one.image.ndim == 2:
        return EMPTY
    middles = np.argwhere(~np.isnan(one.heat)) + 0.5
    y, x = (middles * one.image.shape[:2] / one.heat.shape).astype(int).T
    return np.median(one.image[y, x], 0) / 255


def _show(figure: Figure, axes: Any, one: Picture) -> None:
    shape = one.heat if one.heat is not None else one.image
    assert shape is not None, "a picture shows an image or values"
    extent = (0, shape.shape[1], 0, shape.shape[0])
    axes.set_facecolor(EMPTY)
    ink = INK if one.letters else ON_COLOUR  # letters are on what follows a dark theme
    if one.image is not None:
        smooth = "lanczos" if one.image.ndim == 3 else "nearest"
        axes.imshow(one.image, extent=extent, cmap="gray", vmin=0, vmax=1, interpolation=smooth)
    if one.heat is not None:
        low, high = one.limits
        shades = matplotlib.colormaps.get_cmap(one.colours)(np.linspace(0, 1, 256))
        shades[:, 3] = one.opacity
        named = {"cmap": ListedColormap(shades), "label": one.label or one.title}
        shaded = axes.imshow(one.heat, extent=extent, vmin=low, vmax=high, **named)
        if one.label:
            bar = figure.colorbar(shaded, ax=axes, shrink=0.82, label=one.label, pad=0.02)
            bar.ax.set_facecolor(_ground(one))  # as below the map, as colours let it through
    if one.front is not None:
        axes.imshow(one.front, extent=extent, interpolation="lanczos")
    if one.arrows is not None:
        cells, arrows = one.arrows
        x, y = (cells + 0.5).T - 0.45 * arrows.T
        axes.quiver(
            x, y, *(0.9 * arrows.T), angles="xy", scale_units="xy", scale=1, color=ink,
            pivot="tail", units="x", width=0.09, headwidth=3.2, headlength=3.2, headaxislength=3,
            edgecolor="white", linewidth=0.4,
        )  # fmt: skip
    if one.way is not None:
        shift = np.linspace(0.38, 0.62, len(one.way))  # so that a way back can be seen
        axes.plot(one.way[:, 0] + shift, one.way[:, 1] + 1 - shift, color=OTHERS[0], linewidth=1.6)
    for (x, y), colour in one.marks.items():
        axes.plot(x + 0.5, y + 0.5, "s", color=colour, markersize=8)
    for (x, y), letter in one.letters.items():
        axes.text(
            x + 0.5, y + 0.5, letter, ha="center", va="center", fontsize=9, clip_on=True, color=ink
        )
    if one.window:
        axes.set_xlim(*one.window[:2])
        axes.set_ylim(*one.window[2:])
    axes.set_title(one.title, fontsize=9.5)
    axes.set_xlabel(one.note, fontsize=9)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[["left", "bottom"]].set_visible(False)
