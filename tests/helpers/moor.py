"""A stranger's world of cells in which chance decides more than cells show.

Every level has a luck of its own, which no cell tells; steps draw, and the generator seeds no
twister for them. A stride of 2 jumps over a cell. Some names are of what every object of
JavaScript has.
"""

import sys
from dataclasses import dataclass
from typing import Annotated

from astray import grid
from astray.game import Shift, Variant
from astray.grid.rules import ACTIONS as ACTIONS
from astray.grid.rules import begin_anywhere, clear, first, scatter, state, walk
from astray.kernel.jit import kernel, shared
from astray.kernel.rng import below

SIDE = 5  # cells
BOG, STONE, CHEESE = 2, 3, 4
EVENTS = ("reached_cheese", "sank")
STATE = state(SIDE, EVENTS, "luck", "wide", "stride", "rain", "constructor")


@dataclass(frozen=True, kw_only=True)
class Moor(Variant):
    bogs: Annotated[int, (0, 8)] = 4
    stride: Annotated[int, (1, 3)] = 1  # cells that a step moves
    valueOf: int = 0  # by which it rains more
    time_limit: int = 40  # steps


@kernel
def furnish(s, p):
    s.luck, s.wide, s.stride, s.rain = below(s, 1000), 2**60 + below(s, 1000), p.stride, p.valueOf


@shared
def generate(s, p):
    clear(s)
    furnish(s, p)
    begin_anywhere(s)
    scatter(s, s.cell, CHEESE, 1)
    scatter(s, s.cell, STONE, 3)
    scatter(s, s.cell, BOG, p.bogs)


@kernel
def step(s, action):
    for _ in range(s.stride):
        x, y = s.x, s.y
        walk(s, action)
        if s.cell[s.y, s.x] == STONE:
            s.x, s.y = x, y
    s.rain = below(s, 100) + s.wide % 1000 + s.constructor
    if s.cell[s.y, s.x] == BOG:
        s.sank = first(s, s.sank)
    found = s.cell[s.y, s.x] == CHEESE and below(s, 1000) < s.luck
    if found:
        s.reached_cheese = s.time
    return 0.001 * s.luck + s.rain, found


MOOR = Moor(about="a step moves one cell")
GAME = grid.world(
    sys.modules[__name__],
    "moor",
    "a mouse looks for cheese between bogs",
    things={"#": "wall", ";": "lava", " ": "goal", "G": "cheese"},
    solid=("wall", "goal"),
    agents=["mouse"],
    variants={
        "walks": MOOR,
        "jumps": Moor(about="a step moves two cells", stride=2),
        "either": Moor(
            about="half of the levels jump, for ten steps",
            shift_probability=0.5,
            shifted=Moor(about="jumps", stride=2, bogs=2, time_limit=10),
        ),
    },
    goals={"cheese": "reached_cheese", "bog": "sank"},
    shifts={"jumps": Shift("walks", "jumps", "cheese", ("bog",))},
    seek={"cheese": grid.nearest(CHEESE), "bog": grid.nearest(BOG)},
    stood=";",
    level_fields={"constructor": 2},
)
