"""A lab beside a report, in which the levels of its videos can be edited and played."""

import hashlib
import json
import os
import shutil
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from astray.acting import initial_states
from astray.analysis.runs import open_run
from astray.files import folder_aside, read, write_aside
from astray.lab.agents import Agents
from astray.lab.export import export, file_names, is_computed
from astray.lab.link import link
from astray.lab.session import Lab
from astray.lab.worlds import is_drawn
from astray.level import Level
from astray.report.findings import Scene

FOLDER = "lab"  # in a report's
WRITTEN = "written.json"  # in it: the digests of its files, by which it is known as astray's


def write(scenes: Iterable[Scene], folder: Path) -> dict[Scene, str]:
    """Write a lab with the scenes' agents to a report's folder; return links to the scenes.

    Scenes whose agent a page cannot compute get none: see `astray.lab.export`.
    """
    found = [scene for scene in scenes if _computed(scene)]
    to, names = folder / FOLDER, file_names(list(dict.fromkeys(str(one.run) for one in found)))
    if not found or not _make_room(to):
        return {}
    first, runs = found[0], {name: Path(name) for name in names}
    start = {"game": open_run(first.run)[0].game, "variant": first.variant, "level": 0}
    with folder_aside(to) as aside:  # a kill leaves none that could not be told from the user's
        export(Lab(Agents.of(runs), start | {"agent": str(first.run)}), aside, 1, list(names))
        write_aside(aside / WRITTEN, _digests(aside))
        aside.rename(to)
    told = json.loads(read(to / "data" / "index.json"))["games"]
    links = {}
    for scene in found:
        config = open_run(scene.run)[1]
        if scene.variant in told[config.game]["variants"]:
            game, variant = config.find_game(), config.variant_for(scene.variant)
            (s,) = initial_states(game, variant, np.array([scene.level]))
            address = link(Level.of(game, variant, s), scene.variant, names[str(scene.run)])
            links[scene] = f"{FOLDER}/index.html{address}"
    return links


def _computed(scene: Scene) -> bool:
    agent, config = open_run(scene.run)
    return is_computed(agent) and is_drawn(config.find_game())


def _make_room(to: Path) -> bool:
    """Remove an unchanged earlier lab; return whether a new one can be written."""
    if not os.path.lexists(to):
        return True
    if to.is_symlink() or not (to / WRITTEN).is_file() or read(to / WRITTEN) != _digests(to):
        return False  # something of the user's is in it
    shutil.rmtree(to, ignore_errors=True)
    return not to.exists()


def _digests(to: Path) -> bytes:
    """Return the digests of a lab's files by path as JSON, without the file that holds them."""
    digests = {
        path.relative_to(to).as_posix(): ""
        if path.is_symlink() or not path.is_file()
        else hashlib.sha256(read(path)).hexdigest()
        for path in sorted(to.rglob("*"))
        if path != to / WRITTEN and (path.is_symlink() or not path.is_dir())
    }
    return json.dumps(digests).encode()
