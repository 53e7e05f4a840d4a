"""Findings of studies as data, from which the pages of reports are written."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import polars as pl

from astray.report.claims import Claim
from astray.training import folders
from astray.validation import command_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

BRIEF = 40  # rows of a drawing that is shown as it is


@dataclass(frozen=True)
class Scene:
    """An agent in a level, as shown by the lab."""

    run: Path
    variant: str
    level: int

    @property
    def command(self) -> str:
        """Command that opens it in the lab."""
        run, options = folders.name_of(Path(self.run)), ("--variant", self.variant, "--level")
        return command_of("astray", "lab", run, *options, str(self.level))


@dataclass(frozen=True)
class Video:
    """An .mp4 file and the .gif beside it."""

    caption: str
    path: Path
    scene: Scene | None = None  # that it shows


@dataclass(frozen=True, eq=False)
class Plot:
    """A figure and its numbers."""

    name: str  # of its files
    caption: str
    figure: Figure
    data: pl.DataFrame | None


@dataclass(frozen=True, eq=False)
class Table:
    """A table for reference."""

    name: str  # of its files
    caption: str
    frame: pl.DataFrame
    shown: pl.DataFrame | None = None  # on a page in its place, where that is narrower


@dataclass(frozen=True, kw_only=True, eq=False)
class Findings:
    """The findings of an experiment, most important first."""

    answer: str  # in a sentence or two
    claims: Sequence[Claim]
    videos: Sequence[Video] = ()
    plots: Sequence[Plot] = ()
    tables: Sequence[Table] = ()
    settings: Mapping[str, str]


@dataclass(frozen=True, kw_only=True)
class Heading:
    """The question of an experiment."""

    name: str  # of the experiment
    size: str
    title: str
    reproduces: str  # what of the paper
    question: str
    differences: str  # from the paper, in words; empty where there is none
    command: str  # that repeats it


class Code(str):
    """A text that is shown verbatim."""

    @property
    def brief(self) -> str:
        """The text; of more than `BRIEF` rows, equal ones one after the other are counted."""
        short = []
        for row, alike in groupby(self.splitlines()):
            count = len([*alike])
            short += [row, f"  … {count - 1} more rows like this"] if count > 3 else [row] * count
        return self if self.count("\n") < BRIEF else "\n".join(short)


# What is beside each other in a section: text, claims, settings, and what is shown.
Item = str | Sequence[Claim] | Mapping[str, str] | Video | Plot | Table


@dataclass(frozen=True, eq=False)
class Section:
    """A heading of a page, with its contents."""

    heading: str
    items: Sequence[Item]
