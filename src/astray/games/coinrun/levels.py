"""Levels of CoinRun, with the original's random draws in its order."""

import numpy as np

from astray.games.coinrun.reach import pick_place
from astray.games.coinrun.rules import (
    BARRIER,
    COIN,
    CRATE,
    EMPTY,
    HALF,
    INVISIBLE,
    LAVA,
    LAVA_TOP,
    PERMEABLE,
    SAW,
    STROLL,
    TALL,
    TOP,
    WALL,
    WORLD,
    F,
    stops,
)
from astray.kernel.jit import kernel, shared
from astray.kernel.rng import draw_u32, fraction, unit
from astray.record import NEVER

RUNNERS, GROUNDS, BACKGROUNDS, CRATES, LOOKS = 5, 6, 62, 4, 9  # how many looks there are
DETAILS = CRATES * (CRATES + 1)  # of cells: looks of walkers, or of one or two crates
ONE_COIN, TWO_COINS = 0, 1  # CoinRun.coins, in the order of its choices
ANYWHERE = 1  # CoinRun.place
COINRUN, PROCGEN = 0, 2  # CoinRun.numbering
BEGIN = 5  # column of the first section
HIGH, LOW = 20, 5  # surfaces from here up only go down, below here only up, in cells
PERCENT = 0xC0117  # salt of the hash that refines the original's draw of a whole percent


@shared
def word(s):
    """Draw the original's next 32 random bits; one function, as literals compile separately."""
    return np.int64(draw_u32(s))


@shared
def generate(s, p):
    """Fill `s` with a new level of the variant `p`."""
    offset, background = unit(s), word(s) % BACKGROUNDS
    unit(s)
    unit(s)  # the original draws a place to start and does not use it
    runner, ground = 0, 0
    if not p.easy:
        runner, ground = word(s) % RUNNERS, word(s) % GROUNDS
    percent = 0
    if p.numbering == COINRUN:
        percent = word(s) % 100
    random = percent + fraction(s.level, PERCENT) < 100 * p.random_coin
    clear(s)
    s.background_offset, s.background = offset, 0 if p.easy else background
    s.runner_look, s.ground = runner, ground
    s.continues = p.continues
    in_pit = np.zeros(WORLD, np.bool_)
    random_x, random_y = build_sections(s, p, in_pit)
    finish(s, p.permeable)
    if p.place == ANYWHERE:
        x, y = pick_place(s, in_pit)
        if x != NEVER:
            random_x, random_y = x, y
    put_coins(s, p, random, random_x, random_y)


@shared
def clear(s):
    """Make an empty closed world with the runner in its lower left corner."""
    s.cell[0] = TOP
    s.cell[:, 0], s.cell[:, WORLD - 1], s.cell[WORLD - 1] = WALL, WALL, WALL
    s.x, s.y = F(1) + HALF, F(1) + TALL
    s.coin_x, s.coin_y = NEVER, NEVER


@shared
def build_sections(s, p, in_pit):
    """Build the ground up to the end, mark pits; return the original's random coin cell."""
    difficulty = 1 + word(s) % 3
    if p.difficulty:
        difficulty = p.difficulty
    sections = difficulty + word(s) % difficulty
    if p.sections:
        sections = p.sections
    danger = word(s) % 3
    # The released game has no random place, and so no draw of its section.
    with_coin = NEVER if p.numbering == PROCGEN else word(s) % sections
    x, y = np.int64(BEGIN), np.int64(1)  # as literals, all they go to is compiled twice
    random_x, random_y = NEVER, NEVER
    for section in range(sections):
        height = 1 + word(s) % 4 + (difficulty == 3)
        if y >= HIGH or (y >= LOW and word(s) % 2 == 1):
            height = -height
        width = 3 + word(s) % (2 * difficulty) + (difficulty == 3)
        y = max(1, y + height)
        if section == with_coin:
            random_x, random_y = x, y
        if width > 7 and y > 3 and word(s) % 20 >= difficulty:
            build_pit(s, p, x, y, width, danger, in_pit)
        else:
            build_flat(s, p, x, y, width, difficulty)
        if not stops(s.cell[y, x - 1]):
            s.cell[y, x - 1] = BARRIER
        x += width
        s.cell[y, x] = BARRIER
    s.end_x, s.end_y = x, y
    return random_x, random_y


@kernel
def fill_ground(s, x, y, width):
    """Fill solid ground with its surface at height `y`."""
    s.cell[: y - 1, x : x + width] = WALL
    s.cell[y - 1, x : x + width] = TOP


@shared
def put_walker(s, p, x, y):
    """Draw a walker's random numbers; add it only in variants with hazards."""
    left, look = word(s) % 2 == 0, word(s) % LOOKS
    if p.hazards:
        add_walker(s, x, y, left, look)


@kernel
def add_walker(s, x, y, left, look):
    """Add a walker in the middle of cell (x, y)."""
    k = s.walkers
    s.walker_x[k], s.walker_y[k] = F(x) + HALF, F(y) + HALF
    s.walker_vx[k] = -STROLL if left else STROLL
    s.walker_look[k] = look
    s.trail_x[k] = s.walker_x[k]
    s.detail[y, x] = look
    s.walkers = k + 1


@shared
def build_pit(s, p, x, y, width, danger, in_pit):
    """Build two banks, a pit of lava, saws or walkers between, and a platform if it is wide."""
    left, right = 1 + word(s) % 3, 1 + word(s) % 3
    wide = width - left - right
    deep = 1 + word(s) % (y - 3)
    if not p.hazards:
        fill_ground(s, x, y, width)
    else:
        fill_ground(s, x, y, left)
        fill_ground(s, x + left + wide, y, right)
        in_pit[x + left : x + left + wide] = True
    x += left
    if danger == 0 and p.hazards:
        s.cell[1:deep, x : x + wide] = LAVA
        s.cell[deep, x : x + wide] = LAVA_TOP
    elif danger == 1 and p.hazards:
        s.thing[1, x : x + wide] = SAW
    elif danger == 2:
        for k in range(wide):
            put_walker(s, p, x + k, np.int64(1))
    if wide > 4:
        gap = 1 + (wide > 5) + word(s) % 2
        platform = wide - gap - (2 + word(s) % 2) if wide == 7 else 1 + word(s) % 2
        s.cell[y - 1, x + gap : x + gap + platform] = TOP


@shared
def build_flat(s, p, x, y, width, difficulty):
    """Build solid ground with at most a saw, a walker and two piles of crates."""
    fill_ground(s, x, y, width)
    saw_x, walker_x = NEVER, NEVER
    if word(s) % 10 < 2 * difficulty and width > 3:
        saw_x = x + 1 + word(s) % (width - 2)
        if p.hazards:
            s.thing[y, saw_x] = SAW
    if word(s) % 10 < difficulty and width > 3 and not p.easy:
        walker_x = x + 1 + word(s) % (width - 2)
        put_walker(s, p, walker_x, y)
    for _ in range(2):
        pile_x = x + 1 + word(s) % (width - 2)
        if word(s) % 2 == 1 and pile_x != saw_x and pile_x != walker_x:
            for k in range(1 + word(s) % 3):
                add_crate(s, pile_x, y + k, word(s) % CRATES)


@kernel
def add_crate(s, x, y, look):
    """Add a crate in cell (x, y); an earlier one stays visible at its corners."""
    before = s.detail[y, x] % CRATES + 1 if s.thing[y, x] == CRATE else 0
    s.thing[y, x], s.detail[y, x] = CRATE, look + CRATES * before


@kernel
def finish(s, permeable):
    """Build the ground at the end and the end wall."""
    x, y = s.end_x, s.end_y
    s.cell[y, x] = EMPTY
    fill_ground(s, x, y, 1)
    s.permeable = min(permeable, WORLD - 1 - x)
    after = x + 1 + s.permeable if permeable else WORLD
    s.cell[:, x + 1 : after] = PERMEABLE if permeable else WALL


@kernel
def put_coins(s, p, random, random_x, random_y):
    """Put a coin at the end, at the random place, or both; the others are invisible."""
    if p.coins == TWO_COINS:
        at_end, at_random = True, True
    elif p.coins == ONE_COIN:
        at_end, at_random = not random, random
    else:
        at_end, at_random = False, False
    if random_x != NEVER:
        s.cell[random_y, random_x] = COIN if at_random else INVISIBLE
    s.cell[s.end_y, s.end_x] = COIN if at_end else INVISIBLE
    if at_end:
        s.coin_x, s.coin_y = s.end_x, s.end_y
    elif at_random:
        s.coin_x, s.coin_y = random_x, random_y
