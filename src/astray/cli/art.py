"""The verb for pictures: list them, or import the original's."""

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import Positional

from astray.art import original
from astray.cli.arguments import Json, print_json
from astray.game import OWN
from astray.training.settings import otherwise


def art(
    what: Positional[Literal["list", "import"]] = "list",
    source: Positional[Annotated[Path | None, otherwise("the wheel, downloaded by pip")]] = None,
    json: Json = False,
) -> None:
    """List the pictures of the games, or import those of the original Procgen.

    Example: astray art import

    Args:
        what: Action: list, or import. Import checks the digest of each picture and stores it in the
            user's data folder, or in the folder that ASTRAY_ART names.
        source: Wheel or checkout of procgen 0.10.7, or a checkout of the paper's fork, which alone
            has the lines of Maze.

    Raises:
        ValueError: If `list` is given a source.
    """
    if what == "list" and source is not None:
        raise ValueError(f"pictures are taken from {source} by: {original.COMMAND} {source}")
    missing = original.take(source) if what == "import" else original.missing()
    found = {
        "folder": str(original.folder()),
        "pictures": len(original.PICTURES) - len(missing),
        "missing": missing,
        "licences": original.LICENCES,
    }
    if json:
        print_json({OWN: {"pictures": "all", "licence": "MIT"}, "original": found})
        return
    print(f"{OWN}: drawn for astray, part of it")
    print(f"original: {found['pictures']} of {len(original.PICTURES)} in {found['folder']}")
    if len(missing) == len(original.PICTURES):
        print(f"  to get them: {original.COMMAND}")
    elif missing:
        print(f"  without {', '.join(missing)}")
        if set(missing) <= set(original.FORK_ALONE):
            print(
                f"  which only the paper's fork has: {original.COMMAND} CHECKOUT, of "
                f"{original.FORK}; variants of Maze with a line need them"
            )
    if len(missing) < len(original.PICTURES):
        print("  licences of Procgen's pictures:")
        for of in original.LICENCES:
            print(f"  {of['licence']:10}  {of['pictures']}, by {of['author']}: {of['source']}")
