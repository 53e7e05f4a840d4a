"""Draw the figures of the results pages from the tables on them: python docs/figures.py.

The charts are those of the reports. A figure holds the numbers that it shows, so that a test finds
a figure whose table has changed.
"""

import os
import re
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib
import polars as pl
from matplotlib.figure import Figure
from matplotlib.text import Text
from PIL import Image

from astray.figures import charts
from astray.figures.style import DARK, INK, PAGE, STYLE
from astray.outcome import FAILED, INTENDED, MISGENERALIZED

FOLDER = Path(__file__).parent
RATE = re.compile(r"(-?[\d.]+)(?: %)?(?: \((-?[\d.]+) to (-?[\d.]+)\))?")
NUMBERS = "Numbers"  # key of a figure's data in its file
DIED = "died"  # an end of CoinRun
# Title of each table of the paper's own worlds, and what its last column counts.
OF_PAPER = {
    "The paper's own mazes": ("Three mice in the paper's mazes", FAILED),
    "The paper's own CoinRun": ("Three runners in the paper's CoinRun", DIED),
    "With random coins in 2 % of the levels": (
        "Three with random coins in 2 % of training levels",
        DIED,
    ),
    "With random coins in 20 % of the levels": (
        "Three with random coins in 20 % of training levels",
        DIED,
    ),
}
Row = dict[str, Any]


def rows_of(page: str, heading: str) -> Iterator[list[str]]:
    """Find the cells of the first table below a heading of a page, without its own heading."""
    text = (FOLDER / f"{page}.md").read_text("utf-8").split(f"# {heading}\n")[1]
    lines = re.search(r"(?:^\|.*\n)+", text, re.MULTILINE)
    for line in lines[0].splitlines()[2:] if lines else ():
        yield [cell.strip(" *") for cell in line.strip("|").split("|")]


def rate(cell: str, rate: float = 100) -> Row:
    """Return mean, low and high of a cell; 0 for an empty one."""
    mean, *ends = (float(x) / rate if x else None for x in RATE.findall(cell or "0")[0])
    low, high = (mean if end is None else end for end in ends)
    return {"mean": mean, "low": low, "high": high}


def results() -> tuple[pl.DataFrame, Figure]:
    """Draw the goals that agents of the paper's own worlds reach first."""
    data = pl.DataFrame([
        {"who": levels.removeprefix("of these, ").split(", ")[0], "where": where}
        | {"outcome": outcome} | rate(cell)
        for heading, (where, end) in OF_PAPER.items()
        for levels, *cells in rows_of("results", heading)
        if "under any number" not in levels
        for outcome, cell in zip((INTENDED, MISGENERALIZED, end), cells, strict=True)
    ])  # fmt: skip
    return data, charts.outcome_bars(data)


def what_helps() -> tuple[pl.DataFrame, Figure]:
    """Draw what mice reach first, by when and how they meet distinguishing levels."""
    found: list[Row] = []
    when = "2 % of the steps have cheese anywhere: when?"
    for name, corner, cheese, neither in rows_of("what-helps", "Early, late, or throughout"):
        outcomes = {MISGENERALIZED: corner, INTENDED: cheese, FAILED: neither}
        found += [{"where": when, "who": name, "outcome": outcome} | rate(cell)
                  for outcome, cell in outcomes.items()]  # fmt: skip
    method = "1 % have: which method chooses the levels?"
    for name, _, _, one, *_ in rows_of("what-helps", "Curricula of regret"):
        corner, cheese = (rate(cell) for cell in one.split("/"))
        neither = 1 - corner["mean"] - cheese["mean"]
        outcomes = {MISGENERALIZED: corner, INTENDED: cheese, FAILED: rate(f"{100 * neither:.0f}")}
        found += [{"where": method, "who": name, "outcome": outcome} | value
                  for outcome, value in outcomes.items()]  # fmt: skip
    data = pl.DataFrame(found)
    return data, charts.outcome_bars(data)


def insight() -> tuple[pl.DataFrame, Figure]:
    """Draw how likely the published mouse's way to the cheese is, with changes of one layer."""
    cells = {name: cell for name, _, cell, _ in rows_of("insight", "The cheese vector")}
    before, after = cells.pop("vector subtracted").split(" to 0.128")
    found: dict[str, Row] = {
        "no change": rate(before, 1),
        "cheese vector subtracted": rate("0.128" + after, 1),
    }
    differences = {
        "the same, minus the effect of removing the cheese": ("cheese removed", after, -1),
        "random vector of the same length": ("random vector subtracted", before, 1),
        "vector added": ("cheese vector added", before, 1),
    }
    for name, (told, base, sign) in differences.items():
        start = rate("0.128" if base is after else base, 1)["mean"]
        found[told] = {
            "mean": start + sign * rate(cells[name], 1)["mean"],
            "low": None,
            "high": None,
        }
    data = pl.DataFrame([{"intervention": name} | value for name, value in found.items()],
                        schema_overrides={"low": pl.Float64, "high": pl.Float64})  # fmt: skip
    label = "probability of the way to the cheese (published mouse)"
    return data, charts.points(data, row="intervention", label=label, limits=(0, 1))


def first_look() -> Figure:
    """Draw the figure of the tutorial by its own code, with the dark frame that films have."""
    text = (FOLDER / "first-look-inside.md").read_text("utf-8")
    names: dict[str, Any] = {}
    here = Path.cwd()
    with tempfile.TemporaryDirectory() as folder:
        os.chdir(folder)  # as the code saves figures
        exec("".join(re.findall(r"(?s)```python\n(.*?)```", text)[:2]), names)
        os.chdir(here)
    figure: Figure = names["figure"]
    figure.set_facecolor(DARK[PAGE])
    for axes in figure.axes:
        axes.tick_params(colors=DARK[INK])
        axes.spines[:].set_edgecolor(DARK[INK])
    for words in figure.findobj(Text):
        words.set_color(DARK[INK])
    return figure


FIGURES = {"results": results, "what-helps": what_helps, "insight": insight}


def main() -> None:
    """Write one figure for each page, `figure-<page>.png`, and that of the tutorial."""
    for name, draw in FIGURES.items():
        data, figure = draw()
        path = FOLDER / f"figure-{name}.png"
        with matplotlib.rc_context(STYLE):
            figure.savefig(path, metadata={NUMBERS: data.write_csv()})
        with Image.open(path) as image:
            print(f"{path.name}: {image.width} x {image.height}")
    with matplotlib.rc_context(STYLE):
        first_look().savefig(FOLDER / "first-look-inside.png")


if __name__ == "__main__":
    main()
