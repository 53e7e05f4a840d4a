"""Class 1: what is made anew, reports' labs and imported pictures, beside what is the user's."""

from __future__ import annotations

import functools
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from attack.core import Attempt, Place
from attack.loss import HEX


def attempts() -> Iterator[Attempt]:
    for name, act in (_labs() | _pictures()).items():
        yield Attempt(1, name, act, "any", seconds=60)


def _labs() -> dict[str, Callable[[Place], Any]]:
    """The lab beside a report, which is made anew, with what the user keeps in it."""

    def act(lay: Callable[[Place, Path], Any], made: bool, place: Place) -> Any:
        from astray.experiments import labs
        from astray.report.findings import Scene

        folder = place.work / "reports" / "one"
        folder.mkdir(parents=True)
        scenes = [Scene(place.copy("run"), "corner-small", 0)]
        if made:
            labs.write(scenes, folder)
            place.ours.append(folder / labs.FOLDER)
        lay(place, folder / labs.FOLDER)
        place.watch()
        return labs.write(scenes, folder)

    cases: dict[str, Callable[[Place, Path], Any]] = {
        "notes": lambda place, lab: place.mine(lab / "notes.txt"),
        "levels of the user's": lambda place, lab: place.mine(lab / "data" / "mine.json"),
        "a hidden folder": lambda place, lab: place.mine(lab / ".git" / "config"),
    }
    found: dict[str, Callable[[Place], Any]] = {
        f"a report's lab with {name}, made again: {made}": functools.partial(act, lay, made)
        for name, lay in cases.items()
        for made in (True, False)
    }

    def linked(place: Place, lab: Path) -> None:
        place.mine("mine/data/index.json")
        place.mine("mine/notes.txt")
        lab.symlink_to(place.work / "mine")

    def own(place: Place, lab: Path) -> None:
        place.mine(lab / "data" / "index.json", "{}")
        place.mine(lab / "thesis.txt")

    found["a report's lab that is a link"] = functools.partial(act, linked, False)
    found["a report's lab that is a project of the user's"] = functools.partial(act, own, False)
    return found


def _pictures() -> dict[str, Callable[[Place], Any]]:
    """Pictures imported to where something of the user's lies; two that are made here."""

    def act(lay: Callable[[Place, Path], Any], place: Place) -> Any:
        import hashlib

        from astray.art import original

        data = b"a picture"
        told = (len(data), hashlib.sha256(data).hexdigest())
        names = ("kenney/one.png", "kenney/deep/two.png")
        original.PICTURES = {name: original.Picture(name, *told) for name in names}
        for name in names:
            place.mine(f"checkout/{original.INSIDE}{name}", data)
        os.environ["ASTRAY_ART"] = str(place.work / "art")
        lay(place, place.work / "art" / names[0])
        place.watch()
        return original.take(place.work / "checkout")

    cases: dict[str, Callable[[Place, Path], Any]] = {
        "a drawing": lambda place, path: place.mine(path),
        "a folder": lambda place, path: place.mine(path / "notes.txt"),
        "a link": lambda place, path: (
            path.parent.mkdir(parents=True),
            place.mine("kept"),
            path.symlink_to("kept"),
        ),
        "a link to nothing": lambda place, path: (
            path.parent.mkdir(parents=True),
            path.symlink_to("gone"),
        ),
        "a folder that is a link": lambda place, path: (
            path.parent.parent.mkdir(),
            place.mine("mine/notes.txt"),
            place.mine("mine/one.png"),
            path.parent.symlink_to(place.work / "mine"),
        ),
        "temporaries of another": lambda place, path: (
            place.mine(path.with_name(f".one.png.{HEX}")),
            place.mine(path.with_name(".one.png")),
        ),
        "decoded pictures": lambda place, path: place.mine(
            path.parents[1] / "decoded-0123456789abcdef.npy"
        ),
    }
    return {
        f"pictures are imported, where there is {name}": functools.partial(act, lay)
        for name, lay in cases.items()
    }
