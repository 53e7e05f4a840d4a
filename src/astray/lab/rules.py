"""Rules of games as modules of JavaScript, for pages without Python.

A module has a game's `step`, its symbolic planes, the kernels that levels are made with, and where
scripts go, all compiled. `page/rules` has the rest: how a state is made of a level as data.
"""

import json
import typing
from collections.abc import Callable, Mapping
from typing import Any

import numba
from numba.core import types

from astray import grid
from astray.game import Game
from astray.games.coinrun import levels as coinrun
from astray.games.heist import levels as heist
from astray.games.heist.solve import hand_in
from astray.games.keys import levels as keys
from astray.games.maze import levels as maze
from astray.grid.rules import settle
from astray.kernel import rng
from astray.kernel.grid import distances
from astray.kernel.maze import margin
from astray.lab.wasm import compiled
from astray.lab.worlds import shown_fields
from astray.places import Placement
from astray.variant import knobs

SHARED = "rules/kernels.js"  # from the page
INT, CELLS, PLANES = types.int64, types.int64[:, ::1], types.uint8[:, :, ::1]
S, P = "a state", "a variant's knobs"  # of a game, in the place of their types
# Kernels of games that are no grid worlds, which `page/rules` calls, and the types of arguments.
CALLED: Mapping[str, Mapping[Callable, tuple[Any, ...]]] = {
    "coinrun": {coinrun.clear: (S,), coinrun.add_walker: (S, INT, INT, types.boolean, INT)},
    "heist": {
        heist.furnish: (S, P), heist.put: (S, INT, INT, INT), hand_in: (CELLS, INT, INT, INT),
        margin: (S,),
    },
    "keys": {keys.furnish: (S, P), keys.put: (S, INT, INT, INT), margin: (S,)},
    "maze": {maze.furnish: (S, P), maze.note_arrivals: (S,), margin: (S,)},
}  # fmt: skip


def entry(game: Game) -> str:
    """Return the path, from the page, of a game's rules: grid worlds have a folder of their own."""
    return f"{'worlds' if grid.world_of(game) else 'rules'}/{game.name}.js"


def path(game: Game) -> str:
    """Return the path of `module` from the page, which has all but the kernels of some games."""
    return entry(game) if grid.world_of(game) else f"rules/{game.name}-kernels.js"


def module(game: Game) -> str:
    """Return the module of a game's compiled rules: a grid world's, or the kernels of others.

    Raises:
        ValueError: If its rules cannot be compiled for a page.
    """
    world: Any = grid.world_of(game)
    (variant, *_) = game.variants.values()
    symbols = game.symbols

    called: dict[str, tuple[Callable, tuple[Any, ...]]] = {
        "step": (game.rules.step, (S, INT)), "wind": (wind, (S, INT, INT)),
        "background_planes": (symbols.background_planes, (S, PLANES)),
        "foreground_planes": (symbols.foreground_planes, (S, PLANES, PLANES)),
    }  # fmt: skip
    if world:
        called |= {"settle": (settle, (S,))}
        called |= {"furnish": (world.furnish, (S, P))} if world.furnish else {}
        called |= {f"target {goal}": (one, (S,)) for goal, one in world.targets.items()}
    else:
        called |= {one.__name__: (one, takes) for one, takes in CALLED[game.name].items()}
    own = {S: numba.from_dtype(game.state), P: numba.from_dtype(variant.records().dtype)}
    typed = {n: (one, tuple(own.get(k, k) for k in takes)) for n, (one, takes) in called.items()}
    editing, places, choices = game.editing, game.places, knobs(type(variant)).items()
    assert isinstance(places, Placement)
    told = {
        "fields": {name: game.state[name].shape for name in game.state.names or ()},
        "events": game.events, "shown": shown_fields(game),
        "LEGEND": editing.LEGEND, "STOOD_ON": editing.STOOD_ON,
        "objects": {name: editing.LEGEND[char] for name, char in editing.OBJECTS.items()},
        "choices": {name: typing.get_args(kind) or None for name, kind in choices},
        "within": places.within, "offset": places.offset, "at_rest": places.at_rest,
    }  # fmt: skip
    if world:
        told |= {
            "planes": symbols.planes(variant).shape, "solid": world.codes(world.solid),
            "looks": world.looks, "agents": list(world.agents),
        }  # fmt: skip
    begin = f"const game = {{ ...{json.dumps(told)}, ...{compiled(typed)} }};"
    ends = [
        'import { gridRules } from "../rules/grid.js";',
        "export const rules = gridRules(game);",
    ]
    return _text(f"The rules of {game.name}", begin, *(ends if world else ["export { game };"]))


def shared() -> bytes:
    """Return the module of the kernels that a page calls for all games."""
    wide = types.uint64, types.uint64
    cells, found = (types.Array(kind, 2, "C") for kind in (types.boolean, types.int32))
    called: Any = {one.__name__: (one, wide) for one in (rng.mix_two, rng.fraction)}
    called["steps"] = steps, (cells, INT, INT, found)
    return _text(
        "Kernels", 'import { stepsOf } from "./memory.js";', f"const made = {compiled(called)};",
        "export const { mix_two, fraction } = made;",
        "export const distances = stepsOf(made.steps);",
    ).encode()  # fmt: skip


def wind(s: Any, number: int, draws: int) -> None:
    """Set the twister of `s` to that of a number after some draws."""
    rng.seed_twister(s, number)
    for _ in range(draws):
        rng.draw_u32(s)


def steps(is_open: Any, x: int, y: int, found: Any) -> None:
    """Write the `distances` to a cell into `found` [H, W]."""
    away = distances(is_open, x, y)
    for row in range(len(away)):
        for column in range(len(away[row])):
            found[row, column] = away[row, column]


def _text(about: str, *lines: str) -> str:
    imported = 'import { kernels } from "../rules/memory.js";'
    return "\n".join([f"// {about}, compiled from Python.", imported, *lines, ""])
