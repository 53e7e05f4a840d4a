"""An open room: a mouse and its cheese, which in training always lies in the upper right corner."""

import sys
from dataclasses import dataclass

import numpy as np

from astray.game import OWN, Game, Looks, Shift, Variant
from astray.kernel.jit import kernel, shared
from astray.kernel.rng import below
from astray.record import first, state_dtype

SIDE = 16  # cells
ACTIONS = ("stay", "left", "right", "down", "up")
DX, DY = np.array([0, -1, 1, 0, 0]), np.array([0, 0, 0, -1, 1])
EVENTS = ("reached_cheese", "reached_corner")
STATE = state_dtype(*[(name, np.int64) for name in ("x", "y", "cheese_x", "cheese_y", *EVENTS)])
COLOURS = np.array([[40, 40, 40], [240, 200, 60], [220, 220, 220]], np.uint8)  # floor cheese mouse


@dataclass(frozen=True, kw_only=True)
class Room(Variant):
    corner: bool = True  # the cheese lies in the upper right corner; else anywhere
    time_limit: int = 50  # steps


@kernel
def generate(s, p):
    mouse = below(s, SIDE * SIDE - 1)  # never in the last cell, the upper right corner
    cheese = SIDE * SIDE - 1 if p.corner else (mouse + 1 + below(s, SIDE * SIDE - 1)) % SIDE**2
    s.x, s.y, s.cheese_x, s.cheese_y = mouse % SIDE, mouse // SIDE, cheese % SIDE, cheese // SIDE


@kernel
def step(s, action):
    s.x = min(max(s.x + DX[action], 0), SIDE - 1)
    s.y = min(max(s.y + DY[action], 0), SIDE - 1)
    s.reached_corner = first(s, s.reached_corner, s.x == s.y == SIDE - 1)
    if s.x != s.cheese_x or s.y != s.cheese_y:
        return 0.0, False
    s.reached_cheese = s.time
    return 10.0, True


@shared
def foreground(s, art, scene, image):
    cell = image.shape[0] // SIDE
    for row in range(image.shape[0]):
        for column in range(image.shape[1]):
            x, y = column // cell, SIDE - 1 - row // cell
            is_mouse, is_cheese = x == s.x and y == s.y, x == s.cheese_x and y == s.cheese_y
            for c in range(3):
                image[row, column, c] = COLOURS[2 if is_mouse else 1 if is_cheese else 0, c]


@kernel
def foreground_planes(s, scene, planes):
    planes[:] = 0
    planes[0, s.y, s.x] = planes[1, s.cheese_y, s.cheese_x] = 1


@shared
def nothing(s, art, scene):
    """What does not move is drawn with the rest."""


@kernel
def background_planes(s, scene):
    """Likewise."""


def planes(variant):
    return np.ones((2, SIDE, SIDE), np.uint8)


def planes_scene_shape(variant):
    return (1, 1, 1)


HERE = sys.modules[__name__]
GAME = Game(
    "open-room",
    "a mouse looks for its cheese in an open room",
    rules=HERE,
    levels=HERE,
    looks={OWN: Looks(OWN, nothing, foreground, lambda variant, pixels: (), lambda *_: (1, 1, 3))},
    variants={
        "corner": Room(about="the cheese in the upper right corner"),
        "anywhere": Room(about="the cheese anywhere", corner=False),
    },
    goals={"cheese": "reached_cheese", "corner": "reached_corner"},
    shifts={"corner": Shift("corner", "anywhere", "cheese", ("corner",))},
    symbols=HERE,
)
