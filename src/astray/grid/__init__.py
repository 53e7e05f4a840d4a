"""Grid worlds: shared rules, levels, appearance and abilities.

A world is a module of rules (`ACTIONS`, `STATE`, `EVENTS`, `step`) and levels (`generate`), and a
`Game` that `world` makes of it. See `games/lavaland` for the smallest.
"""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from astray.game import Benchmark, Game, Outcome, Shift
from astray.grid import abilities
from astray.grid.abilities import OVER, World
from astray.grid.looks import looks, sprites, symbols
from astray.grid.rules import nearest
from astray.level import AGENT, EMPTY
from astray.places import Placement
from astray.validation import one_of, shown

__all__ = ["nearest", "world", "world_of"]
_MADE: dict[Game, World] = {}


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
    seek: Mapping[str, Callable],
    hazards: Sequence[str] = (),
    solid: Sequence[str] = ("wall",),
    stood: str = "",
    level_fields: Mapping[str, int] | None = None,
    bounds: Mapping[str, tuple[int, int]] | None = None,
    centred: bool = False,
    **rest: Any,
) -> Game:
    """Make a game from a module with the rules and levels of a grid world.

    Args:
        module: Module with `ACTIONS`, `STATE` (of `rules.state`), `EVENTS`, `step`, `generate`, and
            perhaps `furnish(s, p)`, which sets a level's numbers that begin otherwise than with 0.
        name: Name of the game.
        about: Description, a sentence.
        things: Character in drawings -> name of the kind and of its picture; the first is "#", a
            wall.
        movers: The same for kinds that move on things, with which there are at most 15.
        agents: Names of the agent's pictures, one for each value of `held`.
        variants: As in a `Game`.
        goals: As in a `Game`.
        shifts: As in a `Game`.
        seek: Goal -> kernel (s, there), for each goal that is an event. It marks the cells that a
            script goes to, in `there` [side, side], with the action that the script takes there,
            or `rules.STAY`. A script goes to the nearest. `nearest` makes such a kernel.
        hazards: Names of kinds that scripts walk around.
        solid: Names of kinds that nobody can walk on.
        stood: Characters of kinds that the agent may stand on.
        level_fields: State fields that a level decides besides its cells -> their default values.
        bounds: Field -> first value, and the one after the last, which compiled code relies on.
        centred: Whether the agent is in the middle of the symbolic planes.
        rest: Further fields of a `Game`.

    Raises:
        ValueError: If `seek` has other goals than those that are events, there are 16 kinds, or
            two alike, or a name is of none.
    """
    movers, side = movers or {}, module.STATE["cell"].shape[0]
    events = {goal: event for goal, event in goals.items() if isinstance(event, str)}
    if seek.keys() != events.keys():
        there = ", ".join(events)
        raise ValueError(f"seek of {name!r} must have the goals {there}; it has {', '.join(seek)}")
    kinds = [*things.values(), *movers.values()]
    if len(kinds) >= OVER:
        raise ValueError(f"{name} must have less than {OVER} things and movers; got {len(kinds)}")
    chars = [AGENT, EMPTY, *things, *movers]
    for what, given in {"names": kinds, "characters": chars}.items():  # a kind is known by either
        if twice := [one for one in given if given.count(one) > 1]:
            raise ValueError(
                f"{what} of things and movers must differ; {twice[0]!r} is there twice"
            )
    if chars[2] != "#" or any(len(char) != 1 for char in chars):
        raise ValueError(f'things must be single characters, "#" the first; got {shown(things)}')
    for what in (*hazards, *solid):
        one_of("thing or mover", what, kinds, of=name)
    for what in stood:
        one_of("thing to stand on", what, chars[2:], of=name)
    for what in (*(level_fields or {}), *(bounds or {})):
        one_of("field", what, module.STATE.names, of=name)
    made = World(
        module, side, things, movers, solid, hazards, stood, agents, events,
        seek, getattr(module, "furnish", None), level_fields or {}, bounds or {},
    )  # fmt: skip
    editing, solver = abilities.editing(made), abilities.solver(made)
    art = Path(module.__file__).parent / "art"

    game = Game(
        name, about, module, module,
        looks(art, side, kinds, agents),
        variants, goals, shifts,
        symbols=symbols(side, len(kinds) + len(agents), centred),
        editing=editing, solver=solver, cells=abilities.cells(made),
        places=Placement(editing, solver, (0, 0), 0.5), benchmark=Benchmark(next(iter(variants))),
        sprites=sprites(art, made.pictures(), agents),
        invariants=lambda states, variant: made.truths(states), **rest,
    )  # fmt: skip
    _MADE[game] = made
    return game


def world_of(game: Game) -> World | None:
    """Return the description from which `world` made a game; None for any other game."""
    return _MADE.get(game)
