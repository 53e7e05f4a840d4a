"""Discovery and registration of games.

A sub-package here that defines `GAME` is a game; there is no other list. Another package offers
its games as entry points of the group `astray.games`: name = "module:GAME".
"""

import functools
import importlib
import json
import pkgutil
import re
from collections.abc import Callable
from typing import Any

from astray import imports
from astray.game import Game
from astray.validation import brief, of_kind, shown

OWN = tuple(sorted(module.name for module in pkgutil.iter_modules(__path__) if module.ispkg))
GROUP = "astray.games"
# Our variants of what Procgen calls its games and difficulties.
PROCGEN = {
    ("coinrun", "hard"): ("coinrun", "procgen"), ("coinrun", "easy"): ("coinrun", "procgen-easy"),
    ("maze", "hard"): ("maze", "anywhere"), ("maze", "easy"): ("maze", "anywhere-easy"),
    ("maze", "memory"): ("maze", "anywhere-memory"), ("heist", "hard"): ("heist", "hard"),
    ("heist", "easy"): ("heist", "easy"), ("heist", "memory"): ("heist", "memory"),
}  # fmt: skip
_registered: dict[str, Game] = {}


def names() -> tuple[str, ...]:
    """Return the names of all games, astray's own first."""
    return (*OWN, *sorted({*_registered, *_offered()} - {*OWN}))


def register(game: Game) -> None:
    """Register `game` in this process, so that `find`, settings and verbs know its name.

    A second registration replaces the first. An installed package can offer its games to all
    processes through entry points; see the top of this module.

    Raises:
        ValueError: If the name is invalid, or that of one of astray's own games.
    """
    of_kind("a game", game, Game)
    _check_names(game.name, *game.variants)
    if game.name in OWN:
        raise ValueError(f"a game's name must be its own; {game.name!r} is one of astray's")
    _registered[game.name] = game


def find(game: str | Game) -> Game:
    """Return the game of that name; a `Game` is returned unchanged.

    Raises:
        ValueError: If there is none, or the package that offers it fails.
    """
    if isinstance(game, Game):
        return game
    if not isinstance(game, str):
        raise ValueError(
            f"a game must be a Game or its name; got {shown(game)}; docs/worlds.md says what takes "
            "a World"
        )
    if game in OWN:
        return importlib.import_module(f"{__name__}.{game}").GAME
    if game in _registered:
        return _registered[game]
    if game in _offered():
        return _load(game, _offered()[game])
    raise ValueError(f"unknown game {shown(game)}; there are: {', '.join(names())}")


def survey(describe: Callable[[Game], Any]) -> tuple[dict[str, Any], dict[str, str]]:
    """Apply `describe` to every game; return its results and the reasons of failures, by name.

    A broken game of another package does not hide the others.
    """
    found, broken = {}, {}
    for name in names():
        try:
            game = find(name)
            with imports.guarded(f"the game {name!r}"):
                # As it is sent: plain data, of which nothing fails when it is printed.
                found[name] = json.loads(json.dumps(describe(game)))
        except ValueError as error:
            broken[name] = brief(error)
    return found, broken


@functools.cache
def _offered() -> dict[str, tuple[str, ...]]:
    """Return what other packages offer by the name of a game, as module:GAME; import none."""
    found: dict[str, tuple[str, ...]] = {}
    for point in imports.offered(GROUP):
        found[point.name] = (*found.get(point.name, ()), point.value)
    return found


@functools.cache
def _load(name: str, values: tuple[str, ...]) -> Game:
    game = imports.only(name, values, GROUP)
    with imports.guarded(f"the game {name!r}, {values[0]},"):
        known = isinstance(game, Game) and game.name == name  # a stranger's class may exit
        variants = [*map(str, game.variants)] if known else []
    if not known:
        raise ValueError(f"{values[0]} must be a Game called {name!r}; got {shown(game)}")
    _check_names(name, *variants)
    return game


def _check_names(name: str, *variants: str) -> None:
    """Raise ValueError unless a game and its variants have names that a file can have."""
    if not all(re.fullmatch(r"[\w.-]+", one) for one in (name, *variants)):
        raise ValueError(
            "names of a game and its variants must be of letters, digits, _, - and .; got "
            f"{name!r} with {', '.join(map(repr, variants))}"
        )
