"""Figures of fields: arrows and values over levels, side by side."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from astray.envs.pictures import picture
from astray.figures.grids import Picture, images
from astray.figures.style import WIDTH, save
from astray.game import OWN
from astray.insight.fields import Change, Field, states_at
from astray.insight.interventions import sees_world
from astray.level import EMPTY, Level
from astray.validation import of_kind

__all__ = ["draw", "draw_paths", "heat_map", "save", "side_by_side"]
PIXELS = 480  # a side of a level's picture
VEIL = 0.45  # of white before the picture, so that arrows are seen
SIZE, SMALLER = (4.7, 4.2), (3.5, 3.1)  # inches of a panel, with its bar of colours; of several
FLAT = 0.7  # height of a level's drawing over its width, below which panels lie one upon the other
VALUES, CHANGES = "viridis", "RdBu_r"  # told apart by every colour vision
LEAST_CHANGE = 0.01  # of values, so that a change of none has a scale


def draw(panels: Mapping[str, Field | Change], *, art: str = OWN) -> Figure:
    """Draw fields and differences in a row, with titles; raise ValueError if there are none.

    A cell's colour is its value and an arrow its expected step, at most a cell long; in a
    difference both are changes. Fields share one colour scale.
    """
    of_kind("panels", panels, Mapping)
    _check_any(panels)
    values = [one.value for one in panels.values() if isinstance(one, Field)]
    row = []
    for title, one in panels.items():
        most = max(abs(one.value).max(), LEAST_CHANGE)
        limits, colours, label = (-most, most), CHANGES, "change of value"
        if isinstance(one, Field):
            limits = min(map(np.min, values)), max(map(np.max, values))
            colours, label = VALUES, "value"
        if np.isnan(one.value).all():  # of a policy that has none
            limits, label = (0.0, 1.0), ""
        row.append(
            heat_map(
                one.level, dict(zip(map(tuple, one.cells), one.value, strict=True)), art=art,
                colours=colours, title=title, label=label, limits=limits,
                arrows=(one.cells, one.arrows),
            )
        )  # fmt: skip
    return side_by_side(row)


def draw_paths(panels: Mapping[str, Field], *, art: str = OWN) -> Figure:
    """Draw the preference for the way to each cell; raise ValueError if there are no fields.

    The preference is the geometric mean of step probabilities.
    """
    _check_any(panels)
    ways = {title: (one.level, one.path_probability()) for title, one in panels.items()}
    row = [
        heat_map(*one, art=art, title=title, label="path probability")
        for title, one in ways.items()
    ]
    return side_by_side(row)


def side_by_side(row: Sequence[Picture]) -> Figure:
    """Draw pictures of levels in the same cells: in a row, or in a column if they are flat."""
    if windows := [one.window for one in row if one.window]:
        low, high = np.min(windows, 0), np.max(windows, 0)
        window = (low[0], high[1], low[2], high[3])
        row = [replace(one, window=window) for one in row]
        flat = (window[3] - window[2]) / (window[1] - window[0])
        if flat < FLAT:
            return images([[one] for one in row], (WIDTH, 0.6 + 0.8 * WIDTH * flat))
    return images([row], SIZE if len(row) == 1 else SMALLER)


def heat_map(level: Level, heat: Mapping[Any, float], *, art: str = OWN, **how: Any) -> Picture:
    """Colour cells of a level by numbers; further arguments are those of `Picture`."""
    height, width = level.cells.shape
    cells = np.array(list(heat))
    grid = np.full((height, width), np.nan)
    grid[cells[:, 1], cells[:, 0]] = list(heat.values())
    window = None
    if sees_world(level.variant):
        states = states_at(level, [level.agent, *(one for one in heat if one != level.agent)][:2])
        image, how["front"] = _agent(level, picture(level.game, level.variant, states, PIXELS, art))
        image = (255 * VEIL + (1 - VEIL) * image).astype(np.uint8)
    else:
        legend = level.game.editing.LEGEND
        free = [legend[EMPTY], *(legend[char] for char in level.game.editing.OBJECTS.values())]
        image = np.where(np.isin(level.cells, free), np.nan, 0.65)[::-1]
        how["letters"] = {
            cell: char
            for name, char in level.game.editing.OBJECTS.items()
            for cell in level.where(name)
        }
        seen = np.array([*cells.tolist(), level.agent, *how["letters"]])
        (left, low), (right, high) = seen.min(0) - 1, seen.max(0) + 2
        window = max(left, 0), min(right, width), max(low, 0), min(high, height)
    return Picture(image=image, heat=grid[::-1], window=window, **how)


def _agent(level: Level, drawn: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return a level's picture without its agent, and the agent alone [H, W, 4] uint8.

    The second of the two pictures `drawn` has the agent in another cell.
    """
    (x, y), (rows, columns) = level.agent, level.cells.shape
    height, width = drawn.shape[1] / rows, drawn.shape[2] / columns
    top, left = (rows - y - 1) * height, x * width
    cell = slice(round(top), round(top + height)), slice(round(left), round(left + width))
    world, agent = drawn[0].copy(), np.zeros((*drawn.shape[1:3], 4), np.uint8)
    world[cell] = drawn[-1][cell]
    agent[cell] = np.insert(drawn[0], 3, 255 * (drawn[0] != drawn[-1]).any(-1), axis=-1)[cell]
    return world, agent


def _check_any(panels: Mapping[str, Field | Change]) -> None:
    if not panels:
        raise ValueError("panels must be fields by title, at least one; none is given")
