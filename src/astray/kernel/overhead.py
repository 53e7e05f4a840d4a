"""Mazes, most with a thief, drawn from above as the original draws them, pixel by pixel.

Art consists of `pixels`, `places` and the `rule` of `kernel.cells`, and, by the code in `what`, the
picture and half the width and height of each object in cells. The first pictures are the floors,
followed by the wall and the thief.
"""

import numpy as np

from astray.kernel.canvas import copy_flat
from astray.kernel.cells import OPEN, paint_cells
from astray.kernel.jit import kernel, shared
from astray.kernel.maze import FLOORS, is_wall
from astray.kernel.qt import around, blit, blit_turned, camera
from astray.kernel.thief import HALF, KEY_ASPECT, F

WALL_PLACE, THIEF_PLACE, FIRST_PLACE = range(FLOORS, FLOORS + 3)  # among the pictures
ICON = F(0.03)  # half the width of an icon, before it is turned, of the image's side
ICON_HIGH = ICON / KEY_ASPECT
ICON_DOWN = F(ICON * F(0.75))  # of its centre, from the upper edge
# By action: -arctan2(ay, ax) in eighths of a turn; to the left -4, and without a move 0.
TURNS = np.array([3, -4, -3, 2, 0, -2, 1, 0, -1])


@kernel
def looking(s, side):
    """Return the camera for the whole world, or for the window around the agent."""
    if s.window:
        return camera(side, s.window, F(s.x), F(s.y))
    return camera(side, s.world, F(s.world) * F(0.5), F(s.world) * F(0.5))


@kernel
def visible(s):
    """Return the visible cells, whose first column and row in the world come first, with walls."""
    left, low, columns, rows = np.int64(0), np.int64(0), s.world, s.world
    if s.window:
        x, y, half = F(s.x), F(s.y), F(s.window) / F(2) + F(1)
        left, low = int(x - half), int(y - half)
        columns, rows = int(x + half) - left + 1, int(y + half) - low + 1
    cells = np.full((rows, columns), OPEN)
    for j in range(rows):
        for i in range(columns):
            if is_wall(s, left + i, low + j):
                cells[j, i] = WALL_PLACE
    return left, low, cells


@shared
def background(s, art, scene):
    """Draw the world without the thief twice, above with objects, unless a window moves."""
    if s.window == 0:
        side = scene.shape[1]
        paint_walls(s, art, scene[side:])
        paint_objects(s, art, scene)


@shared
def paint_walls(s, art, image):
    """Draw floor and walls of the whole world or of the window around the thief."""
    pixels, places, rule, _, _ = art
    left, low, cells = visible(s)
    background, seen = (s.background, s.background_offset), looking(s, image.shape[0])
    paint_cells(image, pixels, places, cells, seen, left, low, s.world, background, rule[0])


@shared
def paint_objects(s, art, scene):
    """Copy the scene's lower part to its upper part, and draw the remaining objects there."""
    side = scene.shape[1]
    copy_flat(scene[:side], scene[side:])
    draw_objects(s, art, scene[:side])


@shared
def draw_objects(s, art, image):
    """Draw the remaining objects."""
    pixels, places, _, things, halves = art
    seen = looking(s, image.shape[0])
    for k in range(s.objects):
        if s.gone[k] < 0:
            what = s.what[k]
            rect = around(seen, s.object_x[k], s.object_y[k], halves[what, 0], halves[what, 1])
            blit(image, pixels, places[things[what]], rect, False)


@kernel
def has_one_gone(s):
    """Return whether an object disappeared in the last step."""
    gone = False
    for k in range(s.objects):
        gone = gone or s.gone[k] == s.time
    return gone


@shared
def draw_scene(s, art, scene, image):
    """Draw the scene or its window around the thief, with the thief."""
    pixels, places = art[0], art[1]
    if s.window:
        paint_walls(s, art, image)
        draw_objects(s, art, image)
    else:
        if s.time and has_one_gone(s):
            paint_objects(s, art, scene)
        copy_flat(image, scene[: scene.shape[1]])
    rect = around(looking(s, image.shape[0]), s.x, s.y, HALF, HALF)
    blit_turned(image, pixels, places[THIEF_PLACE], rect, TURNS[s.facing])


@kernel
def icon_right(slot):
    """Return the distance of an icon's centre from the left, as a fraction of the image's side."""
    return F(1 - np.float64(ICON) * (2 * slot + 1.25))


@shared
def draw_icon(s, art, image, what, x, y):
    """Draw the icon of key `what`, turned, centred at the fractions (x, y) of the image's side."""
    unit, view, _, _ = looking(s, image.shape[0])
    rect = (
        np.float64((view * (x - ICON)) * unit),
        # The original adds where it means to subtract: icons hang a little lower.
        np.float64((view * (y + ICON_HIGH)) * unit),
        np.float64(((F(2) * view) * ICON) * unit),
        np.float64(((F(2) * view) * ICON_HIGH) * unit),
    )
    blit_turned(image, art[0], art[1][art[3][what]], rect, 2)
