"""The folder of compiled code. Its contents are executed: nobody else may ever write there."""

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
    """Return this version's folder of compiled code, or "" if there is none.

    The folder is in the home folder, or in one that the user chose. If that is not writable, or
    others could have written to it, a folder is used that is removed with the process.

    Args:
        digest: Digest of numba's version and settings, the folder's name.
    """
    try:
        found = (home := _made(code_home())).stat()
        if hasattr(os, "getuid") and found.st_uid == os.getuid() and found.st_mode & OTHERS:
            home.chmod(0o700)  # astray's own, to which others can no longer write
        folder = _made(home / digest)
        _check_trusted(folder)
        mark(folder)
    except (OSError, RuntimeError) as error:  # RuntimeError: there is no home
        warnings.warn(f"compiled code is not kept: {error}", stacklevel=2)
        return passing_folder()
    _remove_old(home)
    return str(folder)


def code_home() -> Path:
    """Return the parent of the folders of compiled code: NUMBA_CACHE_DIR, or in the home folder.

    Raises:
        RuntimeError: If there is no home folder.
    """
    numbas = os.environ.get("NUMBA_CACHE_DIR")
    users = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if numbas:
        return Path(numbas).absolute() / "astray"
    # A folder of caches that depends on where Python was started is none.
    return (users if users.is_absolute() else Path.home() / ".cache") / "astray"


def _made(folder: Path) -> Path:
    """Create `folder` and its parents for the user alone; resolve links, which may change."""
    if not folder.exists():
        for path in (*reversed(folder.parents), folder):
            with contextlib.suppress(FileExistsError):
                path.mkdir(mode=0o700)
    return folder.resolve()


def _check_trusted(folder: Path) -> None:
    """Raise PermissionError if another user could have written to or could replace `folder`."""
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
            with contextlib.suppress(FileNotFoundError):  # another process has renamed it
                if _check_owned(path) & OTHERS and not (is_closed or path.is_symlink()):
                    raise PermissionError(f"others may write to {path}")


def _check_owned(path: Path) -> int:
    """Return the mode of `path` if it belongs to this user or the system."""
    found = path.lstat()
    if found.st_uid not in (os.getuid(), 0):
        raise PermissionError(f"{path} is of another user (number {found.st_uid})")
    return stat.S_IMODE(found.st_mode)


def _raise(error: OSError) -> None:
    raise error


def _remove_old(home: Path) -> None:
    """Remove compiled code of versions long unused, and of sources edited long ago."""
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
    """Return a folder that is removed with this process (not with forks); "" if impossible."""
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
    """Lock the folder of compiled code for this process; yield whether that succeeded.

    It fails if the folder is not writable, or the process that holds it was stopped. Then nothing
    may be written.
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
    """Keep waiting for `lock` with a message; return whether it was acquired."""
    # Logged, not warned of: it is nobody's mistake, and a process may make errors of warnings.
    LOG.warning("another process compiles, and holds %s: waiting for it", lock.lock_file)
    if _is_entered(stack, lock, PATIENT):
        return True
    LOG.warning(
        "it still does after %g seconds, or was stopped: compiling beside it, what is not kept",
        SILENT + PATIENT,
    )
    return False
