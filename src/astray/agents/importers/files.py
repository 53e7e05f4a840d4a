"""Which importer reads which file."""

from __future__ import annotations

import hashlib
from pathlib import Path

from astray.agents.importers import jd, pth
from astray.agents.importers.imported import Imported

READERS = {".pth": pth.read, ".pt": pth.read, ".jd": jd.read}
LARGEST = 512_000_000  # bytes; the largest known, with its optimizer's state, is 44 MB


def digest(path: Path) -> str:
    """The SHA-256 of a file."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def read(path: Path) -> Imported:
    """The agent in a file of others; ValueError says why it is none."""
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(f"{path} is refused: an agent's file is {', '.join(READERS)}; "
                         f"got {path.suffix or 'no ending'}")  # fmt: skip
    if (size := path.stat().st_size) > LARGEST:
        raise ValueError(f"{path} is refused: it has {size:,} bytes; at most {LARGEST:,} are read")
    try:
        return reader(path.read_bytes())
    except ValueError as error:
        raise ValueError(f"{path} is refused: {error}") from error
