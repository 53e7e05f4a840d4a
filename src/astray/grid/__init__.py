"""Grid worlds: what their rules, levels, looks and abilities share.

A world is a module of rules (`ACTIONS`, `STATE`, `EVENTS`, `step`) and levels (`generate`), and a
`Game` that `world` makes of it. See `games/lavaland` for the smallest.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from astray.game import Benchmark, Game, Outcome, Shift
from astray.grid import abilities
from astray.grid.abilities import Cells, World, where
from astray.grid.looks import looks, symbols

__all__ = ["Cells", "where", "world"]


def world(
    module: Any,
    name: str,
    about: str,
    *,
    things: Mapping[str, str],
    movers: Mapping[str, str] | None = None,
    agents: Sequence[str],
    variants: Mapping[str, Any],
    goals: Mapping[str, Outcome],
    shifts: Mapping[str, Shift],
    seek: Callable[[Any, str], Cells | int | None],
    hazards: Sequence[str] = (),
    solid: Sequence[str] = ("wall",),
    stood: str = "",
    level_fields: Mapping[str, int] | None = None,
    bounds: Mapping[str, tuple[int, int]] | None = None,
    centred: bool = False,
    **rest: Any,
) -> Game:
    """Make the game of a module that has the rules and levels of a grid world.

    Args:
        module: has `ACTIONS`, `STATE` (of `rules.state`), `EVENTS`, `step`, `generate` and
            `furnish(s, p)`, which sets the numbers that a level begins with, and its events
        name: of the game
        about: a sentence
        things: character in drawings -> name, which is its picture's; the first is "#", a wall
        movers: likewise, of what moves on things
        agents: names of the agent's pictures, one for each value of `held`
        variants: as of a `Game`
        goals: as of a `Game`
        shifts: as of a `Game`
        seek: (s, goal) -> what a script does to reach a goal that is an event: the cells to go to
            the nearest of, an action, or None for nothing
        hazards: names of what scripts walk around
        solid: names of what nobody walks on
        stood: characters of what the agent may stand on
        level_fields: fields of the state that a level decides beside its cells -> their value where
            a level as data does not say
        bounds: field -> first value, and the one after the last, which compiled code relies on
        centred: whether the agent is in the middle of the symbolic planes
        rest: of a `Game`
    """
    movers, side = movers or {}, module.STATE["cell"].shape[0]
    kinds = [*things.values(), *movers.values()]
    made = World(
        module, side, things, movers, solid, hazards, stood, len(agents),
        {goal: event for goal, event in goals.items() if isinstance(event, str)},
        seek, module.furnish, level_fields or {}, bounds or {},
    )  # fmt: skip
    there = abilities.places(made)

    def invariants(s: np.ndarray, variant: Any) -> dict[str, np.ndarray]:
        return made.truths(s)

    return Game(
        name, about, module, module,
        looks(Path(module.__file__).parent / "art", side, kinds, agents),
        variants, goals, shifts,
        symbols=symbols(side, len(kinds) + len(agents), centred),
        editing=abilities.editing(made), solver=abilities.solver(made),
        places=there, cells=there, benchmark=Benchmark(next(iter(variants))),
        invariants=invariants, **rest,
    )  # fmt: skip
