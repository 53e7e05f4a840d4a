"""Measured rows as tables, and the circumstances they were measured in."""

from __future__ import annotations

import os
import platform
from collections.abc import Sequence
from importlib import metadata
from pathlib import Path
from typing import ClassVar, Protocol

from rich import box
from rich.console import Group
from rich.table import Table

from astray.training.config import Config

PACKAGES = ("numpy", "numba", "gymnasium", "torch", "envpool", "stable-baselines3")
NOTHING = "-"  # in a cell to which the column does not apply


class Row(Protocol):
    """One line of a table, whose rows are of one class."""

    title: ClassVar[str]  # of the table

    def cells(self) -> dict[str, str]:
        """Column -> text; the same columns in each row of a table."""
        ...


def network(config: Config) -> str:
    """The network of a training and its size."""
    return f"{config.network} {config.width if config.network == 'mlp' else config.scale}"


def table(rows: Sequence[Row]) -> Group:
    """Return the rows for a terminal, a table for each class of rows, with their circumstances."""
    return Group(*map(_table, _by_class(rows)))


def _table(rows: Sequence[Row]) -> Table:
    title, caption = rows[0].title, circumstances()
    result = Table(title=title, caption=caption, box=box.SIMPLE, pad_edge=False, padding=0)
    for column in rows[0].cells():
        texts = [column, *(row.cells()[column] for row in rows)]
        whole = max(len(word) for text in texts for word in text.split())
        if _is_number(rows, column):  # as narrow as can be: the headers are broken at words
            result.add_column(column, justify="right", width=whole)
        else:
            result.add_column(column)
    for row in rows:
        result.add_row(*row.cells().values())
    return result


def markdown(rows: Sequence[Row]) -> str:
    """Return the rows for a page, a table for each class of rows, with their circumstances."""
    return "\n\n".join(map(_markdown, _by_class(rows)))


def _markdown(rows: Sequence[Row]) -> str:
    columns = list(rows[0].cells())
    rules = ["---:" if _is_number(rows, column) else "---" for column in columns]
    lines = [columns, rules, *(row.cells().values() for row in rows)]
    return "\n".join([*(f"| {' | '.join(line)} |" for line in lines), "", circumstances()])


def _by_class(rows: Sequence[Row]) -> list[list[Row]]:
    return [[row for row in rows if type(row) is kind] for kind in dict.fromkeys(map(type, rows))]


def _is_number(rows: Sequence[Row], column: str) -> bool:
    texts = [row.cells()[column] for row in rows]
    return all(text == NOTHING or text[:1].isdigit() for text in texts)


def count(x: int | None) -> str:
    return NOTHING if x is None else str(x)


def thousands(x: float | None) -> str:
    """To three digits, which is more than repeats from run to run."""
    if x is None:
        return NOTHING
    x = float(f"{x / 1000:.3g}")
    return f"{x:,.0f}" if x >= 100 else f"{x:g}"


def decimal(x: float | None, places: int = 2) -> str:
    return NOTHING if x is None else f"{x:.{places}f}"


def circumstances() -> str:
    """Return the processor and the versions, on which figures depend."""
    versions = [f"Python {platform.python_version()}"]
    for package in PACKAGES:
        try:
            versions.append(f"{package} {metadata.version(package)}")
        except metadata.PackageNotFoundError:
            versions.append(f"no {package}")
    return f"{_processor()}, {os.cpu_count()} cores, {', '.join(versions)}"


def _processor() -> str:
    information = Path("/proc/cpuinfo")
    if information.exists():
        for line in information.read_text().splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
