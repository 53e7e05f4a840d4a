"""The common style of all figures, and how they are saved."""

import io
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from astray.files import write_aside

OTHERS = ("#2e6db4", "#b5446e", "#6b5b95", "#8a6d1f")  # of what is not an outcome
PAGE, INK, FAINT, EMPTY = "#fcfcfa", "#222222", "#dddddd", "#eeeeec"  # EMPTY: nothing is shown
ON_COLOUR = "black"  # of what is written on a colour, which is light in the dark, too
# Colours of figures on dark pages.
DARK = dict(
    zip(
        (INK, FAINT, PAGE, EMPTY, *OTHERS),
        ("#e6e7e2", "#3a3c38", "#1a1b1a", "#2b2d2a", "#6fa8ea", "#e27ba2", "#a897db", "#c9a94f"),
        strict=True,
    )
)
WIDTH = 7.0  # inches

STYLE: dict[Any, Any] = {
    "axes.axisbelow": True, "axes.edgecolor": INK, "axes.labelcolor": INK,
    "axes.spines.right": False, "axes.spines.top": False,
    "axes.titlelocation": "left", "axes.titlepad": 8, "axes.titlesize": 11,
    "axes.titleweight": "bold",
    "figure.facecolor": "white", "figure.constrained_layout.h_pad": 0.08,
    "figure.constrained_layout.use": True,
    "font.family": ["DejaVu Sans"],  # comes with matplotlib, so it is the same everywhere
    "font.size": 10.5, "grid.color": FAINT, "hatch.linewidth": 0.6, "legend.fontsize": 10,
    "legend.frameon": False,
    "savefig.dpi": 150, "svg.fonttype": "none", "svg.hashsalt": "astray", "text.color": INK,
    "text.parse_math": False,  # names are as they are given
    "xtick.color": INK, "ytick.color": INK,
}  # fmt: skip


def save(figure: Figure, folder: Path, name: str) -> None:
    """Write `<name>.png` and `<name>.svg`; equal figures give equal bytes."""
    png, svg = io.BytesIO(), io.BytesIO()
    # The SVG's text and ids are settings of matplotlib, not arguments; they are put back after.
    with matplotlib.rc_context(STYLE):
        figure.savefig(png, format="png")
        figure.set_layout_engine("none")  # all is where it belongs; to find out takes a while
        figure.savefig(svg, format="svg", metadata={"Date": None})
    write_aside(folder / f"{name}.png", png.getvalue())
    write_aside(folder / f"{name}.svg", svg.getvalue())


def themed(svg: str) -> str:
    """Return a figure for pages: transparent, and with colours that follow a dark theme."""
    for light in DARK:
        svg = svg.replace(light, f"var(--c{light[1:]}, {light})")
    dark = "".join(f"--c{light[1:]}: {dark};" for light, dark in DARK.items())
    svg = svg.replace('style="fill: #ffffff"', 'style="fill: none"')  # of figure and axes
    svg = svg.replace("'DejaVu Sans'", "'DejaVu Sans', Verdana, sans-serif")
    style = f"<style>@media (prefers-color-scheme: dark) {{ svg {{ {dark} }} }}</style>"
    return svg.replace("<defs>", f"{style}<defs>", 1)
