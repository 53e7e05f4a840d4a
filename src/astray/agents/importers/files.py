"""Choice of the importer for a file."""

import hashlib
from pathlib import Path

from astray import files
from astray.agents.importers import cleanrl, jd, planner, pth
from astray.agents.importers.imported import Imported
from astray.validation import brief

READERS = {".pth": pth.read, ".pt": pth.read, ".jd": jd.read, ".cleanrl_model": cleanrl.read}
LARGEST = 512_000_000  # bytes; the largest known, with its optimizer's state, is 44 MB


def digest(path: Path) -> str:
    """Return the SHA-256 of a file that is small enough to be an agent's.

    Raises:
        ValueError: If it is larger, or a planner's, which plays no game here.
    """
    if path.name == planner.MODEL or (path / planner.MODEL).exists():
        raise ValueError(
            f"{path} is refused: planners of train-learned-planner play Sokoban, which is not a "
            "game here; astray.agents.importers.planner.read(folder) returns the network alone, "
            "for observations of your own"
        )
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
        raise ValueError(f"{path} is refused: {brief(error)}") from error
