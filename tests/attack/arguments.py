"""Class 4: every option of every verb, with every kind of wrong value."""

from __future__ import annotations

import functools
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from attack import words
from attack.core import Attempt, Place

LONG = "x" * 5000
BAD = "\udcff\udcfe"  # bytes that are no text, as the system hands them over
# By the type of an option: what is given, and whether it may be taken.
NUMBERS = {"a word": "many", "a real": "1.5", "nothing": "", "a list": "1,2", "bytes": BAD}
WORDS = {
    "a word": "Nothing-Such",
    "nothing": "",
    "long": LONG,
    "bytes": BAD,
    "lines": "a\nb\r\nc",
    "a terminal's": "\x1b[31mred\x07",
    "a path": "../../etc/passwd",
    "a list": "[1, {}]",
}
KNOBS = {"no value": "world", "no name": "=5", "nothing": "", "a word": "world=large",
         "a list": "world=[5]", "long": f"world={LONG}", "bytes": f"world={BAD}",
         "unknown": "word=5", "NaN": "shift_probability=NaN"}  # fmt: skip


def attempts() -> Iterator[Attempt]:
    from astray.cli.verbs import VERBS

    for verb in VERBS:
        for option, kind, positional in words.options_of(verb):
            if option == "config":
                continue  # see `settings`
            for title, value in _values(option, kind).items():
                act = functools.partial(_give, verb, option, value, positional)
                wants = "any" if _may_work(option, title) else "refusal"
                name = f"{verb} {'' if positional else '--'}{option}: {title}"
                yield Attempt(4, name, act, wants, seconds=40)
        for title, given in _extra(verb).items():
            act = functools.partial(_add, verb, given)
            yield Attempt(4, f"{verb}: {title}", act, "refusal", seconds=40)


def _extra(verb: str) -> dict[str, tuple[str, ...]]:
    """Words after those of a verb that works."""
    given: dict[str, tuple[str, ...]] = {
        "an option that is none": ("--nothing-such",),
        "a word more": ("one", "two", "three", "four"),
        "bytes that are no text": (f"--{BAD}",),
        "an option of 5,000 characters": (f"--{LONG}",),
    }
    for option, kind, positional in words.options_of(verb):
        if not positional and kind.replace("|", " ").split()[0] in ("str", "int", "Path"):
            given["an option without its value"] = (f"--{option}",)
    return given


def _values(option: str, kind: str) -> dict[str, Any]:
    if "bool" in kind:
        return {"a word": "perhaps", "nothing": ""}
    if "Knobs" in kind:
        return KNOBS
    if "Sets" in kind:
        return {f"axes, {name}": text for name, text in {
            "no value": "width", "nothing": "", "no name": "=1", "NaN": "gamma=NaN",
            "an end": "width=8,", "bytes": f"width={BAD}", "twice": "width=8,8",
            "a word": "width=wide", "unknown": "Width=8", "a knob": "variant.words=1",
            "long": f"width={LONG}", "huge": "gamma=1e999", "brackets": "width=" + "[" * 50_000,
        }.items()}  # fmt: skip
    if "int" in kind.replace("|", " ").split():
        return NUMBERS
    if "Path" in kind:
        return PATHS_OUT if option in OUT else PATHS_IN
    return WORDS


OUT = ("out", "folder", "export")
FREE = ("source", "licence", "track")  # any text


def _may_work(option: str, title: str) -> bool:
    """Whether such a value may be taken: as text that may be anything, or for the default."""
    return option in FREE or title == "nothing" or (option == "export" and title == "a folder")


# Paths that are read: how each is made, and what is given.
PATHS_IN: dict[str, Any] = {
    "nothing there": "nothing/there", "nothing": "", "a folder": "folder", "a pipe": "pipe",
    "a link to itself": "itself", "a closed file": "closed", "below a file": "file/below",
    "in a closed folder": "shut/file", "long": LONG, "bytes": BAD, "a device": "/dev/zero",
    "a process": "/proc/self/mem", "a NUL": "a\0b",
}  # fmt: skip
PATHS_OUT: dict[str, Any] = {
    "below a file": "file/below.mp4", "in a closed folder": "shut/there.mp4",
    "in a folder to be read": "fixed/there.mp4", "a pipe": "pipe", "a link to itself": "itself",
    "long": f"{LONG}.mp4", "a device": "/dev/full", "in no folder of yours": "/proc/there.mp4",
    "at the top": "/there.mp4", "a NUL": "a\0b.mp4", "a link to nothing": "nowhere",
    "through a link to nothing": "nowhere/there.mp4",
}  # fmt: skip


def _make_paths(work: Path) -> None:
    """What `PATHS_IN` and `PATHS_OUT` name."""
    (work / "folder").mkdir()
    (work / "folder" / "file").write_text("a file")
    (work / "file").write_text("a file")
    os.mkfifo(work / "pipe")
    (work / "itself").symlink_to("itself")
    (work / "nowhere").symlink_to("is-not")
    (work / "closed").write_text("closed")
    (work / "closed").chmod(0)
    for name, mode in (("shut", 0), ("fixed", 0o555)):
        (work / name).mkdir()
        (work / name).chmod(mode)


def _give(verb: str, option: str, value: str, positional: bool, place: Place) -> Any:
    given = words.words_of(verb, place)
    if positional:
        at = _position(verb, option)
        given[at : at + 1] = [value]
    else:
        given = words.with_option(given, option, value)
    _make_paths(place.work)
    place.watch()
    return place.astray(verb, *given)


def _position(verb: str, option: str) -> int:
    """Where a word of a verb stands."""
    return [name for name, _, positional in words.options_of(verb) if positional].index(option)


def _add(verb: str, extra: tuple[str, ...], place: Place) -> Any:
    given = words.words_of(verb, place)
    place.watch()
    return place.astray(verb, *given, *extra)
