"""Files that are read at once, written whole or not, and removed where astray made them."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
import stat
import sys
import uuid
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

from filelock import FileLock, Timeout

ASIDE = re.compile(r"\..+\.[0-9a-f]{32}")  # names that `aside_of` makes, and nobody else

LOCK = ".lock"  # the file by which a process holds a folder
LARGEST = 2**32  # bytes of a file that is read; none of astray's comes near


def read(path: Path, most: int = LARGEST) -> bytes:
    """What is in the file at `path`, which a user named.

    OSError where that is none: nobody may ever write to a pipe, and a device has no end.
    ValueError where it is larger than `most` bytes.
    """
    if not isinstance(path, str | os.PathLike):
        raise ValueError(f"the path of a file must be a str or Path; got {path!r}")
    # Not blocking: else to open a pipe is to wait for its writer. Windows has no such pipes.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    number = os.open(path, flags)
    try:
        _see_regular(path, os.fstat(number), most)
        with open(number, "rb", closefd=False) as file:
            return file.read(most)
    finally:
        os.close(number)


def see_readable(path: Path, most: int = LARGEST) -> None:
    """Raise what `read` would of a file that a library opens by itself."""
    _see_regular(path, path.stat(), most)


def _see_regular(path: Path, found: os.stat_result, most: int) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise OSError(f"{path} must be a file; it is a folder, a pipe or a device")
    if found.st_size > most:
        raise ValueError(f"{path} must be of at most {most:,} bytes; it has {found.st_size:,}")


def see_writable(path: Path) -> None:
    """See that the file can be written there, with its folder, before it is worth it.

    OSError where it cannot; what is there is not touched, and nothing is left there.
    """
    _see_replaceable(path)
    made = make_folder(path.parent)
    try:
        aside = aside_of(path)
        with open(aside, "xb"):
            pass
        aside.unlink()
    finally:
        remove_made(made)


def make_folder(folder: Path) -> list[Path]:
    """Make `folder`, and what it lies in; those that were not there, the deepest first."""
    missing = [path for path in (folder, *folder.parents) if not os.path.lexists(path)]
    folder.mkdir(parents=True, exist_ok=True)
    return missing


def remove_made(folders: Iterable[Path]) -> None:
    """Remove what `make_folder` made, as far as nothing is in it."""
    with contextlib.suppress(OSError):
        for folder in folders:
            if folder.exists():
                folder.rmdir()


def _see_replaceable(path: Path) -> None:
    """OSError where something else than a file is at `path`; a file would take its place."""
    if path.is_symlink():  # as /dev/stdout, or what leads to the user's other disk
        raise OSError(f"{path} must be a file to write; it is a link")
    if path.is_dir():
        raise IsADirectoryError(f"{path} must be a file to write; it is a folder")
    if path.exists() and not path.is_file():
        raise OSError(f"{path} must be a file to write; it is a pipe or a device")


def aside_of(path: Path) -> Path:
    """A path beside `path` that nothing has ever had, for what is to be renamed to it."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex}")


def write_aside(path: Path, data: bytes) -> None:
    """Write `data` to `path` so that a kill or a full disk leaves the old file or the new one.

    OSError where there is something else than a file: it would be replaced by one, which root can
    do to /dev/null, and anyone to a link.
    """
    path = Path(path)
    _see_replaceable(path)
    aside = aside_of(path)
    try:
        with open(aside, "xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(aside, path)
    except BaseException as error:  # also an interrupt
        aside.unlink(missing_ok=True)
        if not isinstance(error, OSError):
            raise
        what = "what was there is still there" if path.exists() else "nothing was written"
        raise OSError(error.errno, f"{error.strerror}; {what}", str(path)) from error


@contextlib.contextmanager
def folder_aside(path: Path) -> Iterator[Path]:
    """A new folder beside `path`, to be renamed to it when it is whole; removed if it was not."""
    made = make_folder(path.parent)
    aside = aside_of(path)
    try:
        aside.mkdir()
        yield aside
    finally:
        if os.path.exists(aside):  # pathlib would raise where the name is too long
            shutil.rmtree(aside, ignore_errors=True)
        remove_made(made)


def hold(folder: Path, doing: str, wait: bool = True) -> FileLock:
    """Hold `folder` for this process alone, until the lock that is returned is released.

    Where another process holds it, say so and wait, or filelock's Timeout; what it is `doing` there
    goes before the folder in that sentence.
    """
    lock = FileLock(folder / LOCK)
    try:
        lock.acquire(timeout=0)
    except Timeout:
        if not wait:
            raise
        print(f"another process {doing} {folder}; waiting for it", file=sys.stderr, flush=True)
        lock.acquire(timeout=-1)
    return lock


def remove_empty(folder: Path) -> None:
    """Remove a folder in which `hold` has left its file and nothing else is."""
    with contextlib.suppress(OSError):  # another process may have come
        if [path.name for path in folder.iterdir()] == [LOCK]:
            (folder / LOCK).unlink()
            folder.rmdir()


def holds_only(folder: Path, names: Collection[str]) -> bool:
    """Whether `folder`, which is no link, has files of these names in it and nothing else."""
    return (
        folder.is_dir()
        and not folder.is_symlink()
        and all(p.name in names and p.is_file() and not p.is_symlink() for p in folder.iterdir())
    )


def see_own(path: Path) -> None:
    """OSError where what is at `path` leads elsewhere, or is no file: nothing is to be written."""
    if os.path.lexists(path) and not stat.S_ISREG(path.lstat().st_mode):
        raise OSError(f"{path} must be a file; it is a link, a folder, a pipe or a device")


def see_free(folder: Path, mark: str, sign: bytes, names: Collection[str]) -> None:
    """OSError where files of these `names` are in `folder`, which astray has not written to yet.

    mark  the file by which a folder of astray's is known
    sign  what is in it, and in no file of that name that somebody else writes
    """
    if os.path.lexists(folder / mark):
        see_own(folder / mark)
        if sign not in read(folder / mark):
            raise OSError(f"{folder / mark} is none of astray's; it would be replaced")
        return
    for name in names:
        if os.path.lexists(folder / name):
            raise OSError(
                f"{folder / name} is none of astray's, which would have {mark} beside it; what is "
                "written there would replace it"
            )


def remove_left(folder: Path, names: Collection[str]) -> None:
    """Remove what killed processes left of files of these `names`, or of folders of such.

    Nothing through a link, and no folder with anything else in it.
    """
    if folder.is_symlink() or not folder.is_dir():
        return

    def is_ours(path: Path) -> bool:
        name = path.name[1:-33] if ASIDE.fullmatch(path.name) else path.name
        return name in names and path.is_file() and not path.is_symlink()

    for left in folder.iterdir():
        if not ASIDE.fullmatch(left.name) or left.is_symlink():
            continue
        if is_ours(left):
            left.unlink()
        elif left.is_dir() and all(map(is_ours, inside := list(left.iterdir()))):
            for path in inside:
                path.unlink()
            left.rmdir()
