"""The folder of compiled code. What is in it is run: nobody else may ever write there."""

from __future__ import annotations

import atexit
import contextlib
import logging
import os
import shutil
import stat
import tempfile
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from astray.kernel.versions import LOCK, mark, outdated, remove, versions

LOG = logging.getLogger("astray")
KEPT_FOR = 30 * 24 * 3600  # seconds that the compiled code of another version is kept
OTHERS = stat.S_IWGRP | stat.S_IWOTH  # modes by which others may write
# Seconds that another process is waited for in silence; and until code is compiled beside it.
# The slowest game takes 30.
SILENT, PATIENT = 60, 180


def cache_folder(digest: str) -> str:
    """The folder of this version's compiled code: the user's choice, that in the home, or one
    that ends with the process where others could have written to it or it cannot be written.

    digest   of numba's version and settings; names the folder
    returns  "" where there is no folder at all
    """
    try:
        home = _made(code_home())
        _close(home)
        folder = _made(home / digest)
        _check_trusted(folder)
        mark(folder)
    except (OSError, RuntimeError) as error:  # RuntimeError: there is no home
        warnings.warn(f"compiled code is not kept: {error}", stacklevel=2)
        return passing_folder()
    _remove_old(home)
    return str(folder)


def code_home() -> Path:
    """Where the folders of compiled code are: where NUMBA_CACHE_DIR says, else in the home.

    RuntimeError where there is no home.
    """
    numbas = os.environ.get("NUMBA_CACHE_DIR")
    users = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if numbas:
        return Path(numbas).absolute() / "astray"
    # A folder of caches that depends on where Python was started is none.
    return (users if users.is_absolute() else Path.home() / ".cache") / "astray"


def _made(folder: Path) -> Path:
    """`folder`, made with its parents for the user alone; without links, which may be changed."""
    if not folder.exists():
        for path in (*reversed(folder.parents), folder):
            with contextlib.suppress(FileExistsError):
                path.mkdir(mode=0o700)
    return folder.resolve()


def _close(folder: Path) -> None:
    """Let nobody else write to astray's own folder from now on."""
    found = folder.stat()
    if hasattr(os, "getuid") and found.st_uid == os.getuid() and found.st_mode & OTHERS:
        folder.chmod(0o700)


def _check_trusted(folder: Path) -> None:
    """PermissionError where another user could have written to `folder`, or could replace it."""
    if not hasattr(os, "getuid"):
        return  # Windows: what is below a user's home is the user's
    for path in (*reversed(folder.parents), folder):
        mode = _check_owned(path)
        is_sticky = mode & stat.S_ISVTX and path != folder  # as /tmp: all keep their own there
        if mode & OTHERS and not is_sticky:
            raise PermissionError(
                f"others may write to {path} (mode {mode:o}); chmod go-w mends it"
            )
    is_closed = not folder.stat().st_mode & (stat.S_IRWXG | stat.S_IRWXO)
    for parent, folders, files in os.walk(folder, onerror=_raise):
        for name in (*folders, *files):
            path = Path(parent, name)
            if _check_owned(path) & OTHERS and not (is_closed or path.is_symlink()):
                raise PermissionError(f"others may write to {path}")


def _check_owned(path: Path) -> int:
    """The mode of what is at `path`, if it is this user's or the system's."""
    found = path.lstat()
    if found.st_uid not in (os.getuid(), 0):
        raise PermissionError(f"{path} is of another user (number {found.st_uid})")
    return stat.S_IMODE(found.st_mode)


def _raise(error: OSError) -> None:
    raise error


def _remove_old(home: Path) -> None:
    """Remove compiled code of versions not used for long, and of sources edited long ago."""
    before = time.time() - KEPT_FOR
    for one in versions(home):
        if one.used < before:
            remove(one.folder)
            continue
        with contextlib.suppress(OSError):
            for path in outdated(one.folder):
                if path.lstat().st_mtime < before:
                    path.unlink()


def passing_folder() -> str:
    """A folder that ends with this process, and not with one forked from it; "" if none can be."""
    try:
        folder, owner = tempfile.mkdtemp(prefix="astray-"), os.getpid()
    except OSError:
        return ""

    def remove() -> None:
        if os.getpid() == owner:
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return folder


@contextlib.contextmanager
def held(folder: str, lock_name: str = LOCK) -> Iterator[bool]:
    """Hold a lock in the folder of compiled code for this process, and tell whether it is held.

    It is not where the folder cannot be written, nor where who holds it was stopped: nothing is
    to be written to it then.
    """
    with contextlib.ExitStack() as stack:
        is_held, lock = False, FileLock(Path(folder, lock_name))
        if folder:
            try:
                is_held = _is_entered(stack, lock, SILENT) or _is_waited_for(stack, lock)
            except OSError as error:
                warnings.warn(f"compiled code is not kept: {error}", stacklevel=3)
        yield is_held


def _is_entered(stack: contextlib.ExitStack, lock: FileLock, seconds: float) -> bool:
    try:
        stack.enter_context(lock.acquire(timeout=seconds))
    except Timeout:
        return False
    return True


def _is_waited_for(stack: contextlib.ExitStack, lock: FileLock) -> bool:
    """Wait on for `lock`, and say so; whether it was got."""
    # Logged, not warned of: it is nobody's mistake, and a process may make errors of warnings.
    LOG.warning("another process compiles, and holds %s: waiting for it", lock.lock_file)
    if _is_entered(stack, lock, PATIENT):
        return True
    LOG.warning(
        "it still does after %g seconds, or was stopped: compiling beside it, what is not kept",
        SILENT + PATIENT,
    )
    return False
