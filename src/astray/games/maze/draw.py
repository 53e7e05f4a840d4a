"""Maze as pictures, for the agent and at any larger scale, and as symbolic planes."""

import functools
from pathlib import Path
from typing import Any

import numpy as np

from astray.art import own
from astray.game import OWN, Looks, Variant
from astray.games.maze.variants import COLOURS, OTHERS, SHAPES, WALLS
from astray.kernel.jit import kernel
from astray.kernel.maze import (
    cell_pixels,
    margin,
    paint_maze,
    paint_walls,
    scene_cells,
    scene_pixels,
    show,
    show_planes,
    spread,
    stamp,
)
from astray.record import NEVER

ART = Path(__file__).parent / "art"
# The symbolic planes: wall, mouse, dish where a variant has one, on which something may lie (in as
# many planes as it says); and last the objects' shapes and colours as indices into SHAPES and
# COLOURS.
WALL_PLANE, MOUSE_PLANE, DISH_PLANE, SHAPE_PLANE, COLOUR_PLANE = 0, 1, 2, -2, -1
DISH = OTHERS.index("dish")


@kernel
def background(s, art, scene):
    """Draw floor and walls of the whole world and its margin."""
    floors, walls, _, _ = art
    paint_maze(s, scene, floors[s.background], walls[s.walls])


@kernel
def foreground(s, art, scene, image):
    """Draw the scene or its window around the mouse, with objects and mouse."""
    _, _, objects, mouse = art
    edge = margin(s)
    cells = s.world + 2 * edge
    scale = scene.shape[0] / cells
    left, top = show(s, scene, image)
    height = cells - edge - 0.5  # cells from the scene's top to the centre of cell y = 0
    if s.other_x != NEVER:
        other = objects[s.other_shape, s.other_colour]
        stamp(image, other, scale, top, left, height - s.other_y, edge + s.other_x + 0.5)
    if s.goal_x != NEVER and s.reached_goal == NEVER:
        goal = objects[s.goal_shape, s.goal_colour]
        stamp(image, goal, scale, top, left, height - s.goal_y, edge + s.goal_x + 0.5)
    facing = mouse[1] if s.faces_right else mouse[0]
    stamp(image, facing, scale, top, left, height - s.y + 0.5, edge + s.x)


@kernel
def background_planes(s, scene):
    """Write walls and objects of the whole world and its margin."""
    edge = margin(s)
    scene[:] = 0
    paint_walls(s, scene[WALL_PLANE])
    if s.other_x != NEVER and s.other_shape == DISH:
        for plane in range(DISH_PLANE, scene.shape[0] + SHAPE_PLANE):
            scene[plane, edge + s.other_y, edge + s.other_x] = 1
    elif s.other_x != NEVER:
        scene[SHAPE_PLANE, edge + s.other_y, edge + s.other_x] = s.other_shape
        scene[COLOUR_PLANE, edge + s.other_y, edge + s.other_x] = s.other_colour
    if s.goal_x != NEVER:
        scene[SHAPE_PLANE, edge + s.goal_y, edge + s.goal_x] = s.goal_shape
        scene[COLOUR_PLANE, edge + s.goal_y, edge + s.goal_x] = s.goal_colour


@kernel
def foreground_planes(s, scene, planes):
    """Write the scene or its window around the mouse, with the mouse."""
    edge = margin(s)
    x, y = int(s.x) + edge, int(s.y) + edge
    left, low = show_planes(s, scene, planes)
    planes[MOUSE_PLANE, y - low, x - left] = 1
    if s.reached_goal != NEVER:  # then the mouse stands on it
        planes[SHAPE_PLANE, y - low, x - left] = 0
        planes[COLOUR_PLANE, y - low, x - left] = 0


def planes(variant: Variant) -> np.ndarray:
    """Return the largest value of each symbolic plane, [C, H, W] uint8."""
    top = np.ones(_planes(variant), np.uint8)
    top[SHAPE_PLANE], top[COLOUR_PLANE] = len(SHAPES) - 1, len(COLOURS) - 1
    return spread(variant, top)


def planes_scene_shape(variant: Variant) -> tuple[int, ...]:
    return (_planes(variant), scene_cells(variant), scene_cells(variant))


def _planes(variant: Variant) -> int:
    p: Any = variant
    return 4 + p.planes_of_dish


def scene_shape(variant: Variant, pixels: int) -> tuple[int, ...]:
    return scene_pixels(variant, pixels, 1)


def art(variant: Variant, pixels: int) -> tuple[np.ndarray, ...]:
    """Return floors [9, h, 2h, 3], walls [3, S, S, 3], objects [8, 7, S, S, 4], mouse [2, S, S, 4].

    S is a cell's side, rounded up. Objects are indexed by shape and colour; the mouse faces left,
    right.
    """
    scale = cell_pixels(variant, pixels)
    p: Any = variant
    return _art(scale, p.world)


@functools.cache
def _art(scale: float, world: int) -> tuple[np.ndarray, ...]:
    side = int(np.ceil(scale))
    load = functools.partial(own.load, ART)
    floors = own.floors(ART, world * scale)
    walls = [load(f"wall-{name}", side, side)[..., :3] for name in WALLS]
    objects = np.zeros((len(OTHERS), len(COLOURS), side, side, 4), np.uint8)
    for i, shape in enumerate(OTHERS[1:], 1):
        white = load(shape, side, side)
        for j, colour in enumerate(COLOURS[1:], 1):
            objects[i, j] = own.tint(white, own.COLOURS[colour])
    mouse = load("mouse", side, side)
    pair = [mouse, mouse[:, ::-1]]
    # All contiguous, or compiled code would be compiled anew for another layout.
    return tuple(map(np.ascontiguousarray, (floors, walls, objects, pair)))


LOOKS = {OWN: Looks(OWN, background, foreground, art, scene_shape)}
