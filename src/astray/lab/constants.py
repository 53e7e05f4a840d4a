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
from astray.games.heist import rules as heist_rules
from astray.games.keys import draw as keys_draw
from astray.games.keys import rules as keys_rules
from astray.games.maze import rules as maze_rules
from astray.games.maze import variants as maze_variants
from astray.grid import abilities
from astray.kernel import maze, thief
from astray.lab import goals, messages
from astray.training import ppo

EXACT = 2**53  # up to which JavaScript keeps every integer
PATH = "rules/constants.js"  # from the page
# By the name that JavaScript imports: modules, and the names in them.
TABLES: dict[str, tuple[tuple[ModuleType, str], ...]] = {
    "common": ((maze, "WALL"), (record, "NEVER"), (own, "COLOURS")),
    "levels": ((record, "MOST"),),
    "messages": ((messages, "LARGEST"),),
    "noises": ((ppo, "BELOW_ONE"),),
    "grid": ((abilities, "OVER"),),
    "rewards": ((ppo, "CLIP"),),
    "goals": ((goals, "TOGETHER NEITHER OTHER BETA"),),
    "maze": ((maze_rules, "GOAL OTHER BOTH"), (maze_variants, "OTHERS COLOURS WALLS")),
    "keys": ((keys_rules, "KEY"), (keys_draw, "PLANES")),
    "thief": ((thief, "HALF"),),
    "heist": ((heist_rules, "COLOURS KEY DOOR_CODE GEM"), (heist_draw, "PLANES")),
    "coinrun": (
        (coinrun_rules, "WORLD EMPTY WALL TOP LAVA LAVA_TOP COIN INVISIBLE PERMEABLE"),
        (coinrun_rules, "NOTHING CRATE SAW HALF TALL WALKERS"),
        (coinrun_cells, "CRATE_HERE SAW_HERE WALKER_LEFT SAW_AND_LEFT"),
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
