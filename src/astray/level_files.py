"""Levels in files, as drawings or JSON."""

import codecs
import itertools
import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from astray.files import read
from astray.game import Game, Variant
from astray.level import Level
from astray.validation import path_of

SPACE = re.compile(r"\s*")
COMMENT = ";"  # prefix of comment lines in drawings
LARGEST_FILE = 2**26  # bytes; a level as JSON has about 2,000


def read_levels(
    path: str | Path, game: Game, variant: Variant, *, solvable: bool = True
) -> dict[str, Level]:
    """Return the levels in a file or a folder, by name, each checked as by `Level.state`.

    Files named .json or .jsonl hold JSON: one level after the other, or a list. Other files hold
    drawings, separated by empty lines.

    Raises:
        FileNotFoundError: If there is nothing at `path`.
        ValueError: If a level is invalid, or there are none.
    """
    path = path_of("path", path)
    if path.is_dir():
        return _read_folder(path, game, variant, solvable)
    try:
        text = text_of(path, LARGEST_FILE)
    except FileNotFoundError:
        raise FileNotFoundError(f"there is no level at {path}") from None
    try:
        if path.suffix in (".json", ".jsonl"):
            found = [Level.from_json(game, variant, value) for value in _json_values(text)]
        else:
            found = [Level.from_text(game, variant, drawing) for drawing in _drawings(text)]
        for level in found:
            level.state(solvable=solvable)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"{path}: {error}") from error
    if not found:
        raise ValueError(f"there are no levels in {path}")
    names = [path.name] if len(found) == 1 else [f"{path.name}:{k + 1}" for k in range(len(found))]
    return dict(zip(names, found, strict=True))


def text_of(path: Path, most: int) -> str:
    """Return a file's text, UTF-8 or (as marked) UTF-16; raise ValueError if it is neither."""
    data = read(path, most)
    wide = data.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))  # Windows PowerShell's >
    try:
        return data.decode("utf-16" if wide else "utf-8-sig").replace("\r\n", "\n")
    except UnicodeDecodeError as error:
        raise ValueError(f"{path}: {error}") from error


def read_level(path: Path, game: Game, variant: Variant, *, solvable: bool = False) -> Level:
    """Return the one level in a file, as `read_levels` does; raise ValueError for several."""
    found = read_levels(path, game, variant, solvable=solvable)
    if len(found) > 1:
        raise ValueError(f"one level is played; {path} holds {len(found)}")
    return next(iter(found.values()))


def _read_folder(path: Path, game: Game, variant: Variant, solvable: bool) -> dict[str, Level]:
    """Return the levels of every file in a folder that is not hidden."""
    found: dict[str, Level] = {}
    for file in sorted(p for p in path.iterdir() if p.is_file() and not p.name.startswith(".")):
        levels = read_levels(file, game, variant, solvable=solvable)
        if twice := found.keys() & levels.keys():  # "a:1" is the first level in "a", or a file
            raise ValueError(f"two levels in {path} are called {min(twice)!r}")
        found |= levels
    if not found:
        raise ValueError(f"there are no levels in {path}")
    return found


def _json_values(text: str) -> list[Any]:
    """Parse concatenated JSON values; the items of a list count as values."""
    decoder, found, at = json.JSONDecoder(), [], 0
    text = text.strip()
    while at < len(text):  # not text[at:], which copies the rest for each value
        value, at = decoder.raw_decode(text, SPACE.match(text, at).end())  # pyrefly: ignore
        found += value if isinstance(value, list) else [value]
    return found


def _drawings(text: str) -> Iterator[str]:
    """Split `text` at empty lines and leave out comments."""
    lines = [line for line in text.splitlines() if not line.lstrip().startswith(COMMENT)]
    groups = itertools.groupby(lines, key=lambda line: bool(line.strip()))
    return ("\n".join(group) for drawn, group in groups if drawn)
