"""Folders of compiled code, one per version of numba, and their removal.

A version is removed only if it is a folder of this user's, named by a digest and marked. Only
files written by numba and astray are removed from it. No link is followed.
"""

import contextlib
import functools
import os
import re
import stat
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path

import numba
from filelock import FileLock, Timeout

DIGEST = re.compile("[0-9a-f]{16}")  # names of folders of compiled code
# Indices and code, also those that a killed process was writing.
CODE = re.compile(r"(?P<function>.+?)(\.\d+)?\.nb[ic](\.tmp\.[0-9a-f]+)?")
# By the digest of the sources that a function depends on: see `jit.code_digest`.
DIGESTED = re.compile(r"(?P<name>.+)_[0-9a-f]{16}(?P<rest>-\d+\.py\w+)")
USED, LOCK = "used", "compile.lock"
LOCKS = re.compile(r"compile(-.+)?\.lock")  # that of what all use, and one for each game


@dataclass(frozen=True)
class Version:
    """Compiled code of one version and settings of numba.

    Attributes:
        about: Versions of astray and numba; "" if unknown.
        used: Time when a process last began to use it, in seconds since 1970.
        size: Bytes in its `files`.
    """

    folder: Path
    about: str
    used: float
    files: int
    size: int


def mark(folder: Path) -> None:
    """Mark `folder` as one of compiled code, in use now."""
    path = folder / USED
    path.touch()
    if not path.stat().st_size:
        path.write_text(f"astray {version('astray')}, numba {numba.__version__}\n")


def versions(home: Path) -> list[Version]:
    """Return the versions in `home`, last used first; none if it is not a readable folder."""
    found = []
    with contextlib.suppress(OSError):
        for folder in home.iterdir():
            with contextlib.suppress(OSError):  # another user's, or removed meanwhile
                if is_ours(folder):
                    found.append(_version(folder))
    return sorted(found, key=lambda one: (-one.used, one.folder))


def is_ours(folder: Path) -> bool:
    """Return whether this user's processes made `folder` for compiled code."""
    if not DIGEST.fullmatch(folder.name):
        return False
    try:
        both = folder.lstat(), (folder / USED).lstat()
    except OSError:
        return False
    is_mine = not hasattr(os, "getuid") or {one.st_uid for one in both} == {os.getuid()}
    return is_mine and stat.S_ISDIR(both[0].st_mode) and stat.S_ISREG(both[1].st_mode)


def _version(folder: Path) -> Version:
    sizes = [path.lstat().st_size for path in _files(folder)]
    with open(folder / USED, errors="replace") as file:
        about = file.readline(80).strip()
    used = (folder / USED).stat().st_mtime
    return Version(folder, about if about.isprintable() else "", used, len(sizes), sum(sizes))


def _files(folder: Path) -> Iterator[Path]:
    """Return the files that numba and astray wrote into `folder` and its subfolders."""
    for parent, _, names in os.walk(folder):  # which does not go through links
        for name in names:
            path = Path(parent, name)
            is_own = Path(parent) == folder and (name == USED or LOCKS.fullmatch(name))
            is_code = CODE.fullmatch(name) or is_own
            if is_code and stat.S_ISREG(path.lstat().st_mode):
                yield path


def remove(folder: Path) -> bool:
    """Remove a version of compiled code; return whether the folder is gone.

    It stays unchanged if a process is compiling into it. Other files in it stay, and keep the
    folder.
    """
    if not is_ours(folder):
        return False
    with contextlib.suppress(Timeout, OSError), contextlib.ExitStack() as held:
        locks = (path for path in folder.iterdir() if LOCKS.fullmatch(path.name))
        for path in {folder / LOCK, *locks}:
            held.enter_context(FileLock(path).acquire(timeout=0))
        # The mark last: what is left of a removal that was interrupted can be removed.
        for path in sorted(_files(folder), key=lambda path: path == folder / USED):
            path.unlink(missing_ok=True)
        for parent, _, _ in os.walk(folder, topdown=False):
            os.rmdir(parent)
    return not folder.exists()


def outdated(folder: Path) -> list[Path]:
    """Return the files in `folder` of functions whose sources were edited since."""
    files: dict[str, dict[str, list[Path]]] = {}  # by function without digest, then with it
    for path in _files(folder):
        code = CODE.fullmatch(path.name)
        digested = code and DIGESTED.fullmatch(code["function"])
        if code and digested:
            of = files.setdefault(f"{path.parent} {digested['name']} {digested['rest']}", {})
            of.setdefault(code["function"], []).append(path)
    by_time = functools.partial(sorted, key=lambda paths: max(p.lstat().st_mtime_ns for p in paths))
    return [path for of in files.values() for old in by_time(of.values())[:-1] for path in old]
