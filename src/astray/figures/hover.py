"""Values of a figure by place, for pages that show them under the pointer."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.container import BarContainer, ErrorbarContainer
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, PercentFormatter

MOST = 400  # points of a series; of more, evenly spaced ones
UNNAMED = "_child", "_nolegend_", "95 % interval"  # lines that are no series


def points(figure: Figure) -> list[tuple[float, float, str]]:
    """Return places in a figure that was drawn, and the values measured there.

    Returns:
        From the left and from the top, as percentages of the figure's size, and the text.
    """
    width, height = figure.bbox.size
    found = []
    for axes in figure.axes:
        for x, y, text in (*_series(axes), *_bars(axes), *_cells(axes)):
            left, up = axes.transData.transform((x, y))
            found.append((round(100 * left / width, 2), round(100 - 100 * up / height, 2), text))
    return found


def _series(axes: Axes) -> Iterator[tuple[float, float, str]]:
    """Yield the points of named lines, with the intervals of those that have whiskers."""
    whiskers = {one.lines[0]: one for one in axes.containers if isinstance(one, ErrorbarContainer)}
    for line in axes.lines:
        name = str(whiskers.get(line, line).get_label())
        if name.startswith(UNNAMED) or line.get_transform() != axes.transData:
            continue
        first = [] if name.startswith("_") else [name]
        xy = np.asarray(line.get_xydata(), float)
        there = np.flatnonzero(np.isfinite(xy).all(1))
        some = np.linspace(0, len(there) - 1, min(len(there), MOST)).round().astype(int)
        for k in there[some]:
            x, y = xy[k]
            told = [
                _told(axes.xaxis, x),
                _told(axes.yaxis, y),
                *_interval(axes, whiskers.get(line), k),
            ]
            yield x, y, ", ".join(first + told)


def _interval(axes: Axes, whisker: ErrorbarContainer | None, k: int) -> list[str]:
    """Return the interval of a point with whiskers along one axis; nothing for none."""
    if whisker is None:
        return []
    axis, along = (axes.yaxis, 1) if whisker.has_yerr else (axes.xaxis, 0)
    low, high = whisker.lines[2][0].get_segments()[k][:, along]
    return [f"95 % interval {_told(axis, low)} to {_told(axis, high)}"] if low < high else []


def _bars(axes: Axes) -> Iterator[tuple[float, float, str]]:
    """Yield the middles of the parts of lying bars."""
    for one in axes.containers:
        for patch in one.patches if isinstance(one, BarContainer) else ():
            (x, y), wide = patch.get_xy(), patch.get_width()
            if wide:
                name = str(one.get_label()).lstrip("_")
                where = _told(axes.yaxis, y + patch.get_height() / 2)
                text = f"{where}, {name}: {_told(axes.xaxis, wide)}"
                yield x + wide / 2, y + patch.get_height() / 2, text


def _cells(axes: Axes) -> Iterator[tuple[float, float, str]]:
    """Yield the middles of coloured cells, named by x and y from the lower left."""
    for image in axes.images:
        found = image.get_array()
        if found is None or found.ndim != 2 or str(image.get_label()).startswith(UNNAMED):
            continue
        values = np.ma.filled(np.ma.asarray(found, float), np.nan)
        for row, x in np.argwhere(np.isfinite(values)):
            y = len(values) - 1 - row
            yield x + 0.5, y + 0.5, f"({x}, {y}) {image.get_label()}: {values[row, x]:z.3g}"


def _told(axis: Axis, value: float) -> str:
    """Return a value as its axis names it: in percent, by the nearest word, or in figures."""
    form: Any = axis.get_major_formatter()
    if isinstance(form, PercentFormatter):
        return f"{100 * value:z.1f} %"
    if isinstance(form, FuncFormatter):  # of ticks with words
        ticks = axis.get_majorticklocs()
        return form(ticks[abs(ticks - value).argmin()]).replace("\n", " ")
    return f"{value:z.3g}"
