"""CoinRun: a runner jumps over hazards to a coin, which is worth 10 and ends the level.

Numbers, order of events and 32-bit arithmetic are the original's.
"""

import numpy as np

from astray.kernel.grid import ACTIONS as ACTIONS
from astray.kernel.grid import push
from astray.kernel.jit import kernel, shared
from astray.kernel.rng import below
from astray.record import NEVER, first, state_dtype

WORLD = 64  # cells a side
WALKERS = 48  # at most in a level; the original has up to 35
PUFFS = 9  # of a walker's trail: a puff lasts 9 steps
REWARD = 10.0

# What is in a cell; a wall's top only looks different. Nobody sees barriers: they turn walkers.
EMPTY, WALL, TOP, LAVA, LAVA_TOP, BARRIER, COIN, INVISIBLE, PERMEABLE = range(9)
NOTHING, CRATE, SAW = 0, 1, 2  # what stands there besides

F = np.float32  # of all that meets a coordinate
ZERO, ONE, TWO = F(0), F(1), F(2)
HALF = F(0.5)  # half a side of walkers, saws and crates, and half the runner's width, in cells
TALL = F(0.5787)  # half the runner's height, cells
CORNER = F(0.98)  # of a box: its corners are looked up this much nearer to its centre
NEAR = F(0.001)  # cells; boxes that overlap by less do not touch crates, coins and lava
FOOT = F(0.01)  # cells: how far inside of the box's sides and below it the feet are

GRAVITY = F(0.2)  # cells per step per step
JUMP = F(1.5)  # cells per step; also the fastest fall
FASTEST = F(0.5)  # cells per step, to the sides
MIX_GROUND = F(0.2)  # fraction of the wanted speed in the new one, per step
MIX_AIR = F(0.2) * F(0.15)
STROLL = F(0.15)  # a walker's speed, cells per step
TURN = F(0.01)  # below this speed, in cells per step, the runner looks as if it stood
TIES = 1_000_000  # the original's draw each step, of which parity alone matters

EVENTS = (
    "took_coin", "took_invisible", "passed_coin", "reached_end", "touched_wall", "passed_wall",
    "died", "met_saw", "met_walker", "met_lava", "timed_out",
)  # fmt: skip
STATE = state_dtype(
    ("cell", np.uint8, (WORLD, WORLD)),  # at [y, x]
    ("thing", np.uint8, (WORLD, WORLD)),  # crates and saws
    # the look of the walker that begins there, or of the crate, and 4 (1 + that of one beneath it)
    ("detail", np.uint8, (WORLD, WORLD)),
    ("x", np.float32), ("y", np.float32),  # the runner's centre, in cells
    ("vx", np.float32), ("vy", np.float32),  # cells per step
    ("on_crate", np.bool_),  # a crate stopped its fall in this step
    ("faces_left", np.bool_), ("pose", np.int64),  # STAND, or one of two of a walk
    ("walkers", np.int64),  # how many; of the arrays after it only so many count
    ("walker_x", np.float32, (WALKERS,)), ("walker_y", np.float32, (WALKERS,)),
    ("walker_vx", np.float32, (WALKERS,)),
    ("walker_look", np.uint8, (WALKERS,)),
    ("trail_x", np.float32, (WALKERS, PUFFS)),  # where it was, the last step's end first
    ("end_x", np.int64), ("end_y", np.int64),  # the cell before the end wall
    ("coin_x", np.int64), ("coin_y", np.int64),  # its cell, the rightmost; NEVER without one
    ("permeable", np.int64),  # columns of the end wall that do not stop the runner
    ("continues", np.bool_),  # after the coin
    ("runner_look", np.int64), ("ground", np.int64), ("background", np.int64),
    ("background_offset", np.float64),  # from 0 to 1: which part of it is seen
    events=EVENTS,
)  # fmt: skip
STAND, WALK = 0, 1


@kernel
def step(s, action):
    """Move walkers and runner; return the reward and whether the episode is over."""
    horizontal_first = below(s, TIES) % 2 == 0
    reward, ended = act(s, action, horizontal_first)
    leave_trails(s)
    return reward, ended


@shared
def act(s, action, horizontal_first):
    """Take a step without its draw and trails: all move, then the runner meets what it overlaps."""
    ax, ay = push(action)
    supported = is_supported(s)
    if ay == 1 and not supported:
        ay = 0
    accelerate(s, ax, ay, supported)
    stroll(s, s.vy < ZERO and ay >= 0)
    move(s, ax, ay, horizontal_first)
    stay_inside(s)
    pose(s, ax, supported)
    return meet(s)


@kernel
def stay_inside(s):
    """Keep the runner in the world, which it could leave only if an edit put it into a wall."""
    s.x = min(max(s.x, HALF), WORLD - HALF)
    s.y = min(max(s.y, TALL), WORLD - TALL)


@kernel
def stops(cell):
    """Return whether the runner cannot enter a cell."""
    return WALL <= cell <= TOP  # `in` a tuple is not compiled to as little


@kernel
def is_lava(cell):
    """Return whether a cell burns the runner."""
    return LAVA <= cell <= LAVA_TOP


@kernel
def is_solid(s, x, y):
    """Return whether the point (x, y) stops the runner, as everything outside of the world does."""
    i, j = int(np.floor(x)), int(np.floor(y))
    return not (0 <= i < WORLD and 0 <= j < WORLD) or stops(s.cell[j, i])


@kernel
def turned_by(s, x, y):
    """Return what turns a walker at (x, y): WALL (also outside), TOP, BARRIER; or EMPTY."""
    i, j = int(np.floor(x)), int(np.floor(y))
    if not (0 <= i < WORLD and 0 <= j < WORLD):
        return WALL
    cell = s.cell[j, i]
    return cell if stops(cell) or cell == BARRIER else EMPTY


@shared
def stroll(s, crates_stop):
    """Move every walker on to a wall or a barrier, where it turns.

    WALL also stops it for that part of the step, at the cost of a quarter of its speed.

    Args:
        crates_stop: Whether the runner falls and would land on crates. A walker that WALL stops
            inside a crate below the runner then stays there for the rest of its step.
    """
    reach = HALF * CORNER
    quarter = F(0.25)
    for k in range(s.walkers):
        y, free = s.walker_y[k], 0
        for _ in range(4):  # parts of a step
            vx = s.walker_vx[k]
            x = s.walker_x[k] + vx * quarter
            one, two = turned_by(s, x - reach, y - reach), turned_by(s, x - reach, y + reach)
            three, four = turned_by(s, x + reach, y - reach), turned_by(s, x + reach, y + reach)
            if one or two or three or four:
                edge = np.floor(x + HALF) - HALF if vx > ZERO else np.ceil(x - HALF) + HALF
                x = TWO * edge - x
                s.walker_vx[k] = -vx
            # No walker of the original gets to the world's ends; one that was set into a wall may.
            s.walker_x[k] = min(max(x, HALF), WORLD - HALF)
            if one == WALL or two == WALL or three == WALL or four == WALL:
                if crates_stop and is_in_crate(s, s.walker_x[k], y):
                    break
            else:
                free += 1
        s.walker_vx[k] = s.walker_vx[k] * (F(free) * quarter)


@shared
def leave_trails(s):
    """Record the walkers' places now and at the ends of the previous steps."""
    for k in range(s.walkers):
        for age in range(PUFFS - 1, 0, -1):
            s.trail_x[k, age] = s.trail_x[k, age - 1]
        s.trail_x[k, 0] = s.walker_x[k]


@kernel
def is_in_crate(s, x, y):
    """Return whether a walker at (x, y) overlaps a crate that was below the runner before."""
    i, j = int(np.floor(x - HALF)), int(np.floor(y - HALF))
    for row in range(max(j, 0), min(j + 2, WORLD)):
        for column in range(max(i, 0), min(i + 2, WORLD)):
            away_x, away_y = abs(x - (F(column) + HALF)), abs(y - (F(row) + HALF))
            if (
                s.thing[row, column] == CRATE
                and away_x < HALF + HALF - NEAR
                and away_y < HALF + HALF - NEAR
                and s.y >= F(row) + HALF + HALF + TALL
            ):
                return True
    return False


@kernel
def is_supported(s):
    """Return whether the runner stands: it neither rises nor falls, and a foot is on something."""
    foot = HALF - FOOT
    below_feet = s.y - (TALL + FOOT)
    return s.vy == ZERO and (
        s.on_crate or is_solid(s, s.x - foot, below_feet) or is_solid(s, s.x + foot, below_feet)
    )


@kernel
def accelerate(s, ax, ay, supported):
    """Set the runner's speed for the action (ax, ay)."""
    mix = MIX_GROUND if supported else MIX_AIR
    vx = (ONE - mix) * s.vx + mix * FASTEST * F(ax)
    s.vx = ZERO if abs(vx) < mix * FASTEST else vx
    if ay == 1:
        s.vy = JUMP
    else:
        vy = s.vy
        if supported:
            vy = vy + GRAVITY * F(ay)
        vy = vy - GRAVITY
        s.vy = min(max(vy, -JUMP), JUMP)


@shared
def move(s, ax, ay, horizontal_first):
    """Move the runner by its speed, in parts, and slow it at obstacles."""
    fast, falls = abs(s.vx), abs(s.vy)
    if fast != falls:
        horizontal_first = fast > falls
    if ax != 0:
        horizontal_first = True
    if ay != 0:
        horizontal_first = False
    parts = max(4, int(F(4) * np.sqrt(s.vx * s.vx + s.vy * s.vy)))
    part = ONE / F(parts)
    crates_stop = ay >= 0
    last_y = s.y
    s.on_crate = False
    free_x, free_y = 0, 0
    for _ in range(parts):
        blocked_x, blocked_y = False, False
        for turn in range(2):
            sideways = (turn == 0) == horizontal_first
            dx = s.vx * part if sideways else ZERO
            dy = ZERO if sideways else s.vy * part
            blocked = shove(s, dx, dy, crates_stop, last_y)
            blocked_x |= blocked and sideways
            blocked_y |= blocked and not sideways
        free_x += not blocked_x
        free_y += not blocked_y
        if blocked_x and blocked_y:
            break
    s.vx = s.vx * (F(free_x) * part)
    s.vy = s.vy * (F(free_y) * part)


@kernel
def shove(s, dx, dy, crates_stop, last_y):
    """Move the runner by (dx, dy), one of which is 0; return whether an obstacle was met."""
    blocked = slide(s, dx, dy)
    # What moves by nothing counts as moving vertically, and crates stop that alone.
    if dx == ZERO and crates_stop and s.vy < ZERO:
        i, j = int(np.floor(s.x - HALF)), int(np.floor(s.y - TALL))
        for y in range(max(j, 0), min(j + 3, WORLD)):
            for x in range(max(i, 0), min(i + 2, WORLD)):
                if s.thing[y, x] == CRATE and lands(s, F(x) + HALF, F(y) + HALF, last_y):
                    s.on_crate = True
                    slide(s, ZERO, F(y) + HALF + (TALL + HALF) - s.y)
                    s.vy = ZERO
                    return True
    return blocked


@kernel
def lands(s, x, y, last_y):
    """Return whether the runner came onto the crate at (x, y) from above in this step."""
    return (
        abs(s.x - x) < HALF + HALF - NEAR
        and abs(s.y - y) < TALL + HALF - NEAR
        and last_y >= y + HALF + TALL
    )


@shared
def slide(s, dx, dy):
    """Move the runner by (dx, dy) but not into walls; return whether a wall was met.

    Only four corners are checked, so obstacles thinner than the runner is tall can slip between.
    """
    x, y = s.x + dx, s.y + dy
    across, along = HALF * CORNER, TALL * CORNER
    low, high = y - along, y + along
    left = is_solid(s, x - across, low) or is_solid(s, x - across, high)
    blocked = left or is_solid(s, x + across, low) or is_solid(s, x + across, high)
    if blocked and dx != ZERO:
        x = np.floor(x + HALF) - HALF if dx > ZERO else np.ceil(x - HALF) + HALF
    elif blocked:
        y = np.floor(y + TALL) - TALL if dy > ZERO else np.ceil(y - TALL) + TALL
    s.x, s.y = x, y
    return blocked


@kernel
def pose(s, ax, supported):
    """Set the runner's appearance after a step: its direction, and whether it walks."""
    if ax != 0:
        s.faces_left = ax < 0
    if abs(s.vx) < TURN and ax == 0 and supported:
        s.pose = STAND
    else:
        s.pose = WALK if s.time // 5 % 2 == 0 or not supported else WALK + 1


@kernel
def meet(s):
    """Apply everything that the runner overlaps; return the reward and whether the episode ends."""
    saw, walker = meets_saw(s), meets_walker(s)
    ended, lava, reward = saw or walker, False, 0.0
    left, right = int(np.floor(s.x - HALF + NEAR)), int(np.floor(s.x + HALF - NEAR))
    low, high = int(np.floor(s.y - TALL + NEAR)), int(np.floor(s.y + TALL - NEAR))
    for x in range(max(left, 0), min(right, WORLD - 1) + 1):
        for y in range(max(low, 0), min(high, WORLD - 1) + 1):
            cell = s.cell[y, x]
            if cell == COIN:
                reward += REWARD
                s.took_coin = first(s, s.took_coin)
                ended = not s.continues
                if s.continues:  # the original goes on whatever happened before
                    saw, walker, lava = False, False, False
            elif cell == INVISIBLE:
                s.took_invisible = first(s, s.took_invisible)
            elif is_lava(cell):
                lava, ended = True, True
    note_death(s, saw, walker, lava)
    note_places(s)
    if not ended and s.time >= s.time_limit:
        s.timed_out = s.time
    return reward, ended


@kernel
def meets_saw(s):
    """Return whether the runner overlaps a saw."""
    left, low = int(np.floor(s.x - HALF)), int(np.floor(s.y - TALL))
    for y in range(max(low, 0), min(low + 3, WORLD)):
        for x in range(max(left, 0), min(left + 2, WORLD)):
            if s.thing[y, x] == SAW and overlaps(s, F(x) + HALF, F(y) + HALF):
                return True
    return False


@kernel
def meets_walker(s):
    """Return whether the runner overlaps a walker."""
    met = False
    for k in range(s.walkers):
        met = met or overlaps(s, s.walker_x[k], s.walker_y[k])
    return met


@kernel
def overlaps(s, x, y):
    """Return whether the runner overlaps a box of one cell centred at (x, y)."""
    return abs(s.x - x) < HALF + HALF and abs(s.y - y) < TALL + HALF


@kernel
def note_death(s, saw, walker, lava):
    """Record the step of a death and its cause."""
    if saw or walker or lava:
        s.died = s.time
    if saw:
        s.met_saw = s.time
    if walker:
        s.met_walker = s.time
    if lava:
        s.met_lava = s.time


@kernel
def note_places(s):
    """Record the step at which the runner first gets to a place.

    The end is the cell before the end wall, where the coin of `coin-end` is, and everything
    beyond. A coin or a wall is passed when all of the runner is to its right.
    """
    left, right = s.x - HALF, s.x + HALF
    wall = F(s.end_x) + ONE
    beside = s.y + TALL - NEAR >= F(s.end_y) and s.y - TALL + NEAR < F(s.end_y) + ONE
    at_end = (right - NEAR >= F(s.end_x) and beside) or left >= wall
    is_beyond = s.permeable > 0 and left >= wall + F(s.permeable)
    s.reached_end = first(s, s.reached_end, at_end)
    s.touched_wall = first(s, s.touched_wall, right >= wall)
    s.passed_wall = first(s, s.passed_wall, is_beyond)
    is_right = s.coin_x != NEVER and left >= F(s.coin_x) + ONE
    s.passed_coin = first(s, s.passed_coin, is_right)
