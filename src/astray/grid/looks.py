"""Appearance of grid worlds: pictures of cells, and one binary symbolic plane per kind."""

import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from astray.art import own
from astray.game import OWN, Looks
from astray.grid.rules import EMPTY, WALL
from astray.kernel.canvas import blit, copy_flat, fill_flat, pixel, tile
from astray.kernel.jit import kernel, shared

SHARED = Path(__file__).parent / "art"
FLOORS = ("floor-a", "floor-b")  # by turns


@shared
def background(s, art, scene):
    """Draw the floor."""
    side = s.cell.shape[0]
    scale = scene.shape[0] / side
    for y in range(side):
        for x in range(side):
            top, left = pixel(y, scale), pixel(x, scale)
            tile(scene, art[0][(x + y) % 2], top, pixel(y + 1, scale), left, pixel(x + 1, scale))


@shared
def foreground(s, art, scene, image):
    """Draw things, movers on them, and the agent on top."""
    _, kinds, agents = art
    side = s.cell.shape[0]
    scale = image.shape[0] / side
    copy_flat(image, scene)
    for y in range(side):
        top = pixel(side - 1 - y, scale)
        for x in range(side):
            for code in (s.cell[y, x], s.mover[y, x]):
                if code != EMPTY:
                    blit(image, kinds[code - 1], top, pixel(x, scale))
    blit(image, agents[s.held], pixel(side - 1 - s.y, scale), pixel(s.x, scale))


@kernel
def foreground_planes(s, scene, planes):
    """Write a plane for each kind, then those of held things, then the agent's.

    In planes larger than the world, the agent is in the middle, with walls around.
    """
    side, seen, agent = s.cell.shape[0], planes.shape[1], planes.shape[0] - 1
    fill_flat(planes, 0)
    left, low = 0, 0
    if seen > side:
        left, low = side - 1 - s.x, side - 1 - s.y
        for y in range(seen):
            for x in range(seen):
                inside = low <= y < low + side and left <= x < left + side
                planes[WALL - 1, y, x] = not inside
    for y in range(side):
        for x in range(side):
            for code in (s.cell[y, x], s.mover[y, x]):
                if code != EMPTY:
                    planes[code - 1, low + y, left + x] = 1
            if s.held > 0:
                planes[agent - s.held, low + y, left + x] = 1
    planes[agent, low + s.y, left + s.x] = 1


@kernel
def background_planes(s, scene):
    """Write nothing, because everything may move."""


def symbols(side: int, planes: int, centred: bool) -> Any:
    """Return the symbolic observations of a world.

    Args:
        side: Cells a side of the world.
        planes: Number of planes: one for each kind, each thing that can be held, and the agent.
        centred: Whether the agent is in the middle of its observation.
    """
    seen = 2 * side - 1 if centred else side
    return SimpleNamespace(
        planes=lambda variant: np.ones((planes, seen, seen), np.uint8),
        planes_scene_shape=lambda variant: (1, 1, 1),
        background_planes=background_planes,
        foreground_planes=foreground_planes,
    )


def looks(folder: Path, side: int, kinds: Sequence[str], agents: Sequence[str]) -> dict:
    """Return the appearance of a world with drawings in `folder`, or shared ones.

    Args:
        folder: Folder of pictures `NAME.png`; a wall's is `wall-grid`, floors' are in `FLOORS`.
        side: Cells a side of the world.
        kinds: Names of things and movers, in the order of their codes.
        agents: Names of the agent's pictures, by what it holds.
    """
    return {
        OWN: Looks(
            OWN, background, foreground,
            art=lambda _, pixels: _art(folder, -(-pixels // side), tuple(kinds), tuple(agents)),
            scene_shape=lambda _, pixels: (pixels, pixels, 3),
        )
    }  # fmt: skip


def drawing(folder: Path, name: str) -> Path:
    """Return the SVG file of a thing: in `folder`, or else shared by all worlds."""
    name = "wall-grid" if name == "wall" else name
    there = next((at for at in (folder, SHARED) if (at / f"{name}.png").is_file()), folder)
    return there / f"{name}.svg"


def sprites(folder: Path, pictures: Mapping[str, Sequence[str]], agents: Sequence[str]) -> Any:
    """Return the drawings of a world for pages.

    Args:
        folder: Folder of its drawings.
        pictures: Character -> names of the kinds in such a cell.
        agents: Names of the agent's drawings, by what it holds.
    """
    names = {*FLOORS, *agents}.union(*pictures.values())
    return SimpleNamespace(
        DRAWINGS={name: drawing(folder, name) for name in sorted(names)},
        FLOORS=FLOORS,
        PICTURES=pictures,
        agent=lambda s: agents[int(s.held)],
    )


@functools.cache
def _art(
    folder: Path, side: int, kinds: tuple[str, ...], agents: tuple[str, ...]
) -> tuple[np.ndarray, ...]:
    """Return floors [2, S, S, 3], kinds [K, S, S, 4], agents [H, S, S, 4], of S pixels a side."""

    def load(name: str) -> np.ndarray:
        path = drawing(folder, name).with_suffix(".png")
        return own.resize(own.load(path.parent, path.stem), side, side)

    floors, sprites, agent = ([load(n) for n in names] for names in (FLOORS, kinds, agents))
    # All contiguous, or compiled code would be compiled anew for another layout.
    return tuple(map(np.ascontiguousarray, (np.stack(floors)[..., :3], sprites, agent)))
