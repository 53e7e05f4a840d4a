"""Own pictures: drawn as SVG, stored as PNG, resized to the sizes that games need.

All run-time arithmetic is on integers of the committed PNGs, so every machine gets the same bytes.
`python -m astray.art.own` renders the PNGs again after an SVG was edited.
"""

import functools
import hashlib
import io
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from astray.game import OWN, Looks, Variant
from astray.kernel.maze import cell_pixels, scene_pixels
from astray.kernel.stage import turned
from astray.kernel.thief import HALF

# Saturated, and neither as dark as a floor nor as pale as a wall or the mouse.
COLOURS: dict[str, tuple[int, int, int]] = {
    "yellow": (255, 220, 0),
    "red": (250, 30, 30),
    "green": (20, 225, 45),
    "blue": (40, 100, 255),
    "magenta": (255, 30, 220),
    "cyan": (0, 235, 245),
}
FLOOR = 256  # pixels of a floor's height; larger pictures repeat them
ICON = (0.06, 0.045)  # height and width of a key in hand, of the picture's side


def load(folder: Path, name: str, *size: int) -> np.ndarray:
    """Read the picture `<folder>/<name>.png` as RGBA, [height, width, 4] uint8, not premultiplied.

    It is resized if `size`, a height and a width, is given.

    Raises:
        FileNotFoundError: If there is none.
    """
    path = folder / f"{name}.png"
    if not path.is_file():
        there = ", ".join(sorted(png.stem for png in folder.glob("*.png"))) or "none"
        raise FileNotFoundError(f"no picture {name!r} in {folder}; there are: {there}")
    with Image.open(path) as image:
        master = np.array(image.convert("RGBA"))
    return resize(master, *size) if size else master


def resize(image: np.ndarray, height: int, width: int) -> np.ndarray:
    """Resize a picture [H, W, 4] uint8 by exact area averaging, to [height, width, 4].

    The result equals repeating each pixel height x width times and averaging blocks of H x W, with
    colours weighted by alpha and halves rounded up.

    Raises:
        ValueError: If a size is not positive.
    """
    if image.ndim != 3 or image.shape[2] != 4 or image.dtype != np.uint8 or not image.size:
        raise ValueError(f"resize needs [H, W, 4] uint8, not {image.shape} {image.dtype}")
    if height < 1 or width < 1:
        raise ValueError(f"resize to {height} x {width} pixels; both must be 1 or more")
    # int64 is ample: the largest sum, 255 * 255 * H * W * width, fits up to 50,000 pixels a side.
    total = image.astype(np.int64)
    total[..., :3] *= total[..., 3:]
    # The contiguous copy pays: 75 against 160 ms from 256 x 512 to 512 x 1,024 pixels.
    columns = np.ascontiguousarray(_sum_blocks(total, height).swapaxes(0, 1))
    total = _sum_blocks(columns, width).swapaxes(0, 1)
    alpha = total[..., 3:]
    rgb = _divide(total[..., :3], np.maximum(alpha, 1))
    opacity = _divide(alpha, image.shape[0] * image.shape[1])
    return np.concatenate([rgb, opacity], axis=2).astype(np.uint8)


def _sum_blocks(rows: np.ndarray, count: int) -> np.ndarray:
    """Repeat each of `rows` [R, ...] `count` times and return the sums of `count` equal blocks."""
    if len(rows) % count == 0:  # whole blocks, summed in a third of the time
        return count * rows.reshape(count, -1, *rows.shape[1:]).sum(1)
    # Block edges are multiples of R in a column of R * count; there, row `whole` begins
    # `part` repeats before the edge.
    whole, part = np.divmod(np.arange(count + 1) * len(rows), count)
    sums = np.add.reduceat(rows, whole[:-1])
    sums[whole[:-1] == whole[1:]] = 0  # where an empty slice is, `reduceat` puts a row
    edges = part.reshape(-1, *[1] * (rows.ndim - 1)) * rows[np.minimum(whole, len(rows) - 1)]
    return count * sums + np.diff(edges, axis=0)


def _divide(numerator: np.ndarray, denominator: np.ndarray | int) -> np.ndarray:
    """Divide non-negative integers to the nearest, halves up."""
    return (2 * numerator + denominator) // (2 * denominator)


def floors(folder: Path, side: float) -> list[np.ndarray]:
    """Return the floors of a world of `side` pixels, [h, 2h, 3] each."""
    height, count = min(max(round(side), 1), FLOOR), len(list(folder.glob("floor-*.png")))
    return [load(folder, f"floor-{k}", height, 2 * height)[..., :3] for k in range(count)]


def tint(image: np.ndarray, colour: tuple[int, int, int]) -> np.ndarray:
    """Multiply a white `image` [H, W, 4] by `colour` / 255; alpha stays."""
    factor = np.array([*colour, 255], np.int64)
    return _divide(image.astype(np.int64) * factor, 255).astype(np.uint8)


def thief_looks(
    folder: Path, background: Callable, foreground: Callable, things: Callable[..., Iterable]
) -> Looks:
    """Return the looks of a game of `kernel.stage`, whose pictures are in `folder`.

    Its art is: floors [F, h, 2h, 3], wall [S, S, 3], thief by action [9, T, T, 4], and `things`. S
    is a cell's side, rounded up.

    Args:
        things: Function (load, cells, icon) -> pictures of objects and keys in hand, where
            `cells(n)` are height and width of n cells, and `icon` those of a key in hand, pixels.
    """

    @functools.cache
    def pictures(scale: float, world: int, pixels: int) -> tuple[np.ndarray, ...]:
        def cells(count: float) -> tuple[int, int]:
            side = int(np.ceil(count * scale))
            return side, side

        drawn, body = functools.partial(load, folder), cells(2 * float(HALF))
        icon = tuple(max(round(fraction * pixels), 1) for fraction in ICON)
        wall = drawn("wall-brick", *cells(1))[..., :3]
        thief = turned(drawn("thief-right", *body), drawn("thief-right-up", *body))
        made = (floors(folder, world * scale), wall, thief, *things(drawn, cells, icon))
        # All contiguous, or compiled code would be compiled anew for another layout.
        return tuple(map(np.ascontiguousarray, made))

    def art(variant: Variant, pixels: int) -> tuple[np.ndarray, ...]:
        p: Any = variant
        return pictures(cell_pixels(variant, pixels), p.world, pixels)

    def scene_shape(variant: Variant, pixels: int) -> tuple[int, ...]:
        return scene_pixels(variant, pixels, 2)  # with the objects that are left, and without

    return Looks(OWN, background, foreground, art, scene_shape)


def digest(svg: Path) -> str:
    """Return the SHA-256 of an SVG's text, independent of line endings, in hexadecimal."""
    return hashlib.sha256(svg.read_text(encoding="utf-8").encode()).hexdigest()


def render(svg: Path) -> bytes:
    """Render an SVG at its own width and height in pixels; return a PNG file.

    It is RGB if nothing is transparent, otherwise RGBA. Its text chunk "svg" holds the drawing's
    `digest`, which reveals stale files.

    Raises:
        ImportError: If resvg is not installed.
    """
    try:
        import resvg_py
    except ImportError as error:
        raise ImportError("rendering SVG needs resvg_py: pip install resvg_py") from error
    drawn = resvg_py.svg_to_bytes(
        svg_string=svg.read_text(encoding="utf-8"), skip_system_fonts=True
    )
    image = Image.open(io.BytesIO(bytes(drawn))).convert("RGBA")
    if image.getchannel("A").getextrema() == (255, 255):
        image = image.convert("RGB")
    text, file = PngInfo(), io.BytesIO()
    text.add_text("svg", digest(svg))
    image.save(file, "PNG", optimize=True, pnginfo=text)
    return file.getvalue()


def main() -> None:
    """Render every drawing of games, and the shared ones, into a PNG beside it."""
    for svg in sorted(Path(__file__).parents[1].glob("**/art/*.svg")):
        png = render(svg)
        svg.with_suffix(".png").write_bytes(png)
        print(f"{svg.with_suffix('.png')}  {len(png):,} bytes")


if __name__ == "__main__":
    main()
