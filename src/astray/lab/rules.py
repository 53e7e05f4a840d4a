"""Rules of games as modules of JavaScript, for pages without Python.

A module has a game's `step`, its symbolic planes, the kernels that levels are made with, and every
kernel that these call. `page/rules` has the rest: how a state is made of a level as data.
"""

import json
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from astray import grid
from astray.game import Game
from astray.games.coinrun import levels as coinrun
from astray.games.heist import levels as heist
from astray.games.heist.solve import hand_in
from astray.games.keys import levels as keys
from astray.games.maze import levels as maze
from astray.grid.rules import settle
from astray.kernel import rng
from astray.kernel.grid import distances, push
from astray.kernel.maze import margin
from astray.lab.translate import Translation
from astray.lab.worlds import shown_fields
from astray.places import Placement
from astray.variant import knobs

SHARED = "rules/kernels.js"  # from the page
DRAWN = (rng.seed_twister, rng.draw_u32)
# Kernels that `page/rules` calls in games that are no grid worlds, besides step and planes.
CALLED: Mapping[str, Sequence[Callable]] = {
    "coinrun": (coinrun.clear, coinrun.add_walker),
    "heist": (heist.furnish, heist.put, hand_in, margin, *DRAWN),
    "keys": (keys.furnish, keys.put, margin, *DRAWN),
    "maze": (maze.furnish, maze.note_arrivals, margin),
}


def entry(game: Game) -> str:
    """Return the path, from the page, of a game's rules: grid worlds have a folder of their own."""
    return f"{'worlds' if grid.world_of(game) else 'rules'}/{game.name}.js"


def path(game: Game) -> str:
    """Return the path of `module` from the page, which has all but the kernels of some games."""
    return entry(game) if grid.world_of(game) else f"rules/{game.name}-kernels.js"


def module(game: Game) -> str:
    """Return the module of a game's translated rules: a grid world's, or the kernels of others.

    Raises:
        ValueError: If its rules contain something that cannot be translated.
    """
    world: Any = grid.world_of(game)
    (variant, *_) = game.variants.values()
    fields = {name: game.state[name] for name in game.state.names or ()}
    made = Translation(dict.fromkeys(knobs(type(variant)), np.dtype(float)) | fields)
    called = {"step": made.name(game.rules.step)}
    moves = [name for name, kind in fields.items() if kind.shape and name in made.stored]
    planes = (game.symbols.background_planes, game.symbols.foreground_planes)
    own = (world.furnish, world.seek, settle) if world else CALLED[game.name]
    called |= {kernel.__name__: made.name(kernel) for kernel in (*planes, *own)}
    editing, places, choices = game.editing, game.places, knobs(type(variant)).items()
    assert isinstance(places, Placement)
    told = {
        "fields": {name: kind.shape for name, kind in fields.items()},
        "shown": shown_fields(game), "moves": moves, "LEGEND": editing.LEGEND,
        "STOOD_ON": editing.STOOD_ON,
        "objects": {name: editing.LEGEND[char] for name, char in editing.OBJECTS.items()},
        "choices": {name: those for name, kind in choices if (those := typing.get_args(kind))},
        "within": places.within, "offset": places.offset, "at_rest": places.at_rest,
    }  # fmt: skip
    if world:
        told |= {
            "planes": game.symbols.planes(variant).shape, "solid": world.codes(world.solid),
            "looks": world.looks, "agents": list(world.agents),
        }  # fmt: skip
    kernels = ", ".join(f"{name}: {there}" for name, there in called.items())
    of_world = (
        'import { gridRules } from "../rules/grid.js";\nexport const rules = gridRules(game);'
    )
    begin = f"const game = {{ ...{json.dumps(told)}, {kernels} }};"
    return made.module(
        f"The rules of {game.name}", begin, of_world if world else "export { game };"
    )


def shared() -> bytes:
    """Return the module of the kernels that a page calls for all games."""
    made = Translation({})
    names = map(made.name, (rng.mix_two, rng.fraction, distances, push))
    return made.module("Kernels", f"export {{ {', '.join(names)} }};").encode()
