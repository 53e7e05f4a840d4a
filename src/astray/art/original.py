"""The original's pictures, which the user imports from Procgen; they are not part of astray.

`astray art import` takes them from the wheel of Procgen 0.10.7, or from a checkout of the paper's
fork, into the user's data folder. Only pictures with a digest in `original.csv` are used.
"""

from __future__ import annotations

import csv
import functools
import hashlib
import io
import os
import re
import subprocess
import sys
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np
import platformdirs
from PIL import Image

from astray.files import archive_of, check_readable, hold, write_aside
from astray.game import Looks
from astray.kernel.qt import GENERIC, SPRITE
from astray.validation import brief, shown

WHEEL = "procgen-0.10.7-cp310-cp310-manylinux_2_17_x86_64.manylinux2014_x86_64.whl"
DOWNLOAD = (
    "download", "--no-deps", "--only-binary=:all:", "--implementation=cp", "--abi=cp310",
    "--python-version=3.10", "--platform=manylinux2014_x86_64", "procgen==0.10.7",
)  # fmt: skip
INSIDE = "procgen/data/assets/"  # of a wheel
FORK = "github.com/JacobPfau/procgenAISC"
FORK_ALONE = ("kenney/Items/yellow_line_diag.png", "kenney/Items/red_line_diag.png")
COMMAND = "astray art import"
SUM = hashlib.sha256().digest_size  # bytes
LARGEST_WHEEL = 2**26  # bytes; Procgen's has 36 million
LARGEST_SIDE = 2**15  # pixels; the largest picture has 1,920


@dataclass(frozen=True)
class Picture:
    """A file of the original: its path among Procgen's assets, size in bytes and SHA-256."""

    path: str
    bytes: int
    sha256: str

    def is_this(self, data: bytes) -> bool:
        """Return whether `data` are exactly the bytes of the file."""
        return len(data) == self.bytes and hashlib.sha256(data).hexdigest() == self.sha256

    def read(self, path: Path) -> bytes:
        """Return the bytes of a file, of a larger one only one more than the picture has."""
        with open(path, "rb") as file:
            return file.read(self.bytes + 1)

    @property
    def kept(self) -> Path:
        """Path of the imported file."""
        return folder() / PurePosixPath(self.path)


def _table(name: str) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(Path(__file__).with_name(name).read_text("utf-8"))))


PICTURES = {
    row["path"]: Picture(row["path"], int(row["bytes"]), row["sha256"])
    for row in _table("original.csv")
}


def paths(pattern: str) -> list[str]:
    """Return the paths that match a regular expression, in the order in which Procgen has them."""
    return [path for path in PICTURES if re.fullmatch(pattern, path)]


FLOORS = paths("topdown_backgrounds/.*")
# As ASSET_LICENSES.md of github.com/openai/procgen has them, of all its games' pictures; the two
# lines are the fork's own, which has Procgen's licence (MIT).
LICENCES = _table("licences.csv")


def folder() -> Path:
    """Return the folder of the pictures: ASTRAY_ART, or in the user's data folder."""
    chosen = os.environ.get("ASTRAY_ART")
    return Path(chosen) if chosen else platformdirs.user_data_path("astray", False) / "original"


def missing() -> list[str]:
    """Return the paths of the pictures that were not imported."""
    return [path for path, picture in PICTURES.items() if not picture.kept.is_file()]


def take(source: Path | None = None) -> list[str]:
    """Import the pictures from a wheel or a checkout, by default from PyPI; return missing ones.

    All are checked before the first one is written, and existing ones stay.

    Raises:
        ValueError: If `source` is neither, or anything but a picture is in its place.
        OSError: If pictures cannot be read or written.
    """
    if source is None:
        with tempfile.TemporaryDirectory(prefix="astray-") as passing:
            return take(_download(Path(passing)))
    if source.is_dir():
        found = _read_all(source, _reader(source))
    elif source.is_file():
        found = _read_wheel(source)
    else:
        raise FileNotFoundError(f"there is no wheel and no checkout of Procgen at {source}")
    if all(map(_is_kept, found)):
        return missing()
    with hold(folder(), "imports pictures to"):
        lacking = {PICTURES[path].kept: data for path, data in found.items() if not _is_kept(path)}
        for kept in lacking:
            if os.path.lexists(kept):  # as a drawing of the user's
                raise ValueError(
                    f"{kept} is not Procgen's picture; where it is gone, that is imported"
                )
        for kept, data in lacking.items():
            write_aside(kept, data)
    return missing()


def _is_kept(path: str) -> bool:
    """Return whether exactly this picture is imported."""
    return (one := PICTURES[path]).kept.is_file() and one.is_this(one.read(one.kept))


def _download(to: Path) -> Path:
    """Download Procgen's wheel by pip without installing it, so that any Python version will do."""
    by_hand = f"download {WHEEL} from PyPI by hand, and: {COMMAND} {WHEEL}"
    try:
        pip = [sys.executable, "-m", "pip", *DOWNLOAD, f"--dest={to}", "--quiet"]
        done = subprocess.run(pip, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    except OSError as error:
        raise OSError(f"pip cannot be run ({error}); {by_hand}") from error
    wheels = list(to.glob("procgen-0.10.7-*.whl"))
    if done.returncode or not wheels:
        said = done.stderr.strip().splitlines() or [f"it ended with {done.returncode}"]
        raise OSError(f"pip could not download Procgen ({said[-1]}); {by_hand}")
    return wheels[0]


def _read_wheel(wheel: Path) -> dict[str, bytes]:
    check_readable(wheel, LARGEST_WHEEL)
    try:
        with archive_of(wheel.read_bytes()) as archive:
            there = {member.filename: member for member in archive.infolist()}
            for name in there:
                if name.startswith(("/", "\\")) or ".." in PurePosixPath(name).parts:
                    raise ValueError(
                        f"{wheel} is refused: it holds {shown(name)}, outside of itself"
                    )

            def read(picture: Picture) -> bytes | None:
                if INSIDE + picture.path not in there:
                    return None
                with archive.open(there[INSIDE + picture.path]) as file:
                    return file.read(picture.bytes + 1)  # never more: a few bytes may unpack to all

            return _read_all(wheel, read)
    except (zipfile.BadZipFile, zlib.error, EOFError, RuntimeError, UnicodeError, OSError) as error:
        raise ValueError(f"{wheel} is no wheel that can be read: {brief(error)}") from error


def _reader(checkout: Path) -> Callable[[Picture], bytes | None]:
    """Return a reader of pictures in a checkout of Procgen or the fork, or in its assets."""
    inside = [checkout / part for part in (INSIDE, "data/assets", "")]
    assets = next((path for path in inside if (path / "kenney").is_dir()), None)
    if assets is None:
        raise ValueError(f"{checkout} is not a checkout of Procgen: it has no {INSIDE}")

    def read(picture: Picture) -> bytes | None:
        path = assets / PurePosixPath(picture.path)
        return picture.read(path) if path.is_file() else None

    return read


def _read_all(source: Path, read: Callable[[Picture], bytes | None]) -> dict[str, bytes]:
    """Read and check all pictures of a source; only the fork has all."""
    found = {}
    for path, picture in PICTURES.items():
        data = read(picture)
        if data is None and path not in FORK_ALONE:
            raise ValueError(f"{source} is not all of Procgen 0.10.7: it lacks {path}")
        if data is not None and not picture.is_this(data):
            raise ValueError(f"{source} is not Procgen 0.10.7: its {path} is another picture")
        if data is not None:
            found[path] = data
    return found


def from_above(variant: Any, pixels: int) -> tuple[int, ...]:
    """Return the shape of a scene with objects, and without below; a window has none."""
    return (1, 1, 3) if variant.window else (2 * pixels, pixels, 3)


def looks(
    background: Callable, foreground: Callable, pictures: Sequence[str], *tables: np.ndarray,
    backgrounds: int = len(FLOORS), scene_shape: Callable = from_above,
) -> dict[str, Looks]:  # fmt: skip
    """Return the looks "original" and "original-5.12" of a game.

    Args:
        background: As of `Looks`.
        foreground: As of `Looks`.
        pictures: Paths of pictures, backgrounds first.
        tables: Further arrays of the art, after pixels, places and rule.
        backgrounds: Number of the backgrounds.
        scene_shape: As of `Looks`.
    """

    @functools.cache
    def art(rule: int) -> tuple[np.ndarray, ...]:
        return *atlas(pictures, backgrounds), np.array([rule]), *tables

    return {
        name: Looks(
            "original", background, foreground, lambda _, __, rule=rule: art(rule), scene_shape
        )
        for name, rule in {"original": GENERIC, "original-5.12": SPRITE}.items()
    }


def atlas(paths: Sequence[str], backgrounds: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Return imported pictures as one array for `kernel.qt`, and their places in it.

    Args:
        backgrounds: Number of leading pictures whose opacity is ignored, as in the original.

    Returns:
        pixels [N] uint32, memory-mapped and shared by all processes, and places [len(paths), 3]
        int64: begin, height, width.

    Raises:
        FileNotFoundError: If a picture was not imported.
        ValueError: If a picture was changed since.
    """
    lacking = [path for path in paths if not PICTURES[path].kept.is_file()]
    if lacking and lacking[0] in FORK_ALONE:
        raise FileNotFoundError(
            f"{lacking[0]} is not among the original's pictures in {folder()}: "
            f"only the paper's fork has it: {COMMAND} CHECKOUT, of {FORK}"
        )
    if lacking:
        raise FileNotFoundError(
            f"the original's pictures are not in {folder()}; to get them: {COMMAND}"
        )
    digest = hashlib.sha256(repr((backgrounds, *(PICTURES[p] for p in paths))).encode())
    file = folder() / f"decoded-{digest.hexdigest()[:16]}.npy"
    kept = _open_atlas(file, len(paths))
    if kept is None:
        made = _decode(paths, backgrounds)
        try:
            data = io.BytesIO()
            np.save(data, made)
            digest = hashlib.sha256(data.getbuffer()).digest()
            write_aside(file, data.getvalue() + digest)
        except OSError:  # the folder may be read-only; then each process has its own
            kept = made
        else:
            kept = _open_atlas(file, len(paths))
            kept = made if kept is None else kept
    sizes = kept[: 2 * len(paths)].reshape(-1, 2).astype(np.int64)
    begins = 2 * len(paths) + np.concatenate([[0], np.cumsum(sizes.prod(1))])
    return kept, np.column_stack([begins[:-1], sizes])


def _open_atlas(file: Path, count: int) -> np.ndarray | None:
    """Return the array of `count` pictures from a file; None if the file lacks it.

    Its SHA-256 follows the array, so that no damaged picture is shown.
    """
    try:
        written = np.memmap(file, np.uint8, "r")
        if hashlib.sha256(written[:-SUM].data).digest() != written[-SUM:].tobytes():
            return None
        # Copied where written to, which nobody does: compiled code takes no read-only arrays.
        kept = np.asarray(np.load(file, mmap_mode="c"))
    except (OSError, ValueError, EOFError):
        return None
    # Compiled code trusts the sizes, whoever wrote them: none so large that products overflow.
    whole = kept.dtype == np.uint32 and kept.ndim == 1 and len(kept) >= 2 * count
    sizes = kept[: 2 * count].reshape(-1, 2).astype(np.int64) if whole else np.full((1, 2), -1)
    fits = ((sizes > 0) & (sizes < LARGEST_SIDE)).all()
    return kept if fits and len(kept) == 2 * count + sizes.prod(1).sum() else None


def _decode(paths: Sequence[str], backgrounds: int) -> np.ndarray:
    """Return all heights and widths, then all pixels."""
    parts, sizes = [], []
    for k, path in enumerate(paths):
        kept = PICTURES[path].kept
        data = PICTURES[path].read(kept)
        if not PICTURES[path].is_this(data):
            raise ValueError(f"{kept} is not what was imported; remove it, and: {COMMAND}")
        with Image.open(io.BytesIO(data)) as image:
            rgba = np.array(image.convert("RGBA")).astype(np.uint32)
        sizes += rgba.shape[:2]
        parts.append(_packed(rgba, opaque=k < backgrounds).reshape(-1))
    return np.concatenate([np.array(sizes, np.uint32), *parts])


def _packed(rgba: np.ndarray, opaque: bool) -> np.ndarray:
    """Convert RGBA [H, W, 4] to [H, W] uint32, red lowest, premultiplied as by Qt."""
    alpha = rgba[..., 3:]
    if opaque:
        alpha, colours = np.full_like(alpha, 255), rgba[..., :3]
    else:
        product = rgba[..., :3] * alpha
        colours = (product + (product >> 8) + 128) >> 8
    red, green, blue = np.moveaxis(colours, -1, 0)
    return red | green << 8 | blue << 16 | alpha[..., 0] << 24
