"""The games: those of this package, those that others offer, and those that were registered.

Here, a game is a sub-package that defines `GAME`; nothing else lists it. Another package offers
its games as entry points of the group `astray.games`: name = "module:GAME".
"""

from __future__ import annotations

import functools
import importlib
import json
import pkgutil
import re
from collections.abc import Callable
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from astray.bounds import brief, shown
from astray.game import Game

OWN = tuple(sorted(module.name for module in pkgutil.iter_modules(__path__) if module.ispkg))
GROUP = "astray.games"
# Our variants of what Procgen calls its games and difficulties.
PROCGEN = {
    ("coinrun", "hard"): ("coinrun", "procgen"),
    ("coinrun", "easy"): ("coinrun", "procgen-easy"),
    ("maze", "hard"): ("maze", "anywhere"),
    ("maze", "easy"): ("maze", "anywhere-easy"),
    ("maze", "memory"): ("maze", "anywhere-memory"),
}
_registered: dict[str, Game] = {}


def names() -> tuple[str, ...]:
    """The names of all games: astray's own first."""
    return (*OWN, *sorted({*_registered, *_offered()} - {*OWN}))


def register(game: Game) -> None:
    """Let `game` be found by its name, in this process: by `find`, and so in settings and verbs.

    Again, it takes the place of the one before. A package that is installed can offer its games
    to all processes: see the entry points above.

    Raises ValueError where the name is that of one of astray's own games, or cannot be a name.
    """
    if not isinstance(game, Game):
        raise ValueError(f"a game must be a Game; got {game!r}")
    if not all(re.fullmatch(r"[\w:.-]+", name) for name in (game.name, *game.variants)):
        raise ValueError(
            "names of a game and its variants must be of letters, digits, _, -, . and :; got "
            f"{game.name!r} with {', '.join(map(repr, game.variants))}"
        )
    if game.name in OWN:
        raise ValueError(f"a game's name must be its own; {game.name!r} is one of astray's")
    _registered[game.name] = game


def find(game: str | Game) -> Game:
    """The game of that name; one of your own is itself.

    Raises ValueError where there is none, or what offers one under that name fails.
    """
    if isinstance(game, Game):
        return game
    if not isinstance(game, str):
        raise ValueError(f"a game must be a Game or its name; got {shown(game)}")
    if game in OWN:
        return importlib.import_module(f"{__name__}.{game}").GAME
    if game in _registered:
        return _registered[game]
    if game in _offered():
        return _load(_offered()[game])
    raise ValueError(f"unknown game {game!r}; there are: {', '.join(names())}")


def survey(describe: Callable[[Game], Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Return what `describe` says of every game, and the reason for each that is broken, by name.

    A game of another package may fail in any way, and must not keep the others from being seen.
    """
    found, broken = {}, {}
    for name in names():
        try:
            described = describe(find(name))
            json.dumps(described)  # which is how it is sent and printed
            found[name] = described
        except KeyboardInterrupt:
            raise
        except BaseException as error:  # also of an exit
            is_told = isinstance(error, ValueError)
            broken[name] = brief(error) if is_told else f"the game {name!r} fails: {shown(error)}"
    return found, broken


@functools.cache
def _offered() -> dict[str, EntryPoint]:
    """The games of other packages that are installed, by name; none is imported by this."""
    return {point.name: point for point in entry_points(group=GROUP)}


@functools.cache
def _load(point: EntryPoint) -> Game:
    try:
        game = point.load()
    except KeyboardInterrupt:
        raise
    except BaseException as error:  # else a module that exits would end every verb
        raise ValueError(f"the game {point.name!r}, {point.value}, fails: {error!r}") from error
    if not isinstance(game, Game) or game.name != point.name:
        raise ValueError(f"{point.value} must be a Game called {point.name!r}; got {game!r}")
    return game
