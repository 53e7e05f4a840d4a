"""Choice of the importer for a file."""

from __future__ import annotations

import hashlib
from pathlib import Path

from astray import files
from astray.agents.importers import cleanrl, jd, pth
from astray.agents.importers.imported import Imported

READERS = {".pth": pth.read, ".pt": pth.read, ".jd": jd.read, ".cleanrl_model": cleanrl.read}
LARGEST = 512_000_000  # bytes; the largest known, with its optimizer's state, is 44 MB


def digest(path: Path) -> str:
    """Return the SHA-256 of a file that is small enough to be an agent's."""
    return hashlib.sha256(files.read(path, LARGEST)).hexdigest()


def read(path: Path) -> Imported:
    """Return the agent in an outside file; raise ValueError if it cannot be imported."""
    reader = READERS.get(path.suffix.lower())
    if reader is None:
        raise ValueError(
            f"{path} is refused: an agent's file is {', '.join(READERS)}; "
            f"got {path.suffix or 'no ending'}"
        )
    try:
        return reader(files.read(path, LARGEST))
    except ValueError as error:
        raise ValueError(f"{path} is refused: {error}") from error
