"""Class 7: several processes in one folder, interrupted and killed, and then undisturbed."""

from __future__ import annotations

import contextlib
import functools
import json
import os
import signal
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from astray.files import ASIDE
from attack.core import INTERRUPTED, MISTAKE, TERMINATED, Attempt, Place, Wrong
from attack.material import TINY, sweep_words
from attack.trees import contents

WITHIN = 90  # seconds that a command has
# Parts of a command's time after which it is disturbed; the first is while it begins.
MOMENTS = (0.02, 0.1, 0.25, 0.5, 0.75, 0.95)
CODES = {"interrupted": INTERRUPTED, "terminated": TERMINATED}
SIGNALS = {"interrupted": signal.SIGINT, "terminated": signal.SIGTERM, "killed": signal.SIGKILL}


@dataclass(frozen=True)
class Work:
    """A command, what it needs, and where what comes of it lies.

    again  what a second command at the same place may end with: it is done, or told that there
           is something
    """

    words: tuple[Any, ...]
    out: str
    needs: tuple[str, ...] = ()
    again: tuple[int, ...] = (0, MISTAKE)
    parts: tuple[str, ...] = ()  # names of files that are the same whoever made them; all, if empty
    leaves: bool = False  # a hidden folder when it is killed, which nobody knows to be given up


WORKS = {
    "train": Work(("train", *TINY, "--out", "runs"), "runs", again=(0,),
                  parts=("agent.safetensors", "trainer.safetensors", "metrics.jsonl")),
    "resume": Work(("train", *TINY, "--out", "half-runs"), "half-runs", ("half",), (0,),
                   ("agent.safetensors", "trainer.safetensors", "metrics.jsonl")),
    "reproduce": Work(("reproduce", "experiment.py", "--workers", "1"), "reports",
                      ("experiment.py",), (0,), ("findings.json", "episodes.csv", "plan.json")),
    "sweep": Work(sweep_words(Path("sweep")), "sweep", ("sweep",), (0,),
                  ("rates.csv", "sweep.json")),
    "keep": Work(("keep", "run", "--as", "mine", "--out", "to"), "to", ("run",),
                 parts=("agent.safetensors", "config.json", "curve.csv", "README.md"),
                 leaves=True),
    "import": Work(("import", "agent.pth", "--as", "mine", "--game", "maze", "--variant",
                    "anywhere", "--art", "own"), "agents", ("agent.pth",), leaves=True),
    "export": Work(("export", "run", "--levels", "0:20", "--out", "dataset"), "dataset", ("run",),
                   leaves=True),
    "lab": Work(("lab", "run", "--export", "page", "--num-levels", "2"), "page", ("run",),
                leaves=True),
    "evaluate": Work(("evaluate", "run", "--levels", "0:200", "--out", "told/e.parquet"), "told",
                     ("run",), (0,)),
    "record": Work(("record", "run", "--level", "0", "--pixels", "64", "--out", "video/f.gif"),
                   "video", ("run",), (0,)),
}  # fmt: skip
# What may be done at once in one folder, by different commands.
MIXED = (
    ("keep", "export"),
    ("export", "lab"),
    ("train", "cache"),
    ("reproduce", "cache"),
    ("import", "cache"),
    ("sweep", "cache"),
    ("keep", "train"),
    ("evaluate", "record"),
)


def attempts() -> Iterator[Attempt]:
    for name in WORKS:
        for count in (2, 4):
            act = functools.partial(_at_once, (name,) * count)
            yield Attempt(7, f"{count} times {name} at once", act, "success", seconds=4 * WITHIN)
        for title in SIGNALS:
            for moment in MOMENTS[::2] if title == "terminated" else MOMENTS[1::2]:
                act = functools.partial(_disturbed, name, title, moment)
                label = f"{name} {title} at {moment:.0%}, and again"
                yield Attempt(7, label, act, "success", seconds=4 * WITHIN)
        act = functools.partial(_beside, name)
        yield Attempt(7, f"{name} killed beside another {name}", act, "success", 4 * WITHIN)
    for pair in MIXED:
        act = functools.partial(_at_once, pair)
        yield Attempt(7, f"{' and '.join(pair)} at once", act, "success", seconds=4 * WITHIN)


def _prepare(names: Sequence[str], place: Place) -> None:
    os.environ["ASTRAY_AGENTS"] = str(place.work / "agents")
    for name in names:
        for needed in WORKS[name].needs if name in WORKS else ():
            to = {"half": "half-runs/seed-0"}.get(needed, needed)
            if not (place.work / to).exists():
                place.copy(needed, to)


def _begin(name: str, place: Place, number: int) -> int:
    """A fork that does the work; its number."""
    words = ("cache", "--prune") if name == "cache" else WORKS[name].words
    sys.stdout.flush()
    child = os.fork()
    if child:
        return child
    os.setsid()
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for stream, end in ((1, "out"), (2, "err")):
        file = os.open(
            place.root / f"{end}-{number}", os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o600
        )
        os.dup2(file, stream)
    from astray import cli

    sys.argv = ["astray", *map(str, words)]
    code = 0
    try:
        cli.main()
    except SystemExit as end:
        code = end.code if isinstance(end.code, int) else 1
    except BaseException:
        import traceback

        traceback.print_exc()
        code = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _end(child: int, within: float = WITHIN) -> int:
    """How a fork ended; Wrong where it does not."""
    until = time.monotonic() + within
    while time.monotonic() < until:
        done, status = os.waitpid(child, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status)
        time.sleep(0.02)
    os.killpg(child, signal.SIGKILL)
    os.waitpid(child, 0)
    raise Wrong(f"it had not ended after {within} s")


def _said(place: Place, number: int) -> str:
    path = place.root / f"err-{number}"
    return path.read_text(errors="replace").strip() if path.exists() else ""


def _outcome(name: str, place: Place, killed: bool = False) -> dict[str, str]:
    """What has come of a work, as digests; without what a kill left aside."""
    work = WORKS[name]
    found = contents(place.work / work.out)
    return {
        path: digest
        for path, digest in found.items()
        if not (killed and work.leaves and ASIDE.fullmatch(Path(path).parts[0]))
        and (not work.parts or Path(path).name in work.parts)
    }


def _stray(name: str, place: Place) -> list[str]:
    """What only a work under way may leave."""
    there = place.work / WORKS[name].out
    found = [p for p in (*there.rglob(".*"), *place.work.glob(".*")) if p.name != ".lock"]
    return [p.name for p in found if len(p.name) > 33]


def make_alone(made: Path) -> None:
    """Do all works once, undisturbed, and note what comes of them and how long they take."""
    noted = {}
    for number, name in enumerate(WORKS):
        place = Place(made / "alone" / name, made)
        place.work.mkdir(parents=True)
        os.chdir(place.work)
        _prepare((name,), place)
        began = time.monotonic()
        if code := _end(_begin(name, place, number), 10 * WITHIN):  # a lab compiles all games
            raise RuntimeError(f"{name} ended with {code}: {_said(place, number)[-300:]}")
        noted[name] = {"seconds": time.monotonic() - began, "outcome": _outcome(name, place)}
    (made / "alone.json").write_text(json.dumps(noted))


def _alone(place: Place) -> dict[str, dict[str, Any]]:
    """What `make_alone` noted."""
    return json.loads((place.made / "alone.json").read_text())


def _undisturbed(names: Sequence[str], place: Place) -> dict[str, dict[str, str]]:
    """What comes of works that nothing happens to."""
    noted = _alone(place)
    return {name: noted[name]["outcome"] for name in names if name in noted}


def _see(
    names: Sequence[str], place: Place, wanted: dict[str, dict[str, str]], killed: bool = False
) -> None:
    for name in wanted:
        found = _outcome(name, place, killed)
        differ = [
            p for p in wanted[name].keys() | found.keys() if wanted[name].get(p) != found.get(p)
        ]
        if differ:
            raise Wrong(f"{name} is not as it is undisturbed: {', '.join(sorted(differ)[:3])}")
        if (left := _stray(name, place)) and not (killed and WORKS[name].leaves):
            raise Wrong(f"{name} left {left[0]}")


def _at_once(names: Sequence[str], place: Place) -> None:
    wanted = _undisturbed(names, place)
    _prepare(names, place)
    children = [_begin(name, place, number) for number, name in enumerate(names)]
    for number, (name, child) in enumerate(zip(names, children, strict=True)):
        code, said = _end(child), _said(place, number)
        if code not in (0, MISTAKE) or "Traceback" in said:
            raise Wrong(f"{name} ended with {code}: {said[-300:]}")
        if code == MISTAKE and len(said.splitlines()) != 1:
            raise Wrong(f"{name} says {len(said.splitlines())} lines: {said[-300:]}")
    _see(names, place, wanted)


def _disturb(name: str, title: str, moment: float, place: Place, number: int) -> None:
    """Do the work and send it a signal; Wrong where it does not end as it should."""
    child = _begin(name, place, number)
    time.sleep(moment * _alone(place)[name]["seconds"])
    with contextlib.suppress(ProcessLookupError):
        os.kill(child, SIGNALS[title])
    code, said = _end(child), _said(place, number)
    if title == "killed" or code == 0:
        return
    lines = [line for line in said.splitlines() if line.startswith("astray: ")]
    if code != CODES[title] or lines != [f"astray: {title}"] or "Traceback" in said:
        raise Wrong(f"{title}, {name} ended with {code}: {said[-300:]}")


def _disturbed(name: str, title: str, moment: float, place: Place) -> None:
    wanted = _undisturbed((name,), place)
    _prepare((name,), place)
    _disturb(name, title, moment, place, 0)
    code = _end(_begin(name, place, 1))
    if code not in WORKS[name].again:
        raise Wrong(f"after it was {title}, {name} ended with {code}: {_said(place, 1)[-300:]}")
    _see((name,), place, wanted, killed=title == "killed")


def _beside(name: str, place: Place) -> None:
    """One of two is killed; the other goes on, or is begun again."""
    wanted = _undisturbed((name,), place)
    _prepare((name,), place)
    first, second = _begin(name, place, 0), _begin(name, place, 1)
    time.sleep(0.4 * _alone(place)[name]["seconds"])
    os.kill(first, signal.SIGKILL)
    _end(first)
    code = _end(second)
    if code not in (0, MISTAKE) or "Traceback" in _said(place, 1):
        raise Wrong(f"the other {name} ended with {code}: {_said(place, 1)[-300:]}")
    if _end(_begin(name, place, 2)) not in WORKS[name].again:
        raise Wrong(f"begun again, {name} says: {_said(place, 2)[-300:]}")
    _see((name,), place, wanted, killed=True)
