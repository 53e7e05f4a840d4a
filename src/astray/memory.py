"""Checks that there is enough memory, before it is allocated."""

import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

ROOT = Path("/")


def check_memory(needed: int, what: str) -> None:
    """Raise MemoryError if `what` needs more bytes than this process can have.

    Linux promises any amount, and kills the process on use. Windows refuses at once, so that
    libraries raise the error themselves.
    """
    there = available()
    if there is not None and needed > there:
        raise MemoryError(f"{what} need {_told(needed)} of memory; there are {_told(there)}")


def available(root: Path | None = None) -> int | None:
    """Return the bytes of memory of this machine or container; None if the system does not say.

    Args:
        root: Folder of the system's files on containers, for tests.
    """
    if os.name == "nt":
        return None
    installed = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return min([installed, *_limits(ROOT if root is None else root)])


def _limits(root: Path) -> Iterator[int]:
    """Return the memory limits of this process's Linux control groups and their parents."""
    for line in _text(root / "proc/self/cgroup").splitlines():
        # "0::/group" in version 2, "7:memory,...:/group" in version 1
        _, controllers, group = [*line.split(":", 2), "", ""][:3]
        if controllers and "memory" not in controllers.split(","):
            continue
        folder, name = (
            (root / "sys/fs/cgroup/memory", "memory.limit_in_bytes")
            if controllers
            else (root / "sys/fs/cgroup", "memory.max")
        )
        inside = PurePosixPath(group.lstrip("/"))
        for above in (inside, *inside.parents):
            limit = _text(folder / above / name).strip()
            if limit.isdecimal():  # else "max", or there is no such file
                yield int(limit)


def _text(path: Path) -> str:
    """Return the text of a system file; "" if it does not exist."""
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError):
        return ""


def _told(size: int) -> str:
    return f"{size / 1e9:,.1f} GB"
