"""What an attempt is, where it is made, and how its end is judged."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import traceback
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from attack.trees import Tree, tree_of

CLASSES = {
    1: "data of the user's", 2: "compiled code", 3: "endless work", 4: "one sentence",
    5: "silently taken", 6: "trust", 7: "two at once",
}  # fmt: skip
Wanted = Literal["refusal", "success", "any"]
LONGEST = 1400  # characters of a mistake
MISTAKE, INTERRUPTED, UNREAD, TERMINATED = 2, 130, 141, 143  # exit codes
# What an error in a library or an operator says, who does not know what a user gave.
DEEP = re.compile(
    r"unsupported operand|not subscriptable|has no len|not iterable|not callable|NoneType"
    r"|unhashable|must be real number, not|cannot unpack|ufunc|No conversion path|numba"
)
PROGRESS = re.compile(r" steps +[\d,]+/s ")  # in the line in which a training tells how it goes
TOLD = (ValueError, TypeError, OSError, RuntimeError, KeyError, ImportError, MemoryError)


class Wrong(Exception):
    """What an attempt itself found."""


@dataclass(frozen=True)
class Told:
    """How a command ended, and what it wrote."""

    code: int
    out: str
    err: str


@dataclass(frozen=True, eq=False)
class Attempt:
    """Something that is tried, and what is to come of it.

    act      in a process of its own; what it returns may be a command's `Told`
    wants    "refusal": a sentence that says what is wrong; "any": that, or that it works
    seconds  that it may take
    names    what the sentence must have in it
    also     errors that are a refusal here, beside those that are everywhere
    codes    exit codes of a command that are as good as a refusal
    leaves   a command that is refused may leave files
    """

    kind: int
    name: str
    act: Callable[[Place], Any]
    wants: Wanted = "refusal"
    seconds: float = 20
    names: str = ""
    also: tuple[type[BaseException], ...] = ()
    codes: tuple[int, ...] = ()
    leaves: bool = False


@dataclass(eq=False)
class Place:
    """The folder of an attempt: a home, a working folder, and what of it is the user's.

    made   what all attempts may copy; see `material`
    small  a disk of a few pages, where one could be had
    """

    root: Path
    made: Path
    small: Path | None = None
    ours: list[Path] = field(default_factory=list)  # astray's own, and what is below them
    users: list[Path] = field(default_factory=list)  # the user's, also below astray's own
    _watched: bool = field(default=False, repr=False)

    @property
    def work(self) -> Path:
        return self.root / "work"

    @property
    def home(self) -> Path:
        return self.root / "home"

    @property
    def canary(self) -> Path:
        """The file that payloads make; nothing else may."""
        return self.root / "canary"

    def mine(self, path: str | Path, content: str | bytes = "the user's own\n") -> Path:
        """A file of the user's in the working folder, or wherever else."""
        path = self.work / path
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        self.users.append(path)
        return path

    def copy(self, name: str, to: str = "") -> Path:
        """A copy of something that was made for all attempts, in the working folder."""
        source, target = self.made / name, self.work / (to or name)
        target.parent.mkdir(parents=True, exist_ok=True)
        if source.is_dir():
            shutil.copytree(source, target, symlinks=True)
        else:
            shutil.copyfile(source, target)
        self.ours.append(target)
        return target

    def watch(self, *more: Path) -> None:
        """From now on what is here is looked after: see `changes`."""
        self._watched = True
        found = tree_of(self.work, self.home, *more)
        users = [
            path
            for path in found
            if Path(path) in self.users or not any(map(Path(path).is_relative_to, self.ours))
        ]
        roots = [str(one) for one in (self.work, self.home, *more)]
        (self.root / "before.json").write_text(
            json.dumps({"tree": found, "users": users, "roots": roots}), encoding="utf-8"
        )

    def astray(self, *words: Any) -> Told:
        """The command in this process."""
        from astray import cli

        if not self._watched:
            self.watch()
        sys.argv = ["astray", *map(str, words)]
        begun = [os.fstat(number).st_size for number in (1, 2)]
        code = 0
        try:
            cli.main()
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
        except BaseException:
            traceback.print_exc()
            code = 1
        sys.stdout.flush()
        sys.stderr.flush()
        return Told(
            code,
            *(_since(self.root / name, at) for name, at in zip(("out", "err"), begun, strict=True)),
        )

    def process(
        self,
        *words: Any,
        program: tuple[str, ...] = ("-m", "astray"),
        text: bytes | None = None,
        env: dict[str, str | None] | None = None,
        **options: Any,
    ) -> Told:
        """The command in a process of its own, with these variables; None: without."""
        if not self._watched:
            self.watch()
        given = dict(os.environ)
        for name, value in (env or {}).items():
            given.pop(name, None)
            if value is not None:
                given[name] = value
        if text is None:
            options.setdefault("stdin", subprocess.DEVNULL)
        else:
            options["input"] = text
        for name in ("stdout", "stderr"):
            options.setdefault(name, subprocess.PIPE)
        done = subprocess.run([sys.executable, *program, *map(str, words)], env=given, **options)
        out, err = (
            (x or b"").decode(errors="backslashreplace") for x in (done.stdout, done.stderr)
        )
        return Told(done.returncode, out, err)


def _since(path: Path, at: int) -> str:
    with open(path, "rb") as file:
        file.seek(at)
        return file.read().decode(errors="backslashreplace")


@dataclass
class Outcome:
    """How an attempt ended.

    end    "returned", "raised", "wrong", "hung", "signal N", "exit N"
    error  of what was raised: the names of its classes, and what it says
    """

    end: str
    seconds: float = 0.0
    told: Told | None = None
    error: tuple[list[str], str] | None = None
    tail: str = ""


def changes(before: Tree, after: Tree) -> Iterator[tuple[str, str]]:
    """How paths differ: "gone", "changed" or "new", and the path."""
    for path, kept in before.items():
        if path not in after:
            yield "gone", path
        elif after[path] != kept and not (kept[0] == after[path][0] == "closed"):
            yield "changed", path
    for path in after:
        if path not in before:
            yield "new", path


def verdict(attempt: Attempt, outcome: Outcome, place: Place) -> str:
    """Why an attempt is flagged; empty where it ended as it should."""
    if place.canary.exists():
        return "a payload was run"
    if outcome.end.startswith(("signal", "exit")) or outcome.end in ("hung", "wrong"):
        return f"{outcome.end}: {outcome.error[1]}" if outcome.error else outcome.end
    if lost := _lost(attempt, outcome, place):
        return lost
    if outcome.told is not None:
        return _of_command(attempt, outcome.told)
    if outcome.end == "raised":
        return _of_error(attempt, *(outcome.error or ([], "")))
    return "it was taken" if attempt.wants == "refusal" else ""


def _lost(attempt: Attempt, outcome: Outcome, place: Place) -> str:
    """What of the user's is not as it was; and what a refused command left."""
    path = place.root / "before.json"
    if not path.exists():
        return ""
    kept = json.loads(path.read_text(encoding="utf-8"))
    before: Tree = kept["tree"]
    found = list(changes(before, tree_of(*map(Path, kept["roots"]))))
    spared = [p for what, p in found if what != "new"]
    if attempt.kind == 1 and (lost := set(spared) & set(kept["users"])):
        return f"of the user's: {', '.join(_short(p, place) for p in sorted(lost)[:3])}"
    refused = outcome.told and outcome.told.code == MISTAKE
    if refused and not attempt.leaves:
        left = [p for what, p in found if not _is_cache(p) and (what == "new" or p in spared)]
        if left:
            return f"refused, and left or changed {', '.join(_short(p, place) for p in left[:3])}"
    return ""


def _is_cache(path: str) -> bool:
    return any(part in path for part in ("/.cache", "/.config/matplotlib", "/.triton"))


def _short(path: str, place: Place) -> str:
    return path.removeprefix(f"{place.root}/")


def _of_command(attempt: Attempt, told: Told) -> str:
    if told.code < 0:
        return f"signal {-told.code}"
    if "Traceback (most recent call last)" in told.err + told.out:
        return "a traceback"
    lines = [one for one in told.err.strip().splitlines() if not PROGRESS.search(one)]
    if told.code in attempt.codes:
        return "" if len(lines) <= 1 else f"{len(lines)} lines on standard error"
    if told.code == 0:
        return "it was taken" if attempt.wants == "refusal" else ""
    if told.code != MISTAKE:
        return f"exit code {told.code}"
    if attempt.wants == "success":
        return "it was refused"
    if is_box(told.err):
        return ""
    if len(lines) != 1 or not lines[0].startswith("astray: ") or len(lines[0]) < 12:
        return f"{len(lines)} lines on standard error, and not one sentence"
    if len(lines[0]) > LONGEST:
        return f"a sentence of {len(lines[0])} characters"
    if attempt.names not in lines[0]:
        return f"it does not name {attempt.names!r}"
    return _deep(lines[0])


def is_box(text: str) -> bool:
    """Whether it is the message of the library that reads the command line."""
    return text.lstrip().startswith("╭") and text.rstrip().endswith(("╯", "╯\n"))


def _of_error(attempt: Attempt, names: list[str], message: str) -> str:
    if attempt.wants == "success":
        return f"{names[0]}: it was refused"
    accepted = {one.__name__ for one in (*TOLD, *attempt.also)}
    if not accepted & set(names) or names[0] in ("UnboundLocalError", "RecursionError"):
        return f"{names[0]} from inside"
    if attempt.names not in message:
        return f"{names[0]} does not name {attempt.names!r}"
    if not message.strip():
        return f"{names[0]} says nothing"
    return _deep(message) if names[0] in ("TypeError", "KeyError") else ""


def _deep(message: str) -> str:
    return "it speaks of what is inside" if DEEP.search(message) else ""
