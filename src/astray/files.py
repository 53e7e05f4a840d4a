"""Files that are whole or not there."""

from __future__ import annotations

import os
from pathlib import Path


def write_aside(path: Path, data: bytes) -> None:
    """Write `data` to `path` so that a kill or a full disk leaves the old file or the new one."""
    aside = path.with_name(f".{path.name}")
    try:
        with open(aside, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(aside, path)
    except OSError as error:
        aside.unlink(missing_ok=True)
        what = "what was there is still there" if path.exists() else "nothing was written"
        raise OSError(error.errno, f"{error.strerror}; {what}", str(path)) from error
