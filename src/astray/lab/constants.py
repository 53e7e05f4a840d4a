"""Constants shared with the page's rules, as a generated JavaScript module."""

import json
from types import ModuleType
from typing import Any

import numpy as np

from astray import record
from astray.art import own
from astray.games.coinrun import cells as coinrun_cells
from astray.games.coinrun import draw as coinrun_draw
from astray.games.coinrun import rules as coinrun_rules
from astray.games.heist import draw as heist_draw
from astray.games.heist import levels as heist_levels
from astray.games.heist import rules as heist_rules
from astray.games.keys import draw as keys_draw
from astray.games.keys import levels as keys_levels
from astray.games.keys import rules as keys_rules
from astray.games.keys import variants as keys_variants
from astray.games.maze import levels as maze_levels
from astray.games.maze import rules as maze_rules
from astray.games.maze import variants as maze_variants
from astray.grid import abilities
from astray.kernel import grid, maze, rng, thief
from astray.lab import goals
from astray.training import ppo

EXACT = 2**53  # up to which JavaScript keeps every integer
PATH = "rules/constants.js"  # from the page
# By the name that JavaScript imports: modules, and the names in them.
TABLES: dict[str, tuple[tuple[ModuleType, str], ...]] = {
    "common": ((grid, "ACTIONS MOVES STAY"), (maze, "WALL"), (record, "NEVER"), (own, "COLOURS")),
    "levels": ((record, "MOST"),),
    "twister": ((rng, "WORDS MIDDLE SEED_FACTOR TWIST HIGH_BIT LOW_31 TEMPER_B TEMPER_C"),),
    "noises": ((rng, "GAMMA MIX_1 MIX_2 TO_UNIT"), (ppo, "BELOW_ONE")),
    "grid": ((abilities, "OVER"),),
    "rewards": ((ppo, "CLIP"),),
    "goals": ((goals, "TOGETHER NEITHER OTHER BETA"),),
    "maze": (
        (maze_rules, "EMPTY GOAL OTHER BOTH"),
        (maze_variants, "SHAPES OTHERS COLOURS WALLS"),
        (maze_levels, "LEGEND STOOD_ON"),
    ),
    "keys": (
        (keys_rules, "KEY CHEST MOST"),
        (keys_draw, "PLANES"),
        (keys_variants, "INVENTORIES"),
        (keys_levels, "LEGEND STOOD_ON"),
    ),
    "thief": ((thief, "HALF JITTER"),),
    "heist": (
        (heist_rules, "COLOURS MOST KEY DOOR_CODE GEM"),
        (heist_draw, "PLANES"),
        (heist_levels, "LEGEND STOOD_ON OBJECTS"),
    ),
    "coinrun": (
        (coinrun_rules, "WORLD PUFFS EMPTY WALL TOP LAVA LAVA_TOP COIN INVISIBLE PERMEABLE"),
        (coinrun_rules, "NOTHING CRATE SAW HALF TALL STROLL WALKERS EVENTS STAND"),
        (coinrun_cells, "CRATE_HERE SAW_HERE WALKER_LEFT SAW_AND_LEFT LEGEND STOOD_ON"),
        (coinrun_draw, "VIEW AROUND PLANES STILL_PLANES GROUNDS RUNNERS POSES RUNNER_HEIGHT"),
        (coinrun_draw, "PERIOD CRATES"),
    ),
}


def module() -> bytes:
    """Return the module's text with Python's current values."""
    lines = []
    for name, parts in TABLES.items():
        table = {n: vars(module)[n] for module, names in parts for n in names.split()}
        lines.append(f"export const {name} = {json.dumps(table, default=_plain)};\n")
    return "".join(lines).encode()


def _plain(value: Any) -> Any:
    """Convert a NumPy number for JSON; as text if it is larger than JavaScript's can be."""
    assert isinstance(value, np.generic)
    plain: Any = value.item()
    return str(plain) if isinstance(plain, int) and plain > EXACT else plain
