"""Files of tables: written atomically, and checked as they are read."""

import io
from pathlib import Path

import polars as pl

from astray.files import read, write_aside
from astray.validation import brief


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


def read_table(path: Path) -> pl.DataFrame:
    """Return the table of a Parquet file; raise ValueError if it is damaged."""
    try:  # polars would expand [ and * in a path; damaged tables may make it panic
        return pl.read_parquet(io.BytesIO(read(path)))
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise ValueError(f"{path} is not a table of astray's: {brief(error)}") from error
