"""The verb that opens the lab or exports it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from tyro.conf import Positional

from astray.cli.arguments import AN_AGENT, GivenLevel
from astray.files import read
from astray.training.settings import otherwise
from astray.validation import bounded

LARGEST_PORT = 2**16 - 1
EXPORTED, MOST = 50, 10_000  # levels of a variant that are exported: by default, and at most


def lab(
    agent: Positional[Annotated[Path | None, otherwise("maze-corner", AN_AGENT)]] = None,
    game: Annotated[str | None, otherwise("that of the agent")] = None,
    variant: Annotated[str | None, otherwise("the variant that the agent is tested on")] = None,
    level: GivenLevel = GivenLevel(),
    port: int = 0,
    browser: bool = True,
    export: Annotated[Path | None, otherwise("none")] = None,
    levels: Annotated[int | None, otherwise(f"{EXPORTED}")] = None,
) -> None:
    """Open a page to edit levels and see an agent's policy and value everywhere.

    Example: astray lab maze-corner --variant anywhere-small --level 17

    Args:
        game: Game whose levels are shown.
        variant: Variant that levels are drawn from.
        port: Port, reachable from this machine only; 0 for any free one.
        browser: Open the page in the browser.
        export: Folder for a copy of the page and the agents that any web server can serve.
        levels: Number of levels of each variant to export.

    Raises:
        ValueError: If options do not go together.
    """
    from astray.lab.serving import make_lab

    bounded("port", port, 0, LARGEST_PORT)
    bounded("levels", exported := EXPORTED if levels is None else levels, 1, MOST)
    if levels is not None and export is None:
        raise ValueError("--levels says how many are exported: it needs --export FOLDER")
    level.check()
    start: dict[str, Any] = {"game": game, "variant": variant, "level": level.level}
    if level.level_file is not None:
        start["level"] = read(level.level_file, 2**20).decode()
    made = make_lab(agent, start)
    if export is not None:
        from astray.lab.export import export as write

        write(made, export, exported)
        print(f"{export / 'index.html'}")
        return
    from astray.lab.server import serve

    serve(made, port, browser)
