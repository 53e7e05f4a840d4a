"""The games. A game is a sub-package that defines `GAME`; nothing else lists it."""

import importlib
import pkgutil

from astray.game import Game

NAMES = tuple(sorted(module.name for module in pkgutil.iter_modules(__path__) if module.ispkg))


def load(name: str) -> Game:
    """The game called `name`."""
    if name not in NAMES:
        raise ValueError(f"unknown game {name!r}; there are: {', '.join(NAMES)}")
    return importlib.import_module(f"astray.games.{name}").GAME
