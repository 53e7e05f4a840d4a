"""Figures of fields: arrows and values over levels, side by side."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import Normalize, TwoSlopeNorm
from matplotlib.figure import Figure

from astray.bounds import of_kind
from astray.envs.vector import picture
from astray.game import OWN
from astray.insight.fields import Change, Field
from astray.insight.interventions import sees_world
from astray.level import EMPTY, Level
from astray.report.style import INK, STYLE, save

__all__ = ["draw", "draw_paths", "heat_map", "save"]
PIXELS = 480  # a side of a level's picture
VEIL = 0.45  # of white before the picture, so that arrows are seen
SIDE = 4.2  # inches of a panel
SHADE = 0.62  # opacity of what is coloured by value
VALUES, CHANGES, PATHS = "viridis", "RdBu_r", "magma"  # told apart by every colour vision
LEAST_CHANGE = 1e-6  # of values, so that a change of none has a scale


@matplotlib.rc_context(STYLE)
def draw(panels: Mapping[str, Field | Change], *, art: str = OWN) -> Figure:
    """Draw fields and differences in a row, with titles.

    A cell's colour is its value and an arrow its expected step, at most a cell long; in a
    difference both are changes. Fields share one colour scale.
    """
    of_kind("panels", panels, Mapping)
    if not panels:
        raise ValueError("panels must be fields by title, at least one; none is given")
    figure, row = _row(len(panels))
    values = [one.value for one in panels.values() if isinstance(one, Field)]
    scale = Normalize(min(map(np.min, values)), max(map(np.max, values))) if values else None
    for axes, (title, one) in zip(row, panels.items(), strict=True):
        _background(axes, one.level, art)
        if isinstance(one, Field):
            assert scale is not None
            shaded = _shade(axes, one.level, one.cells, one.value, scale, VALUES)
        else:
            most = max(abs(one.value).max(), LEAST_CHANGE)
            shaded = _shade(
                axes, one.level, one.cells, one.value, TwoSlopeNorm(0, -most, most), CHANGES
            )
        _arrows(axes, one.cells, one.arrows)
        axes.set_title(title)
        label = "value" if isinstance(one, Field) else "change of value"
        figure.colorbar(shaded, ax=axes, shrink=0.82, label=label, pad=0.02)
    return figure


@matplotlib.rc_context(STYLE)
def draw_paths(panels: Mapping[str, Field], *, art: str = OWN) -> Figure:
    """Draw the preference for the way to each cell: geometric means of step probabilities."""
    if not panels:
        raise ValueError("panels must be fields by title, at least one; none is given")
    figure, row = _row(len(panels))
    for axes, (title, one) in zip(row, panels.items(), strict=True):
        _background(axes, one.level, art)
        ways = one.path_probability()
        shaded = _shade(
            axes,
            one.level,
            np.array(list(ways)),
            np.array(list(ways.values())),
            Normalize(0, 1),
            PATHS,
        )
        axes.set_title(title)
        figure.colorbar(shaded, ax=axes, shrink=0.82, label="path probability", pad=0.02)
    return figure


def heat_map(
    axes: Axes,
    level: Level,
    heat: Mapping[Any, float],
    *,
    art: str = OWN,
    scale: Normalize | None = None,
    colours: str = PATHS,
) -> Any:
    """Colour cells of a level by numbers; return the argument for `Figure.colorbar`."""
    _background(axes, level, art)
    cells, values = np.array(list(heat)), np.array(list(heat.values()))
    return _shade(axes, level, cells, values, scale or Normalize(0, 1), colours)


def _row(count: int) -> tuple[Figure, list[Axes]]:
    figure = Figure(figsize=(SIDE * count * 1.12, SIDE))
    return figure, list(figure.subplots(1, count, squeeze=False)[0])


def _background(axes: Axes, level: Level, art: str) -> None:
    """Draw the level's picture, faded; a cell is a unit of the axes.

    If the agent sees only a window of the world, walls are grey instead.
    """
    if not sees_world(level.variant):
        legend = level.game.editing.LEGEND
        free = [legend[EMPTY], *(legend[char] for char in level.game.editing.OBJECTS.values())]
        height, width = level.cells.shape
        axes.imshow(
            np.where(np.isin(level.cells, free), 1.0, 0.75),
            extent=(0, width, 0, height),
            origin="lower",
            cmap="gray",
            vmin=0,
            vmax=1,
        )
        _bare(axes)
        return
    state = np.array([level.state(solvable=False)], level.game.state)
    image = picture(level.game, level.variant, state, PIXELS, art)[0]
    height, width = level.cells.shape
    veiled = (255 * VEIL + (1 - VEIL) * image).astype(np.uint8)
    axes.imshow(veiled, extent=(0, width, 0, height), interpolation="lanczos")
    _bare(axes)


def _bare(axes: Axes) -> None:
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[["left", "bottom"]].set_visible(False)


def _shade(
    axes: Axes, level: Level, cells: np.ndarray, values: np.ndarray, scale: Normalize, colours: str
) -> Any:
    height, width = level.cells.shape
    grid = np.full((height, width), np.nan)
    grid[cells[:, 1], cells[:, 0]] = values
    extent = (0, width, 0, height)
    shaded = axes.imshow(grid, extent=extent, origin="lower", norm=scale, cmap=colours, alpha=SHADE)
    if not sees_world(level.variant):  # most of such a world is nothing
        (left, low), (right, high) = cells.min(0) - 1, cells.max(0) + 2
        axes.set_xlim(max(left, 0), min(right, width))
        axes.set_ylim(max(low, 0), min(high, height))
    return shaded


def _arrows(axes: Axes, cells: np.ndarray, arrows: np.ndarray) -> None:
    x, y = (cells + 0.5).T - 0.45 * arrows.T
    axes.quiver(
        x,
        y,
        *(0.9 * arrows.T),
        angles="xy",
        scale_units="xy",
        scale=1,
        color=INK,
        pivot="tail",
        units="x",
        width=0.09,
        headwidth=3.2,
        headlength=3.2,
        headaxislength=3,
        edgecolor="white",
        linewidth=0.4,
    )
