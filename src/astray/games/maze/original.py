"""Maze with the original's pictures, exact in every pixel."""

import functools
from typing import Any

import numpy as np

from astray.art import original
from astray.game import Looks, Variant
from astray.games.maze.variants import COLOURS, OTHERS, WALLS
from astray.kernel.canvas import copy_flat
from astray.kernel.cells import paint_cells
from astray.kernel.jit import kernel, shared
from astray.kernel.maze import FLOORS
from astray.kernel.overhead import looking, visible
from astray.kernel.qt import GENERIC, SPRITE, around, blit
from astray.record import NEVER

F = np.float32
HALF = F(0.5)  # half a side of the mouse, cells
WALL_PICTURE, MOUSE_PICTURE = "kenney/Ground/Sand/sandCenter.png", "kenney/Enemies/mouse_move.png"
OBJECT_PICTURES = {
    ("cheese", "yellow"): "misc_assets/cheese.png",
    ("line", "yellow"): "kenney/Items/yellow_line_diag.png",
    ("line", "red"): "kenney/Items/red_line_diag.png",
    ("star", "yellow"): "kenney/Items/star.png",
    ("gem", "yellow"): "kenney/Items/gemYellow.png",
    ("gem", "red"): "kenney/Items/gemRed.png",
}
MOUSE_PLACE, OBJECT_PLACES = FLOORS + 1, FLOORS + 2  # among the pictures, after the wall


@shared
def background(s, art, scene):
    """Draw the whole world without the mouse, unless a window moves with it."""
    if s.window == 0:
        paint_world(s, art, scene)


@shared
def paint_world(s, art, image):
    """Draw all cells of the whole world or of the window around the mouse."""
    pixels, places, objects, rule = art
    left, low, cells = visible(s)
    if s.other_x != NEVER:
        put(cells, s.other_x - left, s.other_y - low, objects[s.other_shape, s.other_colour])
    if s.goal_x != NEVER and s.reached_goal == NEVER:
        put(cells, s.goal_x - left, s.goal_y - low, objects[s.goal_shape, s.goal_colour])
    background, seen = (s.background, s.background_offset), looking(s, image.shape[0])
    paint_cells(image, pixels, places, cells, seen, left, low, s.world, background, rule[0])


@kernel
def put(cells, x, y, picture):
    """Draw an object's picture in cell (x, y) if the cell is visible."""
    if picture >= 0 and 0 <= y < cells.shape[0] and 0 <= x < cells.shape[1]:
        cells[y, x] = -2 - picture


@shared
def foreground(s, art, scene, image):
    """Draw the scene or its window around the mouse, with the mouse."""
    pixels, places, _, _ = art
    if s.window or s.reached_goal != NEVER:  # then the goal is gone
        paint_world(s, art, image)
    else:
        copy_flat(image, scene)
    rect = around(looking(s, image.shape[0]), F(s.x), F(s.y), HALF, HALF)
    blit(image, pixels, places[MOUSE_PLACE], rect, s.faces_right)


def scene_shape(variant: Variant, pixels: int) -> tuple[int, ...]:
    p: Any = variant
    return (1, 1, 3) if p.window else (pixels, pixels, 3)


def art(rule: int, variant: Variant, pixels: int) -> tuple[np.ndarray, ...]:
    """Return pixels [N] and places [K, 3] of all pictures, object numbers [8, 7], and the rule [1].

    Object numbers are by shape and colour, NEVER without a picture. ValueError is raised if the
    original has no such walls or objects.
    """
    p: Any
    for p in filter(None, (variant, variant.shifted)):
        if p.walls != WALLS[0]:
            raise ValueError(f"the original has walls of {WALLS[0]} alone; these are of {p.walls}")
    for shape, colour in _needed(variant):
        if shape != "none" and (shape, colour) not in OBJECT_PICTURES:
            there = ", ".join(f"{c} {s}" for s, c in OBJECT_PICTURES)
            raise ValueError(f"the original has no {colour} {shape}; it has: {there}")
    return _art(rule, _objects(variant))


def _needed(variant: Variant) -> set[tuple[str, str]]:
    """Return shape and colour of a variant's objects."""
    p: Any
    found = set()
    for p in filter(None, (variant, variant.shifted)):
        found |= {(p.goal_shape, p.goal_colour), (p.other_shape, p.other_colour)}
    return found


def _objects(variant: Variant) -> tuple[tuple[str, str], ...]:
    """Return the objects that have pictures; only the fork has the lines."""
    needed = _needed(variant)
    return tuple(o for o in OBJECT_PICTURES if o[0] != "line" or needed & {o})


def check(states: np.ndarray, variant: Variant) -> None:
    """Raise ValueError if an object in states [N] has no picture, as in a hand-made state."""
    there = np.zeros((len(OTHERS), len(COLOURS)), bool)
    there[0] = True
    for shape, colour in _objects(variant):
        there[OTHERS.index(shape), COLOURS.index(colour)] = True
    if (other := states["walls"] != 0).any():
        raise ValueError(
            f"the original has walls of {WALLS[0]} alone; state {other.argmax()} has others"
        )
    for what in ("goal", "other"):
        shapes, colours = states[f"{what}_shape"], states[f"{what}_colour"]
        bare = (states[f"{what}_x"] != NEVER) & ~there[shapes, colours]
        if bare.any():
            k = int(bare.argmax())
            look = f"{COLOURS[colours[k]]} {OTHERS[shapes[k]]}"
            raise ValueError(f"there is no picture here of a {look}, which state {k} has")


@functools.cache
def _art(rule: int, objects: tuple[tuple[str, str], ...]) -> tuple[np.ndarray, ...]:
    names = [*original.FLOORS, WALL_PICTURE, MOUSE_PICTURE, *(OBJECT_PICTURES[o] for o in objects)]
    pixels, places = original.atlas(names, FLOORS)
    numbers = np.full((len(OTHERS), len(COLOURS)), NEVER)
    for k, (shape, colour) in enumerate(objects):
        numbers[OTHERS.index(shape), COLOURS.index(colour)] = OBJECT_PLACES + k
    return pixels, places, numbers, np.array([rule])


LOOKS = {
    name: Looks(
        "original", background, foreground, functools.partial(art, rule), scene_shape, check
    )
    for name, rule in {"original": GENERIC, "original-5.12": SPRITE}.items()
}
