"""The report of an experiment: one HTML file that needs nothing else, not even a network."""

from __future__ import annotations

import base64
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import polars as pl
from jinja2 import Environment, PackageLoader, StrictUndefined

from astray.files import write_aside

MEDIA = {".png": "image/png", ".mp4": "video/mp4"}
NOTHING = "—"


@dataclass(frozen=True)
class Verdict:
    """A claim that was tested."""

    claim: str
    paper: str  # its figure
    ours: str  # our figure, with its interval
    held: bool


@dataclass(frozen=True)
class Show:
    """A figure (a .png, the .svg beside it) or a video (an .mp4, the .gif beside it)."""

    caption: str
    path: Path


@dataclass(frozen=True, eq=False)
class Table:
    """Numbers to look up."""

    caption: str
    frame: pl.DataFrame


@dataclass(frozen=True, eq=False)
class Report:
    """What an experiment found, most important first."""

    name: str  # of the experiment
    title: str
    reproduces: str  # what of the paper
    question: str
    answer: str  # the finding, in one sentence
    size: str
    smaller: str  # what is smaller than in the paper; empty at the paper's size
    verdicts: Sequence[Verdict]
    videos: Sequence[Show]
    figures: Sequence[Show]
    tables: Sequence[Table]
    settings: Mapping[str, str]
    command: str  # that repeats it


def write(report: Report, folder: Path) -> Path:
    """Write `report.html` into `folder`, with figures and videos inside; its path."""
    environment = Environment(
        loader=PackageLoader("astray.experiments", ""),
        autoescape=True, lstrip_blocks=True, trim_blocks=True, undefined=StrictUndefined,
    )  # fmt: skip
    environment.filters |= {"embedded": embedded, "columns": columns}
    page = environment.get_template("report.html").render(report=report)
    path = folder / "report.html"
    folder.mkdir(parents=True, exist_ok=True)
    write_aside(path, page.encode())
    return path


def embedded(path: Path) -> str:
    """A figure or video as a data URI."""
    if path.suffix not in MEDIA:
        raise ValueError(f"{path.name} cannot be shown; {', '.join(MEDIA)} can")
    return f"data:{MEDIA[path.suffix]};base64,{base64.b64encode(path.read_bytes()).decode()}"


def columns(frame: pl.DataFrame) -> dict[str, tuple[bool, list[str]]]:
    """For each column its heading, whether it holds numbers, and its cells as text."""
    return {
        column.name.replace("_", " "): (column.dtype.is_numeric(), cells(column))
        for column in frame.iter_columns()
    }


def cells(column: pl.Series) -> list[str]:
    """A column as text; its reals to equally many places, four digits of the largest."""
    if column.dtype.is_float():
        real = [value for value in column if value is not None and math.isfinite(value)]
        largest = max((abs(value) for value in real), default=0.0)
        digits = math.floor(math.log10(largest)) if largest else 0
        form = f",.{min(3, max(0, 3 - digits))}f" if digits > -2 else ".3g"
        return [NOTHING if _missing(value) else format(value, form) for value in column]
    return [_text(value) for value in column]


def _missing(value: float | None) -> bool:
    return value is None or math.isnan(value)


def _text(value: Any) -> str:
    if value is None:
        return NOTHING
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:,}" if isinstance(value, int) else str(value)
