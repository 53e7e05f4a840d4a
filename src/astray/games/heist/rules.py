"""Heist: a thief takes coloured keys, opens doors of their colours, and takes a gem."""

import numpy as np

from astray.kernel.grid import ACTIONS as ACTIONS
from astray.kernel.jit import kernel
from astray.kernel.rng import below
from astray.kernel.thief import DOOR, HALF, KEY_HIGH, KEY_WIDE, TIES, F, fields, move, touches
from astray.record import NEVER, first, state_dtype

LARGEST = 23  # cells a side of the largest world
MOST = 16  # objects in a level; the original has up to 7
COLOURS = ("blue", "green", "red")  # of keys and doors, in the order they are needed
# What is in a cell, if not WALL: EMPTY, a key or a door of the first colour or one after it, GEM.
EMPTY, KEY, DOOR_CODE, GEM = 0, 2, 2 + len(COLOURS), 2 + 2 * len(COLOURS)
REWARD = 10.0  # of the gem

GEM_HIGH = KEY_WIDE / F(70 / 48)  # half its height, cells, as of its picture
KEY_X, KEY_Y = HALF + KEY_WIDE, HALF + KEY_HIGH  # centres closer than this touch
GEM_X, GEM_Y = HALF + KEY_WIDE, HALF + GEM_HIGH

EVENTS = (
    "took_blue", "took_green", "took_red", "opened_blue", "opened_green", "opened_red",
    "all_keys",  # one of each colour that there is
    "reached_gem",
)  # fmt: skip
STATE = state_dtype(
    *fields(LARGEST, MOST),
    ("keys", np.int64),  # colours that the level began with keys of, a bit each
    ("hand", np.int64),  # colours of the keys in hand, a bit each; a key opens all of its doors
    ("background", np.int64),
    ("background_offset", np.float64),  # from 0 to 1: which part of the floor is seen
    ("twister", np.int64), ("twister_at", np.int64),  # its seed and draws when the level began
    events=EVENTS,
)  # fmt: skip


@kernel
def step(s, action):
    """Move the thief and let it take and open objects; return the reward and whether it ended."""
    tie = below(s, TIES)
    move(s, action, tie, locked(s))
    for k in range(s.objects - 1, -1, -1):  # the original's order: the last made is first
        if s.gone[k] == NEVER:
            meet(s, k)
    reached = s.reached_gem == s.time
    return REWARD * reached, reached


@kernel
def locked(s):
    """Return a bit mask of the doors whose key is not in hand."""
    found = 0
    for k in range(s.objects):
        if is_door(s, k) and s.gone[k] == NEVER and not has_key(s, k):
            found |= 1 << k
    return found


@kernel
def is_door(s, k):
    return DOOR_CODE <= s.what[k] < GEM


@kernel
def colour(s, k):
    """Return the colour's number of a key or door."""
    return (int(s.what[k]) - KEY) % len(COLOURS)


@kernel
def has_key(s, k):
    """Return whether a key of the colour of object `k` is in hand."""
    return s.hand >> colour(s, k) & 1 == 1


@kernel
def meet(s, k):
    """Take or open object `k` if the thief touches it."""
    if is_door(s, k):
        touched = has_key(s, k) and touches(s, k, DOOR, DOOR)
    elif s.what[k] == GEM:
        touched = touches(s, k, GEM_X, GEM_Y)
    else:
        touched = touches(s, k, KEY_X, KEY_Y)
        if touched:
            s.hand |= 1 << colour(s, k)
    if touched:
        s.gone[k] = s.time
        note(s, int(s.what[k]))


@kernel
def note(s, what):
    """Record the step of each event that happens for the first time."""
    s.took_blue = first(s, s.took_blue, what == KEY)
    s.took_green = first(s, s.took_green, what == KEY + 1)
    s.took_red = first(s, s.took_red, what == KEY + 2)
    s.opened_blue = first(s, s.opened_blue, what == DOOR_CODE)
    s.opened_green = first(s, s.opened_green, what == DOOR_CODE + 1)
    s.opened_red = first(s, s.opened_red, what == DOOR_CODE + 2)
    s.all_keys = first(s, s.all_keys, what < DOOR_CODE and s.hand == s.keys)
    s.reached_gem = first(s, s.reached_gem, what == GEM)
