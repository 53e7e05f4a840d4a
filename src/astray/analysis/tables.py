"""Files of tables: written atomically, and checked as they are read."""

import hashlib
import io
import re
from pathlib import Path

import polars as pl

from astray.files import read, write_aside
from astray.memory import check_memory
from astray.validation import brief, path_of

NUMBER = 8  # bytes of most of a table's values in memory
COPIES = 3  # of a table in memory at once: polars' own, and what is made of it
SIGN = b"sha256 of the rest, by astray: "  # with a digest, between a Parquet file's data and footer
# The footer's beginning, in Thrift: a version, and a list of at most 255 parts: the table, its
# columns, and what lies in these. Some 400 in each other overflow polars' stack: Python ends.
FLAT = re.compile(rb"\x15.\x19([\x0c-\xec]|\xfc([\0-\x7f]|[\x80-\xff]\x01))", re.DOTALL)


def write_table(table: pl.DataFrame, path: Path) -> None:
    """Write `table` to `path`, as CSV if its name ends in .csv, otherwise as Parquet, signed.

    A full disk or a kill leaves the old file or none.
    """
    path, file = path_of("path", path), io.BytesIO()
    if path.suffix == ".csv":
        table.write_csv(file)
        return write_aside(path, file.getvalue())
    table.write_parquet(file)
    at = _footer(data := file.getvalue())
    return write_aside(path, data[:at] + SIGN + hashlib.sha256(data).digest() + data[at:])


def read_table(path: Path, signed: bool = False, flat: bool = False) -> pl.DataFrame:
    """Return the table of a Parquet file; `flat` refuses lists, which may have any length.

    Raises:
        MemoryError: If so many rows do not fit.
        ValueError: If it is damaged, or not `signed`.
    """
    before, sign, after = (data := read(path)).partition(SIGN)
    rest = before + after[hashlib.sha256().digest_size :]
    if (sign or signed) and not after.startswith(hashlib.sha256(rest).digest()):
        raise ValueError(f"{path} is not a table of astray's: it has changed since it was written")
    if not FLAT.match(data, _footer(data)):
        raise ValueError(f"{path} is not a table of astray's: it must be of at most 254 columns")
    try:  # polars would expand [ and * in a path; damaged tables may make it panic
        file = pl.scan_parquet(io.BytesIO(data))
        if flat and any(kind.is_nested() for kind in file.collect_schema().dtypes()):
            raise ValueError(f"{path} is not a table of astray's: it must be without lists")
        count = file.select(pl.len()).collect().item() * len(file.collect_schema())
        check_memory(NUMBER * count, f"the table {path}")  # of which a few bytes may be millions
        table = file.collect()
        check_memory(COPIES * int(table.estimated_size()), f"the table {path}")
        return table
    except (pl.exceptions.PolarsError, pl.exceptions.PanicException) as error:
        raise ValueError(f"{path} is not a table of astray's: {brief(error)}") from error


def _footer(data: bytes) -> int:
    """Return where a Parquet file's footer begins, after which are its length, and PAR1."""
    return max(len(data) - 8 - int.from_bytes(data[-8:-4], "little"), 0)
