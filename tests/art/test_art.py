"""The pictures are fresh, the resizing is exact, and everything is told apart at play size."""

from fractions import Fraction
from io import BytesIO
from itertools import product
from math import floor
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import astray
from astray.art import own
from helpers.thorough import thorough

PACKAGE = Path(astray.__file__).parent
MAZE = PACKAGE / "games" / "maze" / "art"
DRAWINGS = sorted(PACKAGE.glob("**/art/*.svg"))
FLOORS = range(9)
WALLS = ["wall-sand", "wall-stone", "wall-hedge"]
OBJECTS = list(product(own.COLOURS, ["cheese", "line", "gem", "star", "ring", "cross"]))
PLACES = [(0, 0), (5, 90), (13, 37), (22, 64), (31, 8), (40, 111), (47, 52), (56, 23)]  # y, x

PICTURE = 64  # pixels a side of what the agent sees
STAMPS = [3, 5, 8]  # pixels a side of a cell where 25, 15 or 8 cells make the picture
# Distances are Euclidean in RGB, of 441 from black to white.
PEAK = 55  # between two stamps, at the pixel where they differ most
MEAN = 25  # between two stamps, over all their pixels


def test_a_png_is_as_fresh_as_its_drawing():
    for svg in DRAWINGS:
        with Image.open(svg.with_suffix(".png")) as png:
            assert png.text["svg"] == own.digest(svg), f"{svg} is stale: python -m astray.art.own"


def test_every_png_has_a_drawing_and_together_they_are_small():
    pngs = sorted(PACKAGE.glob("**/art/*.png"))
    assert [png.with_suffix(".svg") for png in pngs] == DRAWINGS
    assert sum(png.stat().st_size for png in pngs) < 1_000_000  # bytes


@pytest.mark.parametrize("drawings", [DRAWINGS[::4], *thorough(DRAWINGS)])
def test_a_png_shows_what_its_drawing_renders_to(drawings):
    pytest.importorskip("resvg_py")
    for svg in drawings:
        with Image.open(BytesIO(own.render(svg))) as png:
            fresh = np.array(png.convert("RGBA"), int)
        # Another release of the renderer may round an edge otherwise.
        assert np.abs(fresh - own.load(svg.parent, svg.stem)).max() <= 2, svg


def test_walls_floors_and_grounds_are_opaque_and_sprites_are_not():
    opaque = {svg.stem for svg in DRAWINGS if (own.load(svg.parent, svg.stem)[..., 3] == 255).all()}
    whole = ("wall-", "floor-", "ground-")
    assert opaque == {"lava", *(s.stem for s in DRAWINGS if s.stem.startswith(whole))}


def test_a_missing_picture_is_named_with_what_there_is():
    with pytest.raises(FileNotFoundError, match=r"no picture 'mause' .* cheese, cross"):
        own.load(MAZE, "mause")


def nearest(numerator, denominator):
    """The nearest integer to a fraction, halves up, without floats."""
    return floor(Fraction(int(numerator), int(denominator)) + Fraction(1, 2))


def naive(image, height, width):
    """`art.resize` as it is told: repeat every pixel, average the blocks."""
    big = image.astype(int).repeat(height, 0).repeat(width, 1)
    rows, columns = image.shape[:2]
    out = np.zeros((height, width, 4), np.uint8)
    for y, x in np.ndindex(height, width):
        block = big[y * rows : (y + 1) * rows, x * columns : (x + 1) * columns]
        alpha = block[..., 3]
        for c in range(3):
            out[y, x, c] = nearest((block[..., c] * alpha).sum(), max(alpha.sum(), 1))
        out[y, x, 3] = nearest(alpha.sum(), alpha.size)
    return out


@pytest.mark.parametrize(
    "before, after",
    [
        ((8, 8), (3, 3)),
        ((3, 3), (8, 8)),
        ((7, 5), (7, 5)),
        ((6, 4), (3, 2)),
        ((4, 6), (8, 18)),
        ((1, 9), (5, 2)),
        ((9, 2), (1, 1)),
        ((1, 1), (4, 3)),
        ((11, 13), (5, 17)),
    ],
)
def test_resize_is_an_exact_area_average(before, after):
    rng = np.random.default_rng([*before, *after])
    image = rng.integers(0, 256, (*before, 4), np.uint8)
    image[rng.random(before) < 0.4, 3] = 0
    assert np.array_equal(own.resize(image, *after), naive(image, *after))


@pytest.mark.parametrize("height, width", [(3, 3), (64, 128), (77, 1), (512, 1024)])
def test_resize_keeps_a_constant_picture_constant(height, width):
    image = np.full((37, 50, 4), [3, 250, 129, 7], np.uint8)
    assert (own.resize(image, height, width) == [3, 250, 129, 7]).all()


def test_resize_refuses_a_picture_without_alpha():
    with pytest.raises(ValueError, match=r"not \(4, 4, 3\) uint8"):
        own.resize(np.zeros((4, 4, 3), np.uint8), 2, 2)


def test_tint_gives_white_the_colour_and_keeps_alpha():
    shades = np.array([[[255, 255, 255, 9], [128, 128, 128, 255], [0, 0, 0, 0]]], np.uint8)
    tinted = [[[200, 100, 0, 9], [100, 50, 0, 255], [0, 0, 0, 0]]]
    assert own.tint(shades, (200, 100, 0)).tolist() == tinted


def over(background, stamp):
    """Lay stamps [..., H, W, 4] over backgrounds [..., H, W, 3], as floats."""
    alpha = stamp[..., 3:] / 255
    return stamp[..., :3] * alpha + background * (1 - alpha)


def seen(side):
    """Everything that a cell of `side` pixels can show, on every floor at every place.

    Returns the names, and [floor x place, name, side, side, 3] float.
    """
    names = [*OBJECTS, "mouse", *WALLS, "floor"]
    shapes = [own.resize(own.load(MAZE, shape), side, side) for _, shape in OBJECTS]
    stamps = [own.tint(s, own.COLOURS[c]) for s, (c, _) in zip(shapes, OBJECTS, strict=True)]
    stamps += [own.resize(own.load(MAZE, name), side, side) for name in ["mouse", *WALLS]]
    stamps.append(np.zeros((side, side, 4), np.uint8))
    floors = [own.resize(own.load(MAZE, f"floor-{k}"), PICTURE, 2 * PICTURE) for k in FLOORS]
    patches = [f[y : y + side, x : x + side, :3] for f in floors for y, x in PLACES]
    return names, over(np.stack(patches)[:, None], np.stack(stamps))


@pytest.mark.parametrize("side", STAMPS)
def test_everything_a_cell_can_show_is_told_apart_on_every_floor(side):
    names, cells = seen(side)
    for a, name in enumerate(names[:-1]):
        apart = np.linalg.norm(cells[:, a + 1 :] - cells[:, a, None], axis=-1)  # [., ., side, side]
        peak, mean = apart.max((2, 3)).min(0), apart.mean((2, 3)).min(0)
        close = (peak < PEAK) | (mean < MEAN)
        assert not close.any(), [(name, names[a + 1 + b]) for b in np.flatnonzero(close)]


@pytest.mark.parametrize("side", STAMPS)
def test_only_the_mouse_is_white(side):
    names, cells = seen(side)
    whiteness = cells.min(-1).max((2, 3))  # of the whitest pixel: its least channel, 0 to 255
    mouse = whiteness[:, names.index("mouse")].min()
    others = np.delete(whiteness, names.index("mouse"), axis=1).max()
    assert mouse > 230 and others < 190


def luminance(name):
    """The mean luminance of a picture, 0 to 255 (Rec. 709 weights)."""
    return float((own.load(MAZE, name)[..., :3] @ [0.2126, 0.7152, 0.0722]).mean())


def test_every_floor_is_much_darker_than_every_wall():
    darkest_wall = min(luminance(name) for name in WALLS)
    assert max(luminance(f"floor-{k}") for k in FLOORS) < 0.6 * darkest_wall
