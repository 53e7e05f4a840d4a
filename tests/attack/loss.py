"""Class 1: what is removed or written over must be astray's own; with commands."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from attack import words
from attack.core import Attempt, Place, Told
from attack.material import TINY, sweep_words

HEX = "0123456789abcdef" * 2  # as the names of files that are not whole yet end
WRITERS: dict[str, str] = {  # what each writes, as the folder or file that is named
    "train": "there", "keep": "there", "record": "there.mp4", "evaluate": "there.parquet",
    "agency": "there", "export": "there", "lab": "there", "reproduce": "there", "sweep": "there",
    "explain": "there", "distil": "there",
}  # fmt: skip
Lay = Callable[[Place, Path], Any]


def attempts() -> Iterator[Attempt]:
    for verb, to in WRITERS.items():
        for name, lay in LAID.items():
            if name == "a file" and verb in ("record", "evaluate"):
                continue  # it is named to be written
            act = functools.partial(_write, verb, to, lay)
            yield Attempt(1, f"{verb}, where there is {name}", act, "any", seconds=60)
    for name, act in {**_inside(), **_refused(), **_caches()}.items():
        yield Attempt(1, name, act, "any", seconds=60)


def _beside(place: Place, path: Path) -> None:
    """Names beside it that look as ours do."""
    name = path.name
    for one in (
        f".{name}",
        f".{name}.tmp",
        f".{name}.{HEX}",
        f"{name}.part",
        f".{name}.{HEX}.bak",
        ".lock.mine",
        f"{name}~",
    ):
        place.mine(path.with_name(one))
    place.mine(path.with_name(f".other.{HEX}") / "notes.txt")
    place.mine(path.with_name(f".{HEX}.{HEX}") / "agent.safetensors")


# What of the user's lies where something is to be written.
LAID: dict[str, Lay] = {
    "a file": lambda place, path: place.mine(path),
    "a folder with files": lambda place, path: (
        place.mine(path / "notes.txt"),
        place.mine(path / "deep" / "more.txt"),
        place.mine(path / "report.html"),
        place.mine(path / "index.html"),
        place.mine(path / "episodes.parquet"),
        place.mine(path / "figures" / "one.png"),
        place.mine(path / "tables" / "episodes.csv"),
        place.mine(path / "data" / "index.json"),
    ),
    "a link to a file": lambda place, path: (
        place.mine("kept.txt"),
        path.symlink_to(place.work / "kept.txt"),
    ),
    "a link to a folder with files": lambda place, path: (
        place.mine("elsewhere/notes.txt"),
        place.mine("elsewhere/explain.html"),
        path.symlink_to(place.work / "elsewhere"),
    ),
    "a link to nothing": lambda place, path: path.symlink_to(place.work / "gone"),
    "a pipe": lambda place, path: os.mkfifo(path),
    "a folder that may only be read": lambda place, path: (
        place.mine(path / "notes.txt"),
        path.chmod(0o555),
    ),
    "much beside it that looks like ours": _beside,
    "a folder of hidden files": lambda place, path: (
        place.mine(path / ".ssh" / "id"),
        place.mine(path / ".git" / "config"),
        place.mine(path / f".config.json.{HEX}"),
        place.mine(path / f".agent.safetensors.{HEX}" / "notes.txt"),
    ),
}


def _write(verb: str, to: str, lay: Lay, place: Place) -> Told:
    given = words.with_option(words.words_of(verb, place), words.writes(verb), place.work / to)
    lay(place, place.work / to)
    place.watch()
    return place.astray(verb, *given)


def _inside() -> dict[str, Callable[[Place], Told]]:
    """Files of the user's in folders that astray made, and goes on with."""

    def gone_on(make: Callable[[Place], Any], where: str, place: Place) -> Told:
        command = make(place)
        for path in (where, f"{where}.bak", f"{where}/../notes.txt"):
            path = os.path.normpath(path)
            if not os.path.lexists(place.work / path):
                place.mine(path)
        place.watch()
        return place.astray(*command)

    def half(place: Place) -> Any:
        place.copy("half", "runs/seed-0")
        return ("train", *TINY, "--out", "runs")

    def longer(place: Place) -> Any:
        place.copy("run", "runs/seed-0")
        return ("train", *TINY, "--out", "runs")

    def report(place: Place) -> Any:
        place.copy("reports")
        return ("reproduce", place.made / "experiment.py", "--workers", "1")

    def stale(place: Place) -> Any:
        place.copy("reports")
        path = place.mine(
            "experiment.py",
            (place.made / "experiment.py").read_text().replace("levels=4", "levels=5"),
        )
        return ("reproduce", path, "--workers", "1")

    def sweep(place: Place) -> Any:
        return sweep_words(place.copy("sweep"))

    def dataset(place: Place) -> Any:
        place.copy("run")
        return ("export", "run", "--levels", "0:2", "--out", place.copy("dataset"))

    seed = "runs/seed-0"
    one = "reports/experiment-smoke"
    cases = [
        (half, f"{seed}/notes.txt"), (half, f"{seed}/checkpoints/notes.txt"),
        (half, f"{seed}/checkpoints/512/notes.txt"), (half, f"{seed}/checkpoints/256/mine.txt"),
        (half, f"{seed}/checkpoints/.512.{HEX}/notes.txt"), (half, f"{seed}/.config.json.{HEX}.x"),
        (half, f"{seed}/checkpoints/.ssh.{HEX}/agent.safetensors.old"),
        (half, f"{seed}/tensorboard/mine"), (half, f"{seed}/.other.{HEX}"),
        (half, f"{seed}/.notes.txt"), (half, f"{seed}/checkpoints/1024.old/agent.safetensors"),
        (half, f"{seed}/checkpoints/0512/notes"), (longer, f"{seed}/checkpoints/1024/notes.txt"),
        (longer, f"{seed}/checkpoints/mine/agent.safetensors"),
        (report, f"{one}/notes.txt"), (report, f"{one}/computed/notes.txt"),
        (report, f"{one}/computed/mine.parquet"), (report, f"{one}/figures/mine.png"),
        (report, f"{one}/tables/mine.csv"), (report, f"{one}/lab/notes.txt"),
        (report, f"{one}/.plan.json.{HEX}.x"), (report, "reports/notes.txt"),
        (stale, f"{one}/notes.txt"), (stale, f"{one}/computed/notes.txt"),
        (stale, f"{one}/computed/mine.parquet"), (stale, f"{one}/computed/deep/episodes.parquet"),
        (stale, f"{one}/computed/.hidden"), (stale, f"{one}/tables/mine.csv"),
        (sweep, "sweep/notes.txt"), (sweep, "sweep/computed/notes.txt"),
        (sweep, "sweep/computed/mine.parquet"), (sweep, "sweep/agents/notes.txt"),
        (sweep, "sweep/figures/mine.png"), (sweep, "sweep/tables/mine.csv"),
        (dataset, "dataset/notes.txt"), (dataset, "dataset/steps/mine.parquet"),
    ]  # fmt: skip
    return {
        f"{make.__name__}, the user's {where.replace(HEX, '...')}": functools.partial(
            gone_on, make, where
        )
        for make, where in cases
    }


def _refused() -> dict[str, Callable[[Place], Told]]:
    """Commands that are refused at their end, and must leave all as it was."""

    def act(given: tuple[Any, ...], place: Place) -> Told:
        for name in ("run", "agent.pth", "pictures.whl"):
            place.copy(name)
        place.copy("half", "runs/seed-0")
        place.copy("reports")
        place.mine("there/notes.txt")
        place.watch()
        return place.astray(*given)

    other = [word if word != "16" else "8" for word in TINY]
    return {
        f"refused: {' '.join(map(str, given))[:70]}": functools.partial(act, given)
        for given in (
            ("train", *other, "--out", "runs"), ("train", *TINY, "--out", "run"),
            ("train", *TINY, "--out", "runs", "--track", "wandb", "--device", "cuda"),
            ("keep", "run", "--as", "there", "--out", "."),
            ("keep", "run", "--as", "../there", "--out", "runs"),
            ("keep", "run", "--as", "mine", "--out", ".", "--shift", "none"),
            ("import", "agent.pth", "--as", "maze-corner", "--game", "maze", "--variant", "corner"),
            ("import", "agent.pth", "--as", "mine", "--game", "maze", "--variant", "none"),
            ("import", "run/config.json", "--as", "mine"), ("art", "import", "pictures.whl"),
            ("art", "import", "there"), ("agents", "fetch", "nobody"), ("pull", "ada/mouse"),
            ("push", "run", "ada/mouse"), ("evaluate", "run", "--levels", "x", "--out", "a/b"),
            ("record", "run", "--variant", "none", "--out", "new/video.mp4"),
            ("agency", "run", "--variant", "none", "--out", "new"),
            ("explain", "run", "--layers", "none", "--out", "new"),
            ("export", "run", "--levels", "0:2", "--out", "there"),
            ("lab", "run", "--export", "there"), ("lab", "none", "--export", "new"),
            ("reproduce", "nothing.py", "--out", "reports"), ("sweep", "maze", "none"),
            ("distil", "run", "--variant", "none", "--out", "new"),
        )
    }  # fmt: skip


def _caches() -> dict[str, Callable[[Place], Told]]:
    """`cache --prune`, with files of the user's in the folders of compiled code."""

    def act(lay: Callable[[Place, Path], Any], place: Place) -> Told:
        home = place.work / "code" / "astray"
        old = home / "0123456789abcdef"
        old.mkdir(parents=True)
        (old / "used").write_text("astray 0, numba 0\n")
        (old / "compile.lock").touch()
        code = old / "maze_1" / "rules.step-9.py311.nbi"
        code.parent.mkdir()
        code.write_text("compiled")
        place.ours.append(old)
        lay(place, old)
        place.users += [path for path in old.iterdir() if path.is_symlink()]
        place.watch()
        os.environ["NUMBA_CACHE_DIR"] = str(place.work / "code")
        return place.astray("cache", "--prune")

    def linked(place: Place, old: Path) -> None:
        place.mine("mine/used")
        place.mine("mine/one.nbi")
        (old.parent / "fedcba9876543210").symlink_to(place.work / "mine")

    cases: dict[str, Callable[[Place, Path], Any]] = {
        "notes in it": lambda place, old: place.mine(old / "notes.txt"),
        "notes deep in it": lambda place, old: place.mine(old / "maze_1" / "notes.txt"),
        "a hidden file in it": lambda place, old: place.mine(old / ".hidden"),
        "a folder like a version's, without its mark": lambda place, old: place.mine(
            old.parent / "aaaaaaaaaaaaaaaa" / "one.nbi"
        ),
        "a file like a version's": lambda place, old: place.mine(old.parent / "bbbbbbbbbbbbbbbb"),
        "a link to a folder like a version's": linked,
        "a link in it": lambda place, old: (
            place.mine("mine/one.nbi"),
            (old / "maze_2").symlink_to(place.work / "mine"),
        ),
        "a link by the name of code": lambda place, old: (
            place.mine("mine/one.nbi"),
            (old / "two.nbi").symlink_to(place.work / "mine/one.nbi"),
        ),
        "code of another program beside it": lambda place, old: place.mine(
            old.parent.parent / "other" / "one.nbi"
        ),
        "code of the user's in it": lambda place, old: place.mine(old / "thesis.nbc.txt"),
        "a folder of the user's in it": lambda place, old: place.mine(old / "mine" / "one.txt"),
        "a table in it": lambda place, old: place.mine(old / "used.csv"),
        "a name like a passing one": lambda place, old: place.mine(old / "one.nbi.tmp.x"),
    }
    return {
        f"cache --prune, with {name}": functools.partial(act, lay) for name, lay in cases.items()
    }
