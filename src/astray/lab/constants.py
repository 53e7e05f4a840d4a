"""Constants shared with the page's rules, as a generated JavaScript module."""

import json
from importlib import import_module
from typing import Any

import numpy as np

EXACT = 2**53  # up to which JavaScript keeps every integer
PATH = "rules/constants.js"  # from the page
# By the name that JavaScript imports: modules, each with names in it.
TABLES = {
    "common": "kernel.maze WALL, record NEVER, art.own COLOURS",
    "levels": "record MOST",
    "messages": "lab.messages LARGEST",
    "noises": "training.ppo BELOW_ONE",
    "grid": "grid.abilities OVER",
    "rewards": "training.ppo CLIP",
    "goals": "lab.goals TOGETHER NEITHER OTHER BETA",
    "maze": "games.maze.rules GOAL OTHER BOTH, games.maze.variants OTHERS COLOURS WALLS GOALS",
    "keys": "games.keys.rules KEY, games.keys.draw PLANES",
    "thief": "kernel.thief HALF, kernel.grid PUSHES",
    "heist": "games.heist.rules COLOURS KEY DOOR_CODE GEM, games.heist.draw PLANES",
    "coinrun": "games.coinrun.rules WORLD EMPTY WALL TOP LAVA LAVA_TOP COIN INVISIBLE PERMEABLE "
    "NOTHING CRATE SAW HALF TALL WALKERS, games.coinrun.cells CRATE_HERE SAW_HERE WALKER_LEFT "
    "SAW_AND_LEFT, games.coinrun.draw VIEW AROUND PLANES STILL_PLANES GROUNDS RUNNERS POSES "
    "RUNNER_HEIGHT PERIOD CRATES",
}


def module() -> bytes:
    """Return the module's text with Python's current values."""
    lines = []
    for name, parts in TABLES.items():
        table = {}
        for where, *names in map(str.split, parts.split(", ")):
            table |= {n: vars(import_module(f"astray.{where}"))[n] for n in names}
        lines.append(f"export const {name} = {json.dumps(table, default=_plain)};\n")
    return "".join(lines).encode()


def _plain(value: Any) -> Any:
    """Convert a NumPy number for JSON; as text if it is larger than JavaScript's can be."""
    assert isinstance(value, np.generic)
    plain: Any = value.item()
    return str(plain) if isinstance(plain, int) and plain > EXACT else plain
