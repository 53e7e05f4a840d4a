"""What lies in a folder: kind, mode, target of links and digest of each path."""

from __future__ import annotations

import hashlib
import os
import stat
from pathlib import Path

Tree = dict[str, list[str]]
LARGEST = 2**24  # bytes of a file of which the digest is taken; of larger ones it is the size


def tree_of(*roots: Path) -> Tree:
    """All paths below `roots`, and the roots; what is closed is told so, and not entered."""
    found: Tree = {}
    for root in roots:
        if os.path.lexists(root):
            found[str(root)] = _told(str(root))
        for parent, folders, files in os.walk(root):
            for name in (*folders, *files):
                path = os.path.join(parent, name)
                found[path] = _told(path)
    return found


def _told(path: str) -> list[str]:
    try:
        kept = os.lstat(path)
        mode = oct(stat.S_IMODE(kept.st_mode))
        if stat.S_ISLNK(kept.st_mode):
            return ["link", mode, os.readlink(path)]
        if not stat.S_ISREG(kept.st_mode):
            return ["folder" if stat.S_ISDIR(kept.st_mode) else "other", mode, ""]
        if kept.st_size > LARGEST:
            return ["file", mode, str(kept.st_size)]
        with open(path, "rb") as file:
            return ["file", mode, hashlib.sha256(file.read()).hexdigest()]
    except OSError as error:
        return ["closed", str(error.errno), ""]


def contents(root: Path, without: tuple[str, ...] = (".lock", "tensorboard")) -> dict[str, str]:
    """Digests of all files below `root` by their paths in it, but for those with such a part."""
    return {
        str(Path(path).relative_to(root)): told[2]
        for path, told in tree_of(root).items()
        if told[0] == "file" and not set(without) & set(Path(path).parts)
    }
