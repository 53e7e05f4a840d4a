"""As whom attempts are made: a user who may write nowhere but in the folder of the attack.

As root that is the user nobody, in a mount namespace of its own in which the folders above Python
are open and a disk of a few pages is mounted; nothing outside of it is changed.
"""

from __future__ import annotations

import ctypes
import os
import pwd
import sys
from pathlib import Path

NEW_NAMESPACE, PRIVATE, RECURSIVE, BIND = 0x00020000, 1 << 18, 1 << 14, 1 << 12  # <linux/sched.h>
SMALL = 2**18  # bytes of the small disk
USER = "nobody"


def confine(base: Path, needed: list[Path], jobs: int) -> list[Path | None]:
    """Become a user of no rights; a small disk for each job, where they can be had.

    base    the folder that the user gets
    needed  folders that must be read: Python's, the package's

    OSError where a folder is closed to that user, and no mount namespace can be had.
    """
    if os.getuid():
        return [None] * jobs
    user = pwd.getpwnam(USER)
    os.chown(base, user.pw_uid, user.pw_gid)
    _call("unshare", NEW_NAMESPACE)
    _mount(None, "/", None, RECURSIVE | PRIVATE, "")
    owner = f"uid={user.pw_uid},gid={user.pw_gid},mode=700"
    disks: list[Path | None] = []
    for job in range(jobs):
        small = base / f"small-{job}"
        small.mkdir()
        _mount("none", small, "tmpfs", 0, f"size={SMALL},nr_inodes=64,{owner}")
        disks.append(small)
    _open({folder.resolve(): base / f"held-{k}" for k, folder in enumerate(needed)})
    os.setgroups([])
    os.setgid(user.pw_gid)
    os.setuid(user.pw_uid)
    return disks


def lend(folder: Path) -> None:
    """Make a folder that stays, and the attack's user may write to."""
    user = pwd.getpwnam(USER)
    folder.mkdir(parents=True, exist_ok=True)
    os.chown(folder, user.pw_uid, user.pw_gid)


def _open(needed: dict[Path, Path]) -> None:
    """Make folders reachable for all, in this namespace, where one above them is closed.

    needed  each, and where it is held meanwhile
    """
    closed = {
        folder: next((p for p in reversed(folder.parents) if not p.stat().st_mode & 1), None)
        for folder in needed
    }
    behind = {folder: above for folder, above in closed.items() if above is not None}
    for folder in behind:
        needed[folder].mkdir()
        _mount(folder, needed[folder], None, BIND, "")
    for above in set(behind.values()):
        _mount("none", above, "tmpfs", 0, "mode=755,size=1m")
    for folder in behind:
        folder.mkdir(parents=True, exist_ok=True)
        _mount(needed[folder], folder, None, BIND, "")


def _mount(source: object, target: object, kind: str | None, flags: int, options: str) -> None:
    def text(x: object) -> bytes | None:
        return None if x is None else os.fsencode(str(x))

    _call("mount", text(source), text(target), text(kind), flags, text(options))


def _call(name: str, *arguments: object) -> None:
    system = ctypes.CDLL(None, use_errno=True)
    if getattr(system, name)(*arguments):
        number = ctypes.get_errno()
        raise OSError(
            number, f"{os.strerror(number)}; as root this needs {name}: run it as another"
        )


def folders_of_python() -> list[Path]:
    """What must be read to run Python and the package."""
    import attack

    return [Path(sys.base_prefix), Path(sys.prefix), Path(attack.__file__).parents[2]]
