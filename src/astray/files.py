"""Safe files: bounded reads, atomic writes, locks, and removal of astray's own files alone."""

import contextlib
import glob
import io
import multiprocessing
import os
import re
import shutil
import stat
import struct
import sys
import uuid
import zipfile
from collections.abc import Collection, Iterable, Iterator
from pathlib import Path

from filelock import FileLock, Timeout

from astray.validation import shown

ASIDE = re.compile(r"\..+\.[0-9a-f]{32}")  # names that `aside_of` makes, and nobody else

LOCK = ".lock"  # the file by which a process holds a folder
ROOM = 2**20  # bytes that a disk must have left before the work whose results it gets
MEMBERS = 20_000  # of an archive; the wheel of Procgen has some 1,000
# Of an archive. Other methods unpack all that a few bytes ask for, whatever is read of it.
METHODS = {zipfile.ZIP_STORED: "stored", zipfile.ZIP_DEFLATED: "deflated"}
ENCRYPTED = 1  # a bit of a member's flags
LARGEST = 2**32  # bytes of a file that is read; none of astray's comes near
UNGUARDED = ", as of a script without `if __name__ == '__main__':` where processes do not fork"


def read(path: Path, most: int = LARGEST) -> bytes:
    """Return the contents of a regular file.

    Raises:
        OSError: If it is not a regular file; a pipe or a device might never end.
        ValueError: If it is larger than `most` bytes.
    """
    if not isinstance(path, str | os.PathLike):
        raise ValueError(f"the path of a file must be a str or Path; got {path!r}")
    # Not blocking: else to open a pipe is to wait for its writer. Windows has no such pipes.
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    number = os.open(path, flags)
    try:
        _check_regular(path, found := os.fstat(number), most)
        with open(number, "rb", closefd=False) as file:
            return file.read(found.st_size)  # Python allocates what is asked for, so not `most`
    finally:
        os.close(number)


def archive_of(data: bytes, methods: Collection[int] = METHODS) -> zipfile.ZipFile:
    """Open an archive in memory; raise BadZipFile unless its members can be read in bounded memory.

    Args:
        data: The archive's bytes.
        methods: Ways of compression that are read, of `METHODS`.
    """
    if (count := data.count(b"PK\1\2")) > MEMBERS:  # a member is 46 bytes, and to Python 1,000
        raise zipfile.BadZipFile(f"it has {count:,} files; at most {MEMBERS:,} are read")
    try:
        archive = zipfile.ZipFile(io.BytesIO(data))
    except (ValueError, OverflowError, NotImplementedError, struct.error) as error:
        raise zipfile.BadZipFile(f"its table of contents cannot be read: {error}") from error
    for member in archive.infolist():
        if not 0 <= member.header_offset < len(data):
            raise zipfile.BadZipFile(f"its {shown(member.filename)} begins outside of it")
        if member.compress_type not in methods:
            those = " or ".join(f"{METHODS[method]} ({method})" for method in methods)
            told = f"is compressed by method {member.compress_type}; files must be {those}"
            raise zipfile.BadZipFile(f"its {shown(member.filename)} {told}")
        if member.flag_bits & ENCRYPTED:
            raise zipfile.BadZipFile(f"its {shown(member.filename)} is encrypted")
    return archive


def check_readable(path: Path, most: int = LARGEST) -> None:
    """Raise OSError or ValueError as `read` does, for a file that a library opens by itself."""
    _check_regular(path, path.stat(), most)


def _check_regular(path: Path, found: os.stat_result, most: int) -> None:
    if not stat.S_ISREG(found.st_mode):
        raise OSError(f"{path} must be a file; it is a folder, a pipe or a device")
    if found.st_size > most:
        raise ValueError(f"{path} must be of at most {most:,} bytes; it has {found.st_size:,}")


def check_writable(path: Path) -> None:
    """Raise OSError unless a file of `ROOM` bytes can be written.

    Folders that killed checks of the same file left are removed.
    """
    check_own(path)
    remove_killed(path)
    with folder_aside(path, path.parent) as aside, hold(aside, "writes"):
        write_aside(aside / path.name, bytes(ROOM))


def make_folder(folder: Path) -> list[Path]:
    """Create `folder` and its parents; return those that are new, deepest first.

    Raises:
        NotADirectoryError: If one of them is anything else.
    """
    missing = [path for path in (folder, *folder.parents) if not os.path.lexists(path)]
    if not (last := (folder, *folder.parents)[len(missing)]).is_dir():
        if not os.path.lexists(last):  # another process has just removed it
            return make_folder(folder)
        raise NotADirectoryError(f"{last} must be a folder; it is a file, or a link to none")
    folder.mkdir(parents=True, exist_ok=True)
    return missing


def remove_made(folders: Iterable[Path]) -> None:
    """Remove folders that `make_folder` created, while they have at most a lock that is free."""
    with contextlib.suppress(OSError):  # another process may have come, and hold it
        for folder in filter(Path.exists, folders):
            if [path.name for path in folder.iterdir()] == [LOCK]:
                with FileLock(folder / LOCK, timeout=0), contextlib.suppress(PermissionError):
                    (folder / LOCK).unlink()  # on Windows its release does
            folder.rmdir()


def check_own(path: Path) -> None:
    """Raise OSError unless `path` is free, or a file that this user may replace."""
    if path.is_symlink():  # as /dev/stdout, or what leads to the user's other disk
        raise OSError(f"{path} must be a file to write; it is a link")
    if path.is_dir():
        raise IsADirectoryError(f"{path} must be a file to write; it is a folder")
    if path.exists() and not path.is_file():
        raise OSError(f"{path} must be a file to write; it is a pipe or a device")
    is_sticky = path.exists() and path.parent.stat().st_mode & stat.S_ISVTX  # as /tmp
    if is_sticky and os.getuid() not in (0, path.stat().st_uid, path.parent.stat().st_uid):
        raise PermissionError(f"{path} is another user's, who alone may replace it")


def aside_of(path: Path) -> Path:
    """Return an unused path beside `path`, for something that is renamed to `path` later."""
    return path.with_name(f".{path.name}.{uuid.uuid4().hex}")


def write_aside(path: Path, data: bytes) -> None:
    """Write `data` to `path`, with its folder: a crash leaves the old file or the new one.

    Raises:
        OSError: If `path` is anything but a file. Renaming would replace it: as root even
            /dev/null, and for anyone a link.
    """
    path = Path(path)
    check_own(path)
    made, aside = make_folder(path.parent), aside_of(path)
    try:
        with open(aside, "xb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        os.replace(aside, path)
    except BaseException as error:  # also an interrupt
        aside.unlink(missing_ok=True)
        remove_made(made)
        if not isinstance(error, OSError):
            raise
        what = "what was there is still there" if path.exists() else "nothing was written"
        raise OSError(error.errno, f"{error.strerror}; {what}", str(path)) from error


@contextlib.contextmanager
def folder_aside(path: Path, told: Path | None = None) -> Iterator[Path]:
    """Yield a new folder, which the caller renames to `path`, and which is removed otherwise.

    Errors name files as in `told`, or in `path`.
    """
    made = make_folder(path.parent)
    aside = aside_of(path)
    try:
        aside.mkdir()
        yield aside
    except OSError as error:
        for name in ("filename", "filename2"):  # are to name what the user knows
            if named := getattr(error, name):
                setattr(error, name, str(named).replace(str(aside), str(told or path)))
        raise
    finally:
        if os.path.exists(aside):  # pathlib would raise where the name is too long
            shutil.rmtree(aside, ignore_errors=True)
        remove_made(made)


def remove_killed(path: Path) -> None:
    """Remove folders beside `path` that killed processes left: their locks are free or missing."""
    for left in path.parent.glob(f".{glob.escape(path.name)}.*"):
        if not ASIDE.fullmatch(left.name) or left.is_symlink():
            continue
        if (left / LOCK).exists():
            with contextlib.suppress(Timeout), hold(left, "writes", wait=False):
                shutil.rmtree(left, ignore_errors=True)
        else:
            with contextlib.suppress(OSError):  # it is a file, or holds something
                left.rmdir()


@contextlib.contextmanager
def new_folder(path: Path) -> Iterator[Path]:
    """Yield a new folder, which becomes `path` on success and is removed on failure.

    Those of its name that killed processes left are removed.
    """
    remove_killed(path)
    with folder_aside(path) as aside:
        with hold(aside, "writes"):
            yield aside
            with contextlib.suppress(PermissionError):  # on Windows its release does
                (aside / LOCK).unlink()
        os.replace(aside, path)


@contextlib.contextmanager
def files_aside(folder: Path, mark: str, sign: bytes) -> Iterator[Path]:
    """Yield a new folder, whose files get to `folder` on success, and on failure none of them.

    Those that killed processes left are removed.

    Raises:
        OSError: As `check_free` does, for the names of the files.
    """
    remove_killed(folder / mark)
    with folder_aside(folder / mark, folder) as aside, hold(aside, "writes"):
        yield aside
        check_free(folder, mark, sign, {*os.listdir(aside)} - {LOCK})
        there = (path for path in aside.rglob("*") if path.is_file())
        files = [path.relative_to(aside) for path in there if path != aside / LOCK]
        for name in files:
            check_own(folder / name)
        for name in sorted(files, key=lambda name: name != Path(mark)):  # whose files these are
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            os.replace(aside / name, folder / name)


@contextlib.contextmanager
def hold(folder: Path, doing: str, wait: bool = True) -> Iterator[None]:
    """Create `folder` and lock it for this process; in the end, remove it if it is new and empty.

    If another process holds the lock, print "another process {doing} {folder}" and wait.

    Raises:
        filelock.Timeout: If another process holds the lock and `wait` is False.
        RuntimeError: If this process still imports the script that began it, and waits for it.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise RuntimeError(f"{folder} is held by the process that began this one{UNGUARDED}")
    lock, seconds, made = FileLock(folder / LOCK), 0, []
    while not lock.is_locked:
        made += make_folder(folder)
        try:
            lock.acquire(timeout=seconds)
        except FileNotFoundError:
            if folder.exists():  # else another process had made it, and removed it again
                raise
        except Timeout:
            if not wait:
                raise
            seconds = -1
            print(f"another process {doing} {folder}; waiting for it", file=sys.stderr, flush=True)
    try:
        yield
    finally:
        lock.release()
        remove_made(made)


def check_empty(folder: Path) -> bool:
    """Return whether `folder` exists; raise FileExistsError unless it is new or empty."""
    is_there = os.path.lexists(folder)
    if is_there and (folder.is_symlink() or not folder.is_dir() or any(folder.iterdir())):
        raise FileExistsError(f"{folder} must be new, or an empty folder; there is something in it")
    return is_there


def holds_only(folder: Path, names: Collection[str]) -> bool:
    """Return whether `folder` is not a link and holds only files of these names."""
    return (
        folder.is_dir()
        and not folder.is_symlink()
        and all(p.name in names and p.is_file() and not p.is_symlink() for p in folder.iterdir())
    )


def check_free(
    folder: Path, mark: str, sign: bytes, names: Collection[str], folders: Collection[str] = ()
) -> None:
    """Raise OSError if `folder` holds files of these `names` but is not one of astray's folders.

    Args:
        mark: Name of the file that marks a folder of astray's.
        sign: Contents that only astray writes to that file.
        folders: Names of further folders, which may be there before the mark.
    """
    check_own(folder / mark)
    is_ours = (folder / mark).exists()
    for name in (*folders, *(name for name in names if is_ours and not Path(name).suffix)):
        if (folder / name).is_file():
            raise NotADirectoryError(f"{folder / name} must be a folder to write to; it is a file")
    if is_ours:
        if sign not in read(folder / mark):
            raise OSError(f"{folder / mark} was not written by astray; it would be replaced")
        inside = (path for name in names for path in (folder / name).glob("**/*"))
        for path in (*(folder / name for name in names), *inside):
            is_file = path.name in names and path.suffix  # ours have folders without
            if is_file or not path.is_dir():
                check_own(path)  # or it would be told after the work
        return
    for name in names:
        if os.path.lexists(folder / name):
            raise OSError(
                f"{folder / name} was not written by astray, which would have {mark} beside it; "
                "it would be replaced"
            )


def remove_left(folder: Path, names: Collection[str]) -> None:
    """Remove temporary files and folders that killed processes left for these `names`.

    Links are not followed. A folder that holds anything else stays.
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
