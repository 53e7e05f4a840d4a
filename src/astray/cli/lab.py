"""The verb that opens the lab, or writes it as files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from tyro.conf import Positional

from astray.analysis import kept
from astray.bounds import bounded
from astray.files import read
from astray.record import LEVELS

LARGEST_PORT = 2**16 - 1
EXPORTED, MOST = 50, 10_000  # levels of a variant that are exported: by default, and at most


def lab(
    run: Positional[Path | None] = None,
    agent: str | None = None,
    game: str | None = None,
    variant: str | None = None,
    level: int | None = None,
    level_file: Path | None = None,
    port: int = 0,
    browse: bool = True,
    export: Path | None = None,
    levels: int | None = None,
) -> None:
    """Open a page to edit levels on, and to see what an agent would do from everywhere.

    Args:
        run: a run folder, or a checkpoint in one
        agent: instead, the name of a kept or imported one
        game: whose levels are shown; by default the agent's
        variant: likewise; by default what the agent is tested on
        level: its number
        level_file: the level instead, as `astray level` prints it
        port: that this machine alone can reach; 0 for any that is free
        browse: open the page in the browser
        export: a folder to write the page to, with the agents, to be served by any web server
        levels: how many of each variant are exported; by default 50
    """
    from astray.lab.serving import make_lab

    bounded("port", port, 0, LARGEST_PORT)
    bounded("levels", exported := EXPORTED if levels is None else levels, 1, MOST)
    if levels is not None and export is None:
        raise ValueError("--levels says how many are exported: it needs --export FOLDER")
    if level is not None:
        bounded("level", level, 0, LEVELS.stop - 1)
    if run is not None and agent is not None:
        raise ValueError("an agent is given by a run folder or by --agent NAME, not both")
    if level is not None and level_file is not None:
        raise ValueError("a level is given by its number or in a file, not both")
    start: dict[str, Any] = {"game": game, "variant": variant, "level": level}
    if level_file is not None:
        start["level"] = read(level_file, 2**20).decode()
    made = make_lab(kept.find(agent) if agent else run, start)
    if export is not None:
        from astray.lab.export import export as write

        write(made, export, exported)
        print(f"{export / 'index.html'}")
        return
    from astray.lab.server import serve

    serve(made, port, browse)
