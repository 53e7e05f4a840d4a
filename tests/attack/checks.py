"""Each way to fail, made on purpose: `python -m attack OUT --check` sees that it is noticed."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from attack.core import Attempt, Place, Told, Wrong


def _leave(place: Place) -> Told:
    place.watch()
    (place.work / "left").touch()
    return Told(2, "", "astray: refused, it says\n")


def _lose(how: str) -> Callable[[Place], None]:
    def act(place: Place) -> None:
        path = place.mine("notes.txt")
        link = place.work / "link"
        link.symlink_to(path)
        place.watch()
        if how == "gone":
            path.unlink()
        elif how == "changed":
            path.write_text("other")
        elif how == "closed":
            path.chmod(0o600 if path.stat().st_mode & 0o77 else 0o644)
        else:
            link.unlink()
            link.write_text("a file")

    return act


def _raise(error: BaseException) -> Callable[[Place], None]:
    def act(place: Place) -> None:
        raise error

    return act


def _die(number: int) -> Callable[[Place], None]:
    return lambda place: os.kill(os.getpid(), number)


def _crash(place: Place) -> None:
    import ctypes

    ctypes.string_at(0)


def _grow(place: Place) -> None:
    """Take memory without end; the limit makes an error of it, and not a full machine."""
    parts = []
    while True:
        parts.append(np.empty(2**28, np.uint8))  # not touched, so that it takes no time


def _command(code: int, out: str, err: str) -> Callable[[Place], Told]:
    return lambda place: Told(code, out, err)


def _patched(place: Place) -> Told:
    """The command's own way, with a verb that has a mistake."""
    from astray.cli import verbs

    def broken() -> None:
        return None.nothing  # pyrefly: ignore

    verbs.run = broken
    return place.astray("list")


TRACE = "Traceback (most recent call last):\n  ...\nIndexError: list index out of range\n"
# What is done, and whether it is to be flagged.
CASES: dict[str, tuple[int, Callable[[Place], Any], str, bool]] = {
    "a file is lost": (1, _lose("gone"), "any", True),
    "a file is changed": (1, _lose("changed"), "any", True),
    "a file has another mode": (1, _lose("closed"), "any", True),
    "a link is a file": (1, _lose("link"), "any", True),
    "a file is left by what was refused": (4, _leave, "refusal", True),
    "a signal": (2, _die(signal.SIGSEGV), "any", True), "an abort": (2, _die(signal.SIGABRT), "any",
                                                                    True),
    "a crash": (2, _crash, "any", True), "an exit": (2, lambda p: os._exit(3), "any", True),
    "no end": (3, lambda p: time.sleep(1000), "any", True),
    "no end at work": (3, lambda p: [None for _ in iter(int, 1)], "any", True),
    "an IndexError": (4, _raise(IndexError("x")), "any", True),
    "an AttributeError": (4, _raise(AttributeError("x")), "any", True),
    "an AssertionError": (4, _raise(AssertionError("x")), "any", True),
    "a TypeError of an operator": (4, _raise(TypeError("'int' object is not subscriptable")), "any",
                                   True),
    "an error that says nothing": (4, _raise(ValueError("")), "any", True),
    "a traceback": (4, _command(1, "", TRACE), "any", True),
    "a traceback of a thread": (4, _command(0, "", TRACE), "any", True),
    "two lines": (4, _command(2, "", "astray: one thing\nand another\n"), "any", True),
    "no line": (4, _command(2, "", ""), "any", True),
    "another code": (4, _command(1, "", "astray: one thing is wrong\n"), "any", True),
    "a verb with a mistake": (4, _patched, "any", True),
    "memory without end": (3, _grow, "refusal", False),
    "what is wrong is taken": (5, lambda p: 7, "refusal", True),
    "a command is taken": (5, _command(0, "", ""), "refusal", True),
    "what is right is refused": (5, _raise(ValueError("no")), "success", True),
    "a payload": (6, lambda p: p.canary.touch(), "any", True),
    "an attempt's own finding": (7, _raise(Wrong("found")), "any", True),
    "a refusal": (4, _command(2, "", "astray: unknown game 'x'; there are: maze\n"), "refusal",
                  False),
    "a box": (4, _command(2, "", "╭─ Parsing error ─╮\n│ no │\n╰────╯\n"), "refusal", False),
    "a ValueError": (4, _raise(ValueError("x must be y")), "refusal", False),
    "success": (5, lambda p: p.astray("--version"), "success", False),
    "nothing lost": (1, lambda p: p.watch(p.mine("a")), "any", False),
}  # fmt: skip
ATTEMPTS = [
    Attempt(kind, name, act, wants, seconds=4)  # pyrefly: ignore
    for name, (kind, act, wants, _) in CASES.items()
]


def report(rows: Sequence[dict[str, object]]) -> int:
    """Tell which failures were not noticed, and what was noticed that is none."""
    wrong = [row for row in rows if (row["verdict"] != "held") != CASES[str(row["name"])][3]]
    for row in wrong:
        print(
            f"NOT AS IT SHOULD BE: {row['name']}: {row['verdict']} {row['reason']}", file=sys.stderr
        )
    print(f"{len(rows)} checks, {len(wrong)} of them not as they should be")
    return 1 if wrong else 0
