"""Packages of strangers that offer games, made on the spot and found as if installed."""

from pathlib import Path

from astray import games


def offer(folder: Path, patch, **modules: str) -> None:
    """Have a package offer a game by the name of each module, which has this source."""
    about = folder / "guests-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: guests\nVersion: 1\n")
    offered = "\n".join(f"{name} = {name}:GAME" for name in modules)
    (about / "entry_points.txt").write_text(f"[{games.GROUP}]\n{offered}\n")
    for name, source in modules.items():
        (folder / f"{name}.py").write_text(source)
    patch.syspath_prepend(folder)
    games._offered.cache_clear()
