"""Levels of CoinRun as data: described, checked, and built from cells and looks."""

from typing import Any

import numpy as np

from astray.game import Variant
from astray.games.coinrun import rules
from astray.games.coinrun.levels import (
    BACKGROUNDS,
    DETAILS,
    GROUNDS,
    LOOKS,
    RUNNERS,
    add_walker,
    clear,
)
from astray.games.coinrun.rules import (
    BARRIER,
    COIN,
    CRATE,
    EMPTY,
    HALF,
    INVISIBLE,
    LAVA,
    LAVA_TOP,
    NOTHING,
    PERMEABLE,
    SAW,
    TALL,
    TOP,
    WALKERS,
    WALL,
    WORLD,
    F,
)
from astray.record import NEVER, centre, fresh, within

# A cell holds one thing, which stands in an empty cell of the state's.
CRATE_HERE, SAW_HERE, WALKER_LEFT, WALKER_RIGHT, SAW_AND_LEFT, SAW_AND_RIGHT = range(9, 15)
LEGEND = {
    ".": EMPTY, "#": WALL, "=": TOP, "w": LAVA, "~": LAVA_TOP, ":": BARRIER, "o": COIN,
    "i": INVISIBLE, "%": PERMEABLE, "c": CRATE_HERE, "x": SAW_HERE, "<": WALKER_LEFT,
    ">": WALKER_RIGHT, "(": SAW_AND_LEFT, ")": SAW_AND_RIGHT,
}  # fmt: skip
OBJECTS = {
    "coin": "o", "invisible coin": "i", "crate": "c", "saw": "x", "walker to the left": "<",
    "walker to the right": ">",
}  # fmt: skip
STOOD_ON = ":oi%c"


def grid(s: Any) -> np.ndarray:
    """Return the contents of every cell, [WORLD, WORLD] uint8, with crates, saws and walkers."""
    return _drawn(s)[0]


def _drawn(s: Any) -> tuple[np.ndarray, np.ndarray, list[list[int]]]:
    """Return the contents of the cells of `s`, their looks, and the walkers that share a cell.

    These, [x, y, whether it faces left, look] each, moved in the episode to a cell with another
    object.
    """
    cells, details, sharing = s.cell.copy(), s.detail.copy(), []
    cells[s.thing == CRATE] = CRATE_HERE
    cells[s.thing == SAW] = SAW_HERE
    for k in range(s.walkers):
        x, y, left = int(s.walker_x[k]), int(s.walker_y[k]), bool(s.walker_vx[k] < 0)
        if cells[y, x] in (EMPTY, SAW_HERE):
            cells[y, x] = (WALKER_LEFT if cells[y, x] == EMPTY else SAW_AND_LEFT) + (not left)
            details[y, x] = s.walker_look[k]
        else:
            sharing.append([x, y, int(left), int(s.walker_look[k])])
    return cells, details, sharing


def describe(s: Any) -> dict[str, Any]:
    """Return the level of state `s`, lowest row first; raise ValueError if things share a cell."""
    if len(shared := np.argwhere((s.thing != NOTHING) & (s.cell != EMPTY))):
        y, x = shared[0].tolist()
        raise ValueError(f"cell {x, y} holds several things; a level has one in each")
    cells, details, sharing = _drawn(s)
    return {
        "world": WORLD,
        "grid": cells.tolist(),
        "legend": {
            "empty": EMPTY, "wall": WALL, "top of a wall": TOP, "lava": LAVA,
            "top of lava": LAVA_TOP, "barrier": BARRIER, "coin": COIN, "invisible coin": INVISIBLE,
            "permeable wall": PERMEABLE, "crate": CRATE_HERE, "saw": SAW_HERE,
            "walker to the left": WALKER_LEFT, "walker to the right": WALKER_RIGHT,
            "saw and walker to the left": SAW_AND_LEFT,
            "saw and walker to the right": SAW_AND_RIGHT,
        },
        "agent": centre(s),
        "coins": [[int(x), int(y)] for y, x in np.argwhere(s.cell == COIN)],
        "looks": {
            "runner": int(s.runner_look),
            "ground": int(s.ground),
            "background": int(s.background),
            "background_offset": float(s.background_offset),
            # [x, y, which] of crates and walkers; of two crates which + 4 (1 + the lower's)
            "details": [[int(x), int(y), int(details[y, x])] for y, x in np.argwhere(details)],
            "end": [int(s.end_x), int(s.end_y)],
            "permeable": int(s.permeable),
        } | ({"walkers": sharing} if sharing else {}),
    }  # fmt: skip


def truths(states: np.ndarray) -> dict[str, np.ndarray]:
    """Return facts about states [N] of every variant that compiled code relies on."""
    s = states.view(np.recarray)
    return {
        "cell": (s.cell <= PERMEABLE).all((1, 2)),
        "thing": (s.thing <= SAW).all((1, 2)),
        "detail": (s.detail < DETAILS).all((1, 2)),
        **{name: (s[name] > 0) & (s[name] < WORLD) for name in ("x", "y")},
        "vx": abs(s.vx) <= 2,
        "vy": abs(s.vy) <= 2,
        "pose": within(s.pose, 0, 3),
        "walkers": within(s.walkers, 0, WALKERS + 1),
        "walker_x": ((s.walker_x >= 0) & (s.walker_x < WORLD)).all(1),
        "walker_y": ((s.walker_y >= 0) & (s.walker_y < WORLD)).all(1),
        "walker_vx": (abs(s.walker_vx) <= 2).all(1),
        "walker_look": (s.walker_look < LOOKS).all(1),
        "trail_x": ((s.trail_x >= 0) & (s.trail_x < WORLD)).all((1, 2)),
        **{name: within(s[name], 0, WORLD) for name in ("end_x", "end_y", "permeable")},
        **{name: within(s[name], NEVER, WORLD) for name in ("coin_x", "coin_y")},
        "runner_look": within(s.runner_look, 0, RUNNERS),
        "ground": within(s.ground, 0, GROUNDS),
        "background": within(s.background, 0, BACKGROUNDS),
        "background_offset": (s.background_offset >= 0) & (s.background_offset <= 1),
    }


def build(cells: np.ndarray, agent: tuple[int, int], looks: Any, variant: Variant) -> Any:
    """Return the state that begins in the level `cells` [H, W]; smaller ones are in the lower left.

    There is wall around a smaller level. Without an end in `looks` it ends as in `_guess_end`.

    Raises:
        ValueError: If no episode can begin there.
    """
    height, width = cells.shape
    if height > WORLD or width > WORLD:
        raise ValueError(f"the level is {width} x {height} cells; it is at most {WORLD} a side")
    s, drawn = fresh(rules)[0], np.full((WORLD, WORLD), WALL)
    clear(s)
    drawn[:height, :width] = cells
    s.time_limit, s.continues = variant.time_limit, variant.records()[0].continues
    s.cell[:] = np.where(drawn < CRATE_HERE, drawn, EMPTY)
    s.thing[:] = np.select(
        [drawn == CRATE_HERE, (drawn == SAW_HERE) | (drawn >= SAW_AND_LEFT)], [CRATE, SAW], NOTHING
    )
    s.x, s.y = F(agent[0]) + HALF, F(agent[1]) + TALL
    s.runner_look, s.ground = looks.get("runner", 0), looks.get("ground", 0)
    s.background = looks.get("background", 0)
    s.background_offset = looks.get("background_offset", 0.0)
    details = np.zeros((WORLD, WORLD), int)
    for x, y, which in looks.get("details", []):
        if not (0 <= x < WORLD and 0 <= y < WORLD and 0 <= which < DETAILS):
            raise ValueError(f"looks: details [{x}, {y}, {which}] are of no cell or no look")
        details[y, x] = which
    _add_walkers(s, drawn, details, looks.get("walkers", []))
    s.detail[:] = details
    s.end_x, s.end_y = looks.get("end", _guess_end(s.cell))
    s.permeable = looks.get("permeable", int((s.cell[s.end_y] == PERMEABLE).sum()))
    coins = np.argwhere(s.cell == COIN)
    if len(coins):
        s.coin_y, s.coin_x = coins[coins[:, 1].argmax()]
    return s


def _add_walkers(s: Any, drawn: np.ndarray, details: np.ndarray, sharing: Any) -> None:
    """Add the walkers of a drawn level in the original's order, then the `sharing` ones."""
    found = [
        (int(x), int(y), drawn[y, x] in (WALKER_LEFT, SAW_AND_LEFT), details[y, x])
        for x, y in np.argwhere(drawn.T >= WALKER_LEFT)
    ]
    for x, y, left, look in sharing:
        if not (0 <= x < WORLD and 0 <= y < WORLD and 0 <= look < LOOKS):
            raise ValueError(f"looks: walkers [{x}, {y}, {left}, {look}] are in no cell or no look")
        found.append((x, y, left, look))
    if len(found) > WALKERS:
        raise ValueError(f"a level has at most {WALKERS} walkers; this has {len(found)}")
    for walker in found:
        add_walker(s, *walker)


def _guess_end(cell: np.ndarray) -> tuple[int, int]:
    """Return the lowest cell to stand in, in the last such column or before a permeable wall."""
    free = ~np.isin(cell, (WALL, TOP, PERMEABLE))
    free[:, (cell == PERMEABLE).any(0).cumsum() > 0] = False
    stand = free[1:] & ~free[:-1] & (cell[:-1] != PERMEABLE)
    x = int(np.flatnonzero(stand.any(0)).max(initial=0))
    return x, int(stand[:, x].argmax()) + 1 if stand.any() else 0
