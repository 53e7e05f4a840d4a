"""How an attempt is run: in a fork, with limits, its streams in files."""

from __future__ import annotations

import contextlib
import json
import os
import resource
import shutil
import signal
import stat
import sys
import time
import traceback
from dataclasses import asdict
from pathlib import Path

from attack.core import Attempt, Outcome, Place, Told, Wrong

TAIL = 600  # characters of what is told of an end
MEMORY = 6 * 2**30  # bytes beside what the process has mapped when it is forked
LARGEST = 2**30  # bytes of a file
GONE = "http://127.0.0.1:9"  # where nobody answers: nothing leaves the machine


def run(attempt: Attempt, place: Place, patience: float) -> Outcome:
    """Make an attempt, which has `patience` times its seconds."""
    for folder in (place.work, place.home):
        folder.mkdir(parents=True)
    sys.stdout.flush()
    begun = time.monotonic()
    child = os.fork()
    if not child:
        _live(attempt, place)
    end, status = _wait(child, begun + attempt.seconds * patience)
    with contextlib.suppress(ProcessLookupError):
        os.killpg(child, signal.SIGKILL)  # what it left running
    if not end:
        _, status = os.waitpid(child, 0)
    seconds = time.monotonic() - begun
    tail = _tail(place)
    if not end:
        return Outcome("hung", seconds, tail=tail)
    if os.WIFSIGNALED(status):
        return Outcome(f"signal {os.WTERMSIG(status)}", seconds, tail=tail)
    path = place.root / "outcome.json"
    if not path.exists():
        return Outcome(f"exit {os.WEXITSTATUS(status)}", seconds, tail=tail)
    data = json.loads(path.read_text(encoding="utf-8"))
    told = Told(**data["told"]) if data["told"] else None
    error = (data["error"][0], data["error"][1]) if data["error"] else None
    if told:
        tail = (told.err or told.out)[-TAIL:]
    elif error:
        tail = f"{error[0][0]}: {error[1]}"[:TAIL] + " | " + data["where"]
    return Outcome(data["end"], seconds, told, error, tail)


def clear(place: Place) -> None:
    """Remove the folder of an attempt, whatever modes it has, and what is on the small disk."""
    roots = [place.root, *(place.small.iterdir() if place.small else ())]
    for root in roots:
        for parent, folders, _ in os.walk(root):
            for name in folders:
                path = os.path.join(parent, name)
                if stat.S_ISDIR(os.lstat(path).st_mode):
                    os.chmod(path, 0o700)
        if root.is_dir() and not root.is_symlink():
            shutil.rmtree(root, ignore_errors=True)
        else:
            root.unlink(missing_ok=True)


def _wait(child: int, until: float) -> tuple[bool, int]:
    pause = 0.002
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return True, status
        time.sleep(pause)
        pause = min(1.5 * pause, 0.05)
    return False, 0


def _tail(place: Place) -> str:
    parts = [place.root / name for name in ("err", "out")]
    return "".join(
        path.read_bytes()[-TAIL:].decode(errors="replace") for path in parts if path.exists()
    )[-TAIL:]


def _live(attempt: Attempt, place: Place) -> None:
    """What the fork does; it does not return."""
    os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    _set_up(place)
    outcome, where = Outcome("returned"), ""
    try:
        value = attempt.act(place)
        outcome.told = value if isinstance(value, Told) else None
    except Wrong as error:
        outcome.end, outcome.error = "wrong", (["Wrong"], str(error))
    except BaseException as error:
        names = [one.__name__ for one in type(error).__mro__]
        if isinstance(error, attempt.also):
            names.append(next(k.__name__ for k in attempt.also if isinstance(error, k)))
        outcome.end, outcome.error = "raised", (names, str(error))
        last = traceback.extract_tb(error.__traceback__)[-3:]
        where = " < ".join(f"{Path(f.filename).name}:{f.lineno}" for f in reversed(last))
    path = place.root / "outcome.json"
    data = asdict(outcome) | {"where": where}
    path.write_text(json.dumps(data, default=str), encoding="utf-8", errors="backslashreplace")
    os._exit(0)


def _set_up(place: Place) -> None:
    """The streams, folders, variables and limits of an attempt."""
    os.chdir(place.work)
    os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
    for number, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(place.root / name, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600), number)
    passing = place.root / "tmp"
    passing.mkdir()
    for name in (
        "XDG_DATA_HOME",
        "XDG_CONFIG_HOME",
        "XDG_CACHE_HOME",
        "ASTRAY_AGENTS",
        "ASTRAY_ART",
    ):
        os.environ.pop(name, None)
    os.environ |= {
        "HOME": str(place.home), "TMPDIR": str(passing), "MPLBACKEND": "Agg", "COLUMNS": "100",
        "http_proxy": GONE, "https_proxy": GONE, "no_proxy": "127.0.0.1,localhost",
        "PIP_INDEX_URL": GONE, "HF_ENDPOINT": GONE, "SDL_VIDEODRIVER": "dummy",
    }  # fmt: skip
    mapped = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    for what, most in (
        (resource.RLIMIT_AS, mapped + MEMORY),
        (resource.RLIMIT_FSIZE, LARGEST),
        (resource.RLIMIT_CORE, 0),
    ):
        resource.setrlimit(what, (most, most))
