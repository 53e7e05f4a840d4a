"""Memory that is asked for is there, or it is said beforehand how much would be needed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

ROOT = Path("/")


def check_memory(needed: int, what: str) -> None:
    """MemoryError where `what` needs more bytes than this process can ever have.

    Linux promises any amount, and ends the process when it is used. Windows never promises what
    it has not got, so that there libraries notice by themselves.
    """
    there = available()
    if there is not None and needed > there:
        raise MemoryError(f"{what} need {_told(needed)} of memory; there are {_told(there)}")


def available(root: Path | None = None) -> int | None:
    """Bytes of memory of this machine, or of the container that this process runs in.

    None where the system does not tell.

    root  below which the system tells of containers; None: where it does
    """
    if os.name == "nt":
        return None
    installed = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    return min([installed, *_limits(ROOT if root is None else root)])


def _limits(root: Path) -> Iterator[int]:
    """The limits of memory that Linux's control groups set: of this process's, and those above."""
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
    """What is in a file of the system's; nothing where there is none."""
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError):
        return ""


def _told(size: int) -> str:
    return f"{size / 1e9:,.1f} GB"
