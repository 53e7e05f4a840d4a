"""Memory that is asked for is there, or it is said beforehand how much would be needed."""

from __future__ import annotations

import os


def check_memory(needed: int, what: str) -> None:
    """MemoryError where `what` needs more bytes than this machine has.

    Linux promises any amount, and ends the process when it is used. Windows never promises what
    it has not got, so that there libraries notice by themselves.
    """
    there = installed()
    if there is not None and needed > there:
        raise MemoryError(f"{what} need {_told(needed)} of memory; there are {_told(there)}")


def installed() -> int | None:
    """Bytes of memory of this machine; None where the system does not tell."""
    if os.name == "nt":
        return None
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _told(size: int) -> str:
    return f"{size / 1e9:,.1f} GB"
