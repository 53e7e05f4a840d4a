"""Levels of Heist: the original's draws, in its order; and levels drawn in text."""

from typing import Any

import numpy as np

from astray.game import Variant
from astray.games.heist import rules
from astray.games.heist.rules import COLOURS, DOOR_CODE, EMPTY, GEM, KEY, MOST
from astray.kernel import thief
from astray.kernel.grid import STAY
from astray.kernel.jit import shared
from astray.kernel.maze import WALL, beside, dig
from astray.kernel.rng import choose, pick
from astray.kernel.thief import IN_DOOR, F, grid, jittered, settle, start
from astray.record import NEVER, centre, fresh
from astray.validation import one_of

LEGEND = {"#": WALL, ".": EMPTY, "*": GEM}
LEGEND |= {name[0]: KEY + k for k, name in enumerate(COLOURS)}
LEGEND |= {name[0].upper(): DOOR_CODE + k for k, name in enumerate(COLOURS)}
OBJECTS = {"gem": "*"}
OBJECTS |= {f"{name} key": name[0] for name in COLOURS}
OBJECTS |= {f"{name} door": name[0].upper() for name in COLOURS}
STOOD_ON = "*bgr"  # its edge only: the middle is touched from there
MOST_DOORS = len(COLOURS)
LAST, FIRST = 0, 1  # Heist.gem, in the order of its choices
UNSEEN = -1  # a cell that no room has been found to have
TAKEN, SHUT = 254, 255  # the thief's cell; a door whose colour is not yet decided


@shared
def generate(s, p):
    """Fill `s` with a new level of the variant `p`."""
    furnish(s, p)
    larger = start(s, p)
    doors = larger + pick(s, 2) if p.by_size else pick(s, MOST_DOORS + 1)

    inside = dig(s, s.maze_size)
    size = inside.shape[0]
    doors = shut_doors(s, inside, min(doors, MOST_DOORS))
    room = np.full((size, size), UNSEEN)
    agent = place_thief(s, inside)
    room[agent // size, agent % size] = 0
    for stage in range(doors + 1):
        furnish_room(s, inside, room, stage, doors, p.gem == FIRST)
    inside[agent // size, agent % size] = EMPTY

    left, low = settle(s, inside, agent)
    for x in range(size):
        for y in range(size):
            what = inside[y, x]
            if what > WALL:
                put(s, what, left + x, low + y)
                if what < DOOR_CODE or what == GEM:
                    k = s.objects - 1
                    s.object_x[k] = jittered(s, left + x)
                    s.object_y[k] = jittered(s, low + y)
    s.twister, s.twister_at = s.level, s.mt_next  # fewer than its 624 words are drawn so far


@shared
def shut_doors(s, inside, doors):
    """Put up to `doors` doors, still without a colour, on forks; return their number."""
    size, count = inside.shape[0], 0
    forks = np.empty(size * size, np.int64)
    for cell in range(size * size):
        x, y = cell % size, cell // size
        if inside[y, x] == EMPTY and beside(inside, x, y, WALL) <= 1:
            forks[count] = cell
            count += 1
    chosen = choose(s, forks, count, doors)
    for k in range(chosen.size):
        inside[chosen[k] // size, chosen[k] % size] = SHUT
    return chosen.size


@shared
def place_thief(s, inside):
    """Take a free cell that is not next to a door; return its number."""
    size, cells = inside.shape[0], np.flatnonzero(inside == EMPTY)
    while True:  # never for ever: the ends of a maze are not beside its forks
        cell = cells[pick(s, cells.size)]
        if beside(inside, cell % size, cell // size, SHUT) == 0:
            inside[cell // size, cell % size] = TAKEN
            return cell


@shared
def furnish_room(s, inside, room, stage, doors, gem_first):
    """Find the next door and its room, and put its key there; after the last door, the gem.

    Args:
        s: State.
        inside: [size, size], the maze.
        room: [size, size], number of doors to open before each cell, or UNSEEN.
        stage: Number of doors found so far.
        doors: Number of doors.
        gem_first: Whether the gem is in the first room with a free cell, instead of the last room.
    """
    size = inside.shape[0]
    door = explore(inside, room, stage)
    free = np.flatnonzero(inside == EMPTY)
    rooms = room.reshape(-1)[free]
    at_begin = stage == doors and gem_first  # after the last door, all cells are in a room
    free = free[rooms == (rooms.min() if at_begin else stage)]
    cell = free[pick(s, free.size)]
    inside[cell // size, cell % size] = GEM if stage == doors else KEY + stage
    if stage < doors:
        inside[door // size, door % size] = DOOR_CODE + stage
        room[door // size, door % size] = stage


@shared
def explore(inside, room, stage):
    """Give the newly reachable cells the number `stage`; return the nearest shut door's cell.

    Among equally near doors, the original takes the one next to the first cell, row by row.
    """
    size = inside.shape[0]
    steps = np.full(size * size, UNSEEN)
    queue = np.empty(size * size, np.int64)
    known = np.flatnonzero(room != UNSEEN)
    after, first = known.size, 0
    steps[known], queue[:after] = 0, known
    while first < after:
        cell = queue[first]
        first += 1
        for k in range(4):
            x, y = cell % size + (k == 0) - (k == 1), cell // size + (k == 2) - (k == 3)
            inner = 0 <= x < size and 0 <= y < size
            if inner and inside[y, x] == EMPTY and steps[y * size + x] == UNSEEN:
                room[y, x], steps[y * size + x] = stage, steps[cell] + 1
                queue[after] = y * size + x
                after += 1
    door, nearest = NEVER, size * size
    for cell in range(size * size):
        if steps[cell] != UNSEEN and steps[cell] < nearest:
            for k in range(4):  # left, below, above, right
                x, y = cell % size + (k == 3) - (k == 0), cell // size + (k == 2) - (k == 1)
                inner = 0 <= x < size and 0 <= y < size
                if inner and inside[y, x] == SHUT and steps[cell] < nearest:
                    door, nearest = y * size + x, steps[cell]
    return door


@shared
def put(s, what, x, y):
    """Add an object at the centre of cell (x, y)."""
    k = s.objects
    s.objects = k + 1
    s.what[k], s.gone[k] = what, NEVER
    s.object_x[k], s.object_y[k] = F(x) + F(0.5), F(y) + F(0.5)
    if what < DOOR_CODE:
        s.keys |= 1 << (what - KEY)


@shared
def furnish(s, p):
    """Set the fields that are not random."""
    s.world, s.window = p.world, p.window
    s.facing = STAY
    s.gone[:] = NEVER


def describe(s: Any) -> dict[str, Any]:
    """Return the level of state `s` as plain data, with the lowest row of `grid` first.

    The look "hand" lists the colours of the keys in hand.
    """
    hand = [name for k, name in enumerate(COLOURS) if s.hand >> k & 1]
    return {
        "world": int(s.world),
        "maze_size": int(s.maze_size),
        "grid": grid(s).tolist(),
        "legend": {"empty": EMPTY, "wall": WALL} | {n: LEGEND[OBJECTS[n]] for n in OBJECTS},
        "agent": centre(s),
        "looks": thief.looks(s) | {"hand": hand},
    }


def build(cells: np.ndarray, agent: tuple[int, int], looks: Any, variant: Variant) -> Any:
    """Return the state that begins in the level of `cells` [world, world].

    Raises:
        ValueError: If no episode can begin there.
    """
    s, p = fresh(rules)[0], variant.records()[0]
    furnish(s, p)
    thief.begin(s, cells, agent, looks, p, put)
    for name in looks.get("hand", ()):
        one_of("key", name, COLOURS)
        s.hand |= 1 << COLOURS.index(name)
    s.keys |= s.hand
    s.all_keys = 0 if s.hand and s.hand == s.keys else NEVER
    return s


def truths(states: np.ndarray) -> dict[str, np.ndarray]:
    """Return facts about states [N] of every variant."""
    s = states.view(np.recarray)
    there = np.arange(MOST) < s.objects[:, None]
    is_key, is_door = s.what < DOOR_CODE, (s.what >= DOOR_CODE) & (s.what < GEM)
    bit = 1 << (np.maximum(s.what, KEY) - KEY) % len(COLOURS)
    held = s.hand[:, None] & bit != 0
    gone = s.gone != NEVER
    with np.errstate(invalid="ignore"):
        away = [abs(s[f"object_{axis}"] - s[axis][:, None]) for axis in "xy"]
        in_door = (away[0] < IN_DOOR) & (away[1] < IN_DOOR) & is_door & ~held & ~gone
    real = {
        "what": (s.what >= KEY) & (s.what <= GEM),
        "gone": (s.gone >= NEVER) & (s.gone <= s.time[:, None]),
        "keys": ~is_key | (s.keys[:, None] & bit != 0),
        "hand": ~gone | held | (s.what == GEM),
        "place of the thief": ~in_door,
    }
    found = {name: (holds | ~there).all(1) for name, holds in real.items()}
    bits = range(1 << len(COLOURS))
    found["keys"] &= np.isin(s.keys, bits)
    found["hand"] &= np.isin(s.hand, bits) & (s.hand & ~s.keys == 0)
    on_floor = thief.truths(states)
    found["place of the thief"] &= on_floor["place of the thief"]
    return on_floor | found
