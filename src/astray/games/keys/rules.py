"""Keys and Chests: a thief in a maze takes keys and opens chests, one key per chest."""

import numpy as np

from astray.kernel.grid import ACTIONS as ACTIONS
from astray.kernel.jit import kernel
from astray.kernel.rng import below
from astray.kernel.thief import HALF, KEY_WIDE, TIES, F, fields, move, touches
from astray.record import NEVER, first, state_dtype

LARGEST = 23  # cells a side of the largest world
MOST = 36  # objects in a level
EMPTY, KEY, CHEST = 0, 2, 3  # what is in a cell, if not WALL
REWARD = 1.0  # of a chest

REACH = {KEY: (KEY_WIDE, F(0.375 * 13 / 21)), CHEST: (F(0.5), F(0.5))}  # their half-sizes
KEY_X, KEY_Y = HALF + REACH[KEY][0], HALF + REACH[KEY][1]  # centres closer than this touch
CHEST_X, CHEST_Y = HALF + REACH[CHEST][0], HALF + REACH[CHEST][1]

# The inventory's icons in fractions of the picture's side: of slot i the centre is
# FIRST_SLOT + i SLOT from the side, SLOT_DOWN from the top (or bottom).
SLOT, FIRST_SLOT, SLOT_DOWN = 0.06, 0.0375, 0.0597
HALF_ICON = (0.0186, 0.03)  # half its width and height
UPPER_RIGHT, UPPER_LEFT, LOWER_RIGHT, LOWER_LEFT, HIDDEN = range(5)  # `inventory`

EVENTS = (
    "first_key", "all_keys",
    "first_chest", "all_chests",  # all that there are keys for
    "passed_chest",
    "keys_before_last",  # all keys, with a chest left to open
)  # fmt: skip
STATE = state_dtype(
    *fields(LARGEST, MOST),
    ("had", np.int64, (MOST,)),  # of an opened chest: the keys in hand with which it was opened
    ("keys", np.int64), ("chests", np.int64),  # that the level began with
    ("taken", np.int64), ("opened", np.int64),  # how many so far; what is between is in hand
    ("passed", np.int64),  # times that a chest was come upon without a key
    ("touched", np.int64),  # chests touched in the last step, a bit each
    ("at_inventory", np.int64),  # steps that touched an icon of the inventory, hidden or not
    ("inventory", np.int64),  # where it is drawn
    ("key_penalty", np.float64), ("step_penalty", np.float64),  # of the reward
    ("strict", np.bool_),
    ("background", np.int64),
    ("background_offset", np.float64),  # from 0 to 1: which part of the floor is seen
    ("twister", np.int64),  # what it was seeded with, NEVER where keys are not off centre,
    ("twister_at", np.int64),  # and how many draws were made before the first key was put
    events=EVENTS,
)  # fmt: skip


@kernel
def step(s, action):
    """Move the thief, then take and open; return the reward and whether all is open."""
    tie = below(s, TIES)
    move(s, action, tie, 0)
    reward, done = meet(s)
    note_inventory(s)
    return np.float64(reward - F(s.step_penalty)), done


@kernel
def meet(s):
    """Take the keys and open the chests that the thief touches; return reward and end."""
    reward, done, touched = F(0), False, 0
    for k in range(s.objects - 1, -1, -1):  # the original's order: the last made is first
        if s.gone[k] == NEVER:
            if s.what[k] == KEY:
                if touches(s, k, KEY_X, KEY_Y):
                    reward = take(s, k, reward)
            elif touches(s, k, CHEST_X, CHEST_Y):
                if s.taken > s.opened:
                    reward, done = unlock(s, k, reward)
                else:
                    touched |= 1 << k
                    pass_by(s, k)
    s.touched = touched
    return reward, done


@kernel
def take(s, k, reward):
    """Take key `k`; return the updated reward."""
    s.gone[k] = s.time
    s.taken += 1
    s.first_key = first(s, s.first_key)
    if s.taken == s.keys:
        s.all_keys = s.time
        if s.opened < min(s.keys, s.chests):
            s.keys_before_last = s.time
    return reward - F(s.key_penalty)


@kernel
def unlock(s, k, reward):
    """Open chest `k` with a key; return the updated reward and whether it was the last chest."""
    s.gone[k], s.had[k] = s.time, s.taken - s.opened
    s.opened += 1
    s.first_chest = first(s, s.first_chest)
    done = s.opened == min(s.keys, s.chests)  # as many as there are, or as there were keys for
    if done:
        s.all_chests = s.time
    if s.strict:
        return F(REWARD), done  # what was before in this step is forgotten
    return reward + F(REWARD), done


@kernel
def pass_by(s, k):
    """Record that chest `k` is touched without a key."""
    if not (s.touched >> k) & 1:
        s.passed += 1
    s.passed_chest = first(s, s.passed_chest)


@kernel
def note_inventory(s):
    """Count the steps in which the thief touches the icon of a key in hand."""
    hand = s.taken - s.opened
    if hand == 0 or s.window:  # a window moves with the thief
        return
    up, across = np.float64(s.y) / s.world, np.float64(s.x) / s.world
    if s.inventory == UPPER_RIGHT or s.inventory == UPPER_LEFT or s.inventory == HIDDEN:
        up = 1 - up
    if s.inventory == UPPER_RIGHT or s.inventory == LOWER_RIGHT or s.inventory == HIDDEN:
        across = 1 - across
    half = np.float64(HALF) / s.world
    last = FIRST_SLOT + (hand - 1) * SLOT + HALF_ICON[0]
    if abs(up - SLOT_DOWN) < half + HALF_ICON[1] and across - half < last:
        s.at_inventory += 1
