"""Class 4: full disks, closed folders, no home, streams, variables, memory that is not there."""

from __future__ import annotations

import functools
import os
import resource
import subprocess
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from attack import words
from attack.core import INTERRUPTED, MISTAKE, UNREAD, Attempt, Place, Told, Wrong

WRITERS = (
    "train", "evaluate", "record", "export", "agency", "keep", "reproduce", "lab", "explain",
    "distil", "sweep",
)  # fmt: skip
OUT = {"evaluate": "there.parquet", "record": "there.mp4"}
LEVEL = ("level", "maze", "corner-small", "--levels", "0:500")


def attempts() -> Iterator[Attempt]:
    for verb in WRITERS:
        for name, act in {
            "a full disk": _full,
            "files of 2 kB at most": functools.partial(_limited, 2048),
            "files of nothing": functools.partial(_limited, 0),
            "a closed folder": _closed,
            "no more files": _no_files,
            "no inodes": _no_inodes,
        }.items():
            done = functools.partial(act, verb)
            yield Attempt(4, f"{verb}: {name}", done, "any", seconds=60, leaves=True)
    for name, (act, codes) in {**_streams(), **_variables(), **_folders()}.items():
        begun = name == "no more processes"  # the sweep is, and can go on where there are some
        yield Attempt(4, name, act, "any", seconds=60, codes=codes, leaves=begun)


def _words(verb: str, to: Path, place: Place) -> list[Any]:
    given = words.with_option(words.words_of(verb, place), words.writes(verb), to)
    return [verb, *given]


def _full(verb: str, place: Place) -> Any:
    """On a disk of a few pages, of which one is left."""
    if place.small is None:
        raise OSError("no disk could be mounted")
    (place.small / "filler").write_bytes(b"0" * (2**18 - 3 * 4096))
    given = _words(verb, place.small / OUT.get(verb, "there"), place)
    place.watch(place.small)
    told = place.astray(*given)
    left = [
        p
        for p in place.small.rglob("*")
        if p.is_file() and p.name.startswith(".") and len(p.name) > 33
    ]
    if left:
        raise Wrong(f"{left[0].name} was left")
    return told


def _limited(most: int, verb: str, place: Place) -> Any:
    given = _words(verb, place.work / OUT.get(verb, "there"), place)
    place.watch()
    resource.setrlimit(resource.RLIMIT_FSIZE, (most, resource.RLIM_INFINITY))
    try:
        return _streamless(given)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (resource.RLIM_INFINITY,) * 2)


def _streamless(given: list[Any]) -> Told:
    """The command, its streams in pipes: files that may not grow would end it at its first word."""
    ends = [os.pipe() for _ in range(2)]
    kept = [os.dup(number) for number in (1, 2)]
    for (_, write), number in zip(ends, (1, 2), strict=True):
        os.dup2(write, number)
        os.close(write)
    try:
        code = _quiet(given)
    finally:
        for number, old in zip((1, 2), kept, strict=True):
            os.dup2(old, number)
    texts = []
    for read, _ in ends:
        os.set_blocking(read, False)
        try:
            texts.append(os.read(read, 60_000).decode(errors="replace"))
        except BlockingIOError:
            texts.append("")
    return Told(code, *texts)


def _quiet(given: list[Any]) -> int:
    """The exit code of the command; what it writes goes where its streams lead."""
    import sys
    import traceback

    from astray import cli

    sys.argv = ["astray", *map(str, given)]
    code = 0
    try:
        cli.main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException:
        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    return code


def _closed(verb: str, place: Place) -> Any:
    there = place.work / "closed"
    there.mkdir()
    given = _words(verb, there / OUT.get(verb, "there"), place)
    there.chmod(0o555)
    return place.astray(*given)


def _no_files(verb: str, place: Place) -> Any:
    """Where no more files may be open than a few beside those that are."""
    given = _words(verb, place.work / OUT.get(verb, "there"), place)
    place.watch()
    there = max(map(int, os.listdir("/proc/self/fd")))
    resource.setrlimit(resource.RLIMIT_NOFILE, (there + 3, there + 3))
    return place.astray(*given)


def _no_inodes(verb: str, place: Place) -> Any:
    if place.small is None:
        raise OSError("no disk could be mounted")
    given = _words(verb, place.small / OUT.get(verb, "there"), place)
    for k in range(100):
        try:
            (place.small / f"filler-{k}").touch()
        except OSError:
            break
    return place.astray(*given)


def _streams() -> dict[str, tuple[Callable[[Place], Any], tuple[int, ...]]]:
    """Standard streams that are closed, full, or read no further; in processes of their own."""

    def shell(script: str, place: Place) -> Told:
        import sys

        for name in ("actions.txt", "run"):
            place.copy(name)
        # numba imports coverage where it is installed, which needs a working folder.
        place.mine("without/coverage.py", "raise ImportError")
        place.watch()
        text = script.replace("ASTRAY", f"'{sys.executable}' -m astray").replace(
            "LEVEL", " ".join(LEVEL)
        )
        done = subprocess.run(["bash", "-c", f"set -o pipefail; {text}"], capture_output=True)
        return Told(done.returncode, done.stdout.decode(), done.stderr.decode())

    replay = "ASTRAY replay maze corner-small --level 0 --actions -"
    removed = "export PYTHONPATH=$PWD/without:$PYTHONPATH; mkdir gone; cd gone; rmdir ../gone"
    scripts = {
        "head": ("ASTRAY LEVEL | head -1", (UNREAD,)),
        "head of JSON": ("ASTRAY list --json | head -c 10", (UNREAD,)),
        "head of the help": ("ASTRAY --help | head -1", (UNREAD,)),
        "head of a verb's help": ("ASTRAY train --help | head -1", (UNREAD,)),
        "nobody reads": ("ASTRAY LEVEL | true", (UNREAD,)),
        "nobody reads errors": ("ASTRAY level maze Corner 2>&1 >/dev/null | true; true", ()),
        "output closed": ("ASTRAY LEVEL >&-", ()),
        "errors closed": ("ASTRAY level maze Corner 2>&-", (MISTAKE,)),
        "all closed": ("ASTRAY level maze corner <&- >&- 2>&-", ()),
        "input closed": (f"{replay} <&-", ()),
        "input of bytes": (f"printf '\\377\\376' | {replay}", ()),
        "input of nothing": (f"{replay} < /dev/null", ()),
        "input without end": (f"{replay} < /dev/zero", ()),
        "output full": ("ASTRAY LEVEL > /dev/full", ()),
        "errors full": ("ASTRAY level maze Corner 2> /dev/full; test $? = 2", ()),
        "both full": ("ASTRAY LEVEL > /dev/full 2>&1; test $? = 2", ()),
        "output for reading": ("ASTRAY LEVEL 1< /dev/null", ()),
        "help closed": ("ASTRAY --help >&-", ()),
        "version full": ("ASTRAY --version > /dev/full", ()),
        "training without output": ("ASTRAY evaluate run --levels 0:2 >&- 2>&-", ()),
        "a removed folder": (f"{removed} && ASTRAY list", ()),
        "a removed folder and a level": (f"{removed} && ASTRAY LEVEL", ()),
    }  # fmt: skip
    return {
        f"streams: {name}": (
            functools.partial(shell, script),
            (*codes, 1) if "errors" in name else codes,
        )
        for name, (script, codes) in scripts.items()
    }


def _variables() -> dict[str, tuple[Callable[[Place], Any], tuple[int, ...]]]:
    """Variables of the environment that libraries cannot read, or that lead nowhere."""

    def act(env: dict[str, str | None], given: tuple[str, ...], place: Place) -> Told:
        place.copy("run")
        place.watch()
        return place.process(*given, env=env)

    level = ("level", "maze", "corner-small", "--json")
    video = ("record", "run", "--level", "0", "--pixels", "32")
    list_ = ("list", "--json")
    cases: list[tuple[dict[str, str | None], tuple[str, ...]]] = [
        ({"NUMBA_NUM_THREADS": "x"}, level), ({"NUMBA_NUM_THREADS": "0"}, level),
        ({"NUMBA_NUM_THREADS": "9" * 60}, level), ({"NUMBA_CPU_NAME": "none"}, list_),
        ({"NUMBA_OPT": "many"}, list_), ({"MPLBACKEND": "nothing"}, ("reproduce", "none")),
        ({"MPLCONFIGDIR": "/proc/none"}, ("list",)), ({"HOME": None}, list_),
        ({"HOME": "/nonexistent"}, list_), ({"HOME": ""}, list_), ({"HOME": "relative"}, list_),
        ({"TMPDIR": "/nonexistent"}, list_), ({"TERM": "nothing"}, ("list",)),
        ({"COLUMNS": "x"}, ("list",)), ({"COLUMNS": "1"}, ("list",)),
        ({"COLUMNS": "9" * 20}, ("list",)), ({"LANG": "nothing", "LC_ALL": "nothing"}, list_),
        ({"PYTHONIOENCODING": "ascii"}, ("list",)), ({"PYTHONIOENCODING": "utf-16"}, ("list",)),
        ({"PYTHONUTF8": "0", "LC_ALL": "C"}, ("level", "maze", "Côrner")),
        ({"ASTRAY_AGENTS": "/proc/none"}, list_), ({"ASTRAY_AGENTS": "/dev/null"}, list_),
        ({"ASTRAY_AGENTS": "/nonexistent/" + "x" * 5000}, list_),
        ({"ASTRAY_ART": "/dev/null"}, ("art", "list")), ({"ASTRAY_ART": "x" * 5000}, ("art",)),
        ({"XDG_DATA_HOME": "relative"}, list_), ({"XDG_DATA_HOME": "x" * 5000}, list_),
        ({"XDG_CACHE_HOME": "/dev/null", "NUMBA_CACHE_DIR": None}, ("cache",)),
        ({"NUMBA_CACHE_DIR": "/dev/null"}, ("cache",)),
        ({"NUMBA_CACHE_DIR": "x" * 5000}, ("cache",)),
        ({"RANK": "x", "WORLD_SIZE": "2"}, video), ({"WORLD_SIZE": "-1"}, video),
        ({"OMP_NUM_THREADS": "x"}, video), ({"OMP_NUM_THREADS": "-3"}, video),
        ({"CUDA_VISIBLE_DEVICES": "x"}, video), ({"FORCE_COLOR": "1", "NO_COLOR": "1"}, ("list",)),
    ]  # fmt: skip
    return {
        f"variables: {', '.join(f'{k}={str(v)[:12]}' for k, v in env.items())} {given[0]}": (
            functools.partial(act, env, given),
            (),
        )
        for env, given in cases
    }


def _folders() -> dict[str, tuple[Callable[[Place], Any], tuple[int, ...]]]:
    """A working folder or a home that is closed, and memory that is not there."""

    def closed_home(place: Place) -> Any:
        place.home.chmod(0)
        return place.process("list", "--json", env={"NUMBA_CACHE_DIR": None})

    def closed_work(place: Place) -> Any:
        place.work.chmod(0o555)
        place.watch()
        return place.astray("record", "maze-corner", "--level", "0", "--pixels", "32")

    def memory(size: int, place: Place) -> Any:
        place.copy("run")
        place.watch()
        mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (mapped + size, mapped + size))
        return place.astray("evaluate", "run", "--levels", "0:100000", "--batch", "100000")

    def processes(place: Place) -> Any:
        given = _words("sweep", place.work / "there", place)
        place.watch()
        resource.setrlimit(resource.RLIMIT_NPROC, (1, 1))
        return place.astray(*given)

    return {
        "a closed home": (closed_home, ()), "a closed working folder": (closed_work, ()),
        "no memory but 64 MB": (functools.partial(memory, 2**26), ()),
        "no memory but 256 MB": (functools.partial(memory, 2**28), ()),
        "no more processes": (processes, (INTERRUPTED,)),
    }  # fmt: skip
