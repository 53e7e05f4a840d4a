"""The verb for compiled code: list it, or remove outdated code."""

import time
from pathlib import Path

from rich.table import Table

from astray.cli.arguments import Json, print_json, show
from astray.kernel.cache import code_home, held
from astray.kernel.jit import version_digest
from astray.kernel.versions import Version, outdated, remove, versions


def cache(prune: bool = False, json: Json = False) -> None:
    """Show the folders of compiled code, by version of numba, or remove outdated code.

    Example: astray cache --prune

    Args:
        prune: Remove the code of other versions, and of functions that were edited since. Links,
            files that astray did not write, and code that is being compiled stay.
    """
    home = code_home()
    removed = _prune(home) if prune else 0
    found = versions(home)
    if json:
        told = [{"digest": one.folder.name, "this": _is_this(one), "about": one.about,
                 "used": one.used, "files": one.files, "bytes": one.size}
                for one in found]  # fmt: skip
        return print_json({"folder": str(home), "removed": removed, "versions": told})
    if prune:
        print(f"removed: {removed / 1e6:.1f} MB")
    files, size = sum(one.files for one in found), sum(one.size for one in found)
    print(f"{home}: {size / 1e6:.1f} MB in {files} files")
    table = Table("version", "of", "last used", "MB", "files", "", box=None, padding=(0, 2))
    for one in found:
        day, this = time.strftime("%Y-%m-%d", time.localtime(one.used)), _is_this(one)
        row = (one.folder.name, one.about or "?", day, f"{one.size / 1e6:.1f}", f"{one.files}")
        table.add_row(*row, "this one" if this else "")
    if found:
        show(table)


def _is_this(one: Version) -> bool:
    return one.folder.name == version_digest()


def _prune(home: Path) -> int:
    """Remove unused code from `home`; return the number of bytes."""
    before = sum(one.size for one in versions(home))
    for one in versions(home):
        if not _is_this(one):
            remove(one.folder)
            continue
        with held(str(one.folder)) as is_held:
            for path in outdated(one.folder) if is_held else ():
                path.unlink(missing_ok=True)
    return before - sum(one.size for one in versions(home))
