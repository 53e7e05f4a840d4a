"""States in files: NumPy archives, from which nothing is ever executed."""

import io
import tokenize
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np

from astray import games
from astray.files import archive_of, read, write_aside
from astray.game import Game
from astray.memory import check_memory
from astray.validation import brief, counted, of_kind

FORMAT = 1  # goes up when the fields of a state change their meaning
# All that NumPy raises for what is no archive of arrays.
BROKEN = (
    OSError, ValueError, KeyError, EOFError, MemoryError, OverflowError, SyntaxError,
    NotImplementedError, tokenize.TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip


def save_states(path: Path, game: str | Game, states: np.ndarray) -> None:
    """Write `states` [N] of `game` to an .npz file with "game", "format" and "states".

    Raises:
        ValueError: If they are not states of the game.
        MemoryError: If their file does not fit.
    """
    game = games.find(game)
    of_kind("states", states, np.ndarray)
    if states.dtype != game.state or states.ndim != 1:
        given = f"{states.dtype} of shape {states.shape}"
        raise ValueError(f"states must be [N] records of {game.name}; got {given}")
    file, plain = io.BytesIO(), np.dtype(states.dtype.descr)
    try:
        np.savez_compressed(file, game=game.name, format=FORMAT, states=states.view(plain))
        data = file.getvalue()
    except (ValueError, MemoryError) as error:  # a library says then that its file is closed
        raise MemoryError(f"too little memory to write {counted(len(states), 'state')}") from error
    write_aside(path, data)


def load_states(path: Path, game: str | Game) -> np.ndarray:
    """Return the states [N] that `save_states` wrote; `set_state` checks them for a variant.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it holds no states of this game and format.
    """
    game = games.find(game)
    try:
        with arrays_of(path) as file:
            names = ("game", "format", "states")  # what is no array is read as bytes
            kept: dict[str, Any] = {name: np.asarray(file[name]) for name in names}
    except FileNotFoundError:
        raise FileNotFoundError(f"there are no states at {path}") from None
    except BROKEN as error:
        short = "too little memory" if isinstance(error, MemoryError) else type(error).__name__
        why = brief(error) or f"it cannot be read ({short})"
        raise ValueError(f"{path} holds no states: {why}") from error
    if kept["game"].shape or str(kept["game"]) != game.name:
        raise ValueError(f"{path} holds states of {brief(kept['game'])}, not of {game.name}")
    if kept["format"].shape or kept["format"] != FORMAT:
        raise ValueError(f"{path} has format {brief(kept['format'])}; this version reads {FORMAT}")
    wanted, states = game.state, kept["states"]
    if states.ndim != 1 or states.dtype != np.dtype(wanted.descr):
        raise ValueError(f"{path} holds states with other fields than those of this version")
    return states.view(wanted)


def arrays_of(path: Path) -> np.lib.npyio.NpzFile:
    """Open an .npz file; raise MemoryError if its arrays need more than there is."""
    # From bytes: NumPy leaves a file open that is no archive.
    members = archive_of(data := read(path)).infolist()
    check_memory(sum(member.file_size for member in members), f"the arrays of {path}")
    return np.lib.npyio.NpzFile(io.BytesIO(data), allow_pickle=False)
