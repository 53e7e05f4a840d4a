"""`python -m attack OUT`: make all attempts, or some, and say what was flagged."""

from __future__ import annotations

import argparse
import gc
import json
import os
import random
import shutil
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import TextIO

from attack import confined, forks
from attack.core import CLASSES, Attempt, Place, verdict


def main() -> int:
    given = _parser().parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    base = Path(tempfile.mkdtemp(prefix="attack-"))
    name = "checks.jsonl" if given.check else "log.jsonl"
    try:
        (given.out / name).unlink(missing_ok=True)
        with open(given.out / name, "a+", encoding="utf-8") as log:
            sys.stdout.flush()
            child = os.fork()  # which gives up its rights, and its mounts at its end
            if not child:
                os._exit(_attack(given, base, log))
            return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    finally:
        shutil.rmtree(base, ignore_errors=True)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="attack", description=__doc__)
    parser.add_argument("out", type=Path, help="folder for log.jsonl")
    parser.add_argument("--classes", default="1,2,3,4,5,6,7", help="of attempts, by number")
    parser.add_argument("--fraction", type=float, default=1.0, help="of the attempts of each class")
    parser.add_argument("--seed", type=int, default=0, help="which these are, and their order")
    parser.add_argument("--only", default="", help="attempts that have this in their names")
    parser.add_argument("--patience", type=float, default=1.0, help="times all limits of time")
    parser.add_argument("--kept", type=Path, help="of code and files that are made once")
    parser.add_argument("--jobs", type=int, default=2, help="attempts at once")
    parser.add_argument("--count", action="store_true", help="count the attempts, and make none")
    parser.add_argument("--check", action="store_true", help="see that each failure is noticed")
    return parser


def _attack(given: argparse.Namespace, base: Path, log: TextIO) -> int:
    try:
        if given.kept and not os.getuid():
            confined.lend(given.kept)
        disks = confined.confine(base, confined.folders_of_python(), given.jobs)
        return _make_all(given, base, disks, log)
    except (OSError, RuntimeError, ValueError) as error:
        print(f"attack: {error}", file=sys.stderr)
        return 2


def _make_all(
    given: argparse.Namespace, base: Path, disks: Sequence[Path | None], log: TextIO
) -> int:
    kept = given.kept.absolute() if given.kept else base
    _prepare(kept / "code", base)
    from attack import checks, every

    wanted = checks.ATTEMPTS if given.check else _chosen(every.attempts(), given)
    if given.count:
        counts = Counter(one.kind for one in wanted)
        print("\n".join(f"{k} {CLASSES[k]}: {counts[k]}" for k in sorted(counts)))
        print(f"all: {sum(counts.values())}")
        return 0
    began = time.monotonic()
    if not given.check:
        _make(kept)
    gc.freeze()
    print(f"made what is attacked with: {time.monotonic() - began:.0f} s", flush=True)
    for job, small in enumerate(disks):
        sys.stdout.flush()
        if not os.fork():
            os._exit(_loop(given, wanted[job :: len(disks)], base / f"{job}", kept, small, log))
    ends = [os.waitstatus_to_exitcode(os.wait()[1]) for _ in disks]
    if any(ends):
        raise RuntimeError(f"the attack itself ended with {ends}")
    log.seek(0)  # it may lie where the user of the attack cannot open it
    rows = [json.loads(line) for line in log.read().splitlines()]
    if given.check:
        return checks.report(rows)
    return _summary(rows, time.monotonic() - began)


def _make(kept: Path) -> None:
    """Make what attempts are made with, and load compiled code, which all forks then have."""
    from attack import endless, material

    material.make(kept / "made")
    endless.make_terabyte(kept)
    material.warm()


def _loop(
    given: argparse.Namespace,
    wanted: Sequence[Attempt],
    root: Path,
    kept: Path,
    small: Path | None,
    log: TextIO,
) -> int:
    """Make attempts one after the other, each a line of the log."""
    for number, attempt in enumerate(wanted):
        place = Place(root / f"{number}", kept / "made", small)
        row = _one(attempt, place, given.patience)
        log.write(json.dumps(row) + "\n")
        log.flush()
        if row["verdict"] != "held" and not given.check:
            print(f"FLAGGED {attempt.kind} {attempt.name}: {row['reason']}", flush=True)
    return 0


def _prepare(code: Path, base: Path) -> None:
    """What is so for all attempts, before anything is imported that looks at it."""
    home = base / "home"
    home.mkdir(parents=True)
    os.environ |= {
        "HOME": str(home),
        "NUMBA_CACHE_DIR": str(code),
        "OMP_NUM_THREADS": "1",
        "POLARS_MAX_THREADS": "1",
        "PYTHONDONTWRITEBYTECODE": "1",
        "MPLCONFIGDIR": str(code.parent / "mpl"),
        "PYTHONPATH": os.pathsep.join(filter(None, map(os.path.abspath, sys.path))),
    }
    sys.dont_write_bytecode = True  # here, too: an experiment's cache is no change that it made
    os.chdir(base)
    import matplotlib.pyplot
    import torch

    import astray.cli.verbs
    import astray.experiments.run
    import astray.experiments.sweep.run
    import astray.lab.export
    import astray.lab.session

    torch.set_num_threads(1)
    for name in astray.cli.verbs.VERBS:
        astray.cli.verbs.find(name)


def _chosen(found: Sequence[Attempt], given: argparse.Namespace) -> list[Attempt]:
    """The attempts that were asked for, in an order that the seed decides."""
    names = Counter((one.kind, one.name) for one in found)
    if twice := [name for name, count in names.items() if count > 1]:
        raise ValueError(f"two attempts are called {twice[0]}")
    draw, chosen = random.Random(given.seed), []
    for kind in map(int, given.classes.split(",")):
        mine = [one for one in found if one.kind == kind and given.only in one.name]
        draw.shuffle(mine)
        chosen += mine[: -int(-len(mine) * given.fraction // 1)]
    return chosen


def _one(attempt: Attempt, place: Place, patience: float) -> dict[str, object]:
    """Make an attempt; its line of the log."""
    outcome = forks.run(attempt, place, patience)
    reason = verdict(attempt, outcome, place)
    forks.clear(place)
    return {
        "class": attempt.kind,
        "name": attempt.name,
        "verdict": "FLAGGED" if reason else "held",
        "reason": reason,
        "end": outcome.end,
        "seconds": round(outcome.seconds, 2),
        "code": outcome.told and outcome.told.code,
        "tail": outcome.tail,
    }


def _summary(rows: Sequence[dict[str, object]], seconds: float) -> int:
    print(f"\n{'class':28} attempts flagged seconds")
    for kind, name in CLASSES.items():
        mine = [row for row in rows if row["class"] == kind]
        flagged = sum(row["verdict"] != "held" for row in mine)
        took = sum(float(str(row["seconds"])) for row in mine)
        print(f"{kind} {name:26} {len(mine):8} {flagged:7} {took:7.0f}")
    flagged = [row for row in rows if row["verdict"] != "held"]
    print(f"{'all':28} {len(rows):8} {len(flagged):7} {seconds:7.0f}")
    return 1 if flagged else 0


if __name__ == "__main__":
    sys.exit(main())
