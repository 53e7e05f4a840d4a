"""Tables in files that are whole or not there."""

from __future__ import annotations

import io
from pathlib import Path

import polars as pl

from astray.files import write_aside


def write_table(table: pl.DataFrame, path: Path) -> None:
    """Write `table` to `path`: CSV where its name ends in .csv, else Parquet.

    Its folder is made. A full disk or a kill leaves the old file or none.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    file = io.BytesIO()
    if path.suffix == ".csv":
        table.write_csv(file)
    else:
        table.write_parquet(file)
    write_aside(path, file.getvalue())
