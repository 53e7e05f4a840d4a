"""Atomic files of tables."""

import io
from pathlib import Path

import polars as pl

from astray.files import write_aside


def write_table(table: pl.DataFrame, path: Path) -> None:
    """Write `table` to `path`, as CSV if its name ends in .csv, otherwise as Parquet.

    A full disk or a kill leaves the old file or none.
    """
    file = io.BytesIO()
    if path.suffix == ".csv":
        table.write_csv(file)
    else:
        table.write_parquet(file)
    write_aside(path, file.getvalue())
