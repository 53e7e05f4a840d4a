"""Names that stand for games and variants in settings, and what older versions wrote."""

import contextlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import MISSING, fields, replace
from typing import Any

from astray import games, imports, world
from astray.game import Game, Variant
from astray.validation import of_kind
from astray.world import World, WorldVariant


def name_of_played(game: Any) -> Any:
    """Return the name of a game or a `World`; anything else that is no such object stays.

    A World, also one that is named as module:WORLD and imported, is registered.

    Raises:
        ValueError: If a game is not registered, or what is imported is no World.
    """
    if isinstance(game, Game):
        found = None
        with contextlib.suppress(ValueError):
            found = games.find(game.name)
        if found is not game:
            told = f"the game {game.name!r} must be registered first: astray.register(game)"
            raise ValueError(told)
        return game.name
    if isinstance(game, str) and imports.is_name(game) and game not in games.names():
        game = imports.find(game)
        of_kind("a world", game, World)
    if not isinstance(game, World):
        return game
    world.register(game)
    return game.name


def stored(game: Any, variant: Any, knobs: Any) -> dict[str, Any]:
    """Return those of the settings game, variant and knobs in which names stand for objects.

    Raises:
        ValueError: If an object has no name that finds it, or the knobs are no mapping.
    """
    given = {"game": name_of_played(game)}
    if isinstance(variant, Variant):
        of_kind("knobs", knobs, Mapping)
        name, changed = name_of_variant(world.find(game), variant.with_knobs(knobs))
        return given | {"variant": name, "knobs": changed}
    if isinstance(variant, WorldVariant):
        return given | {"variant": variant.name, "knobs": {**variant.knobs, **knobs}}
    return given


def name_of_variant(game: Game, variant: Variant) -> tuple[str, dict[str, Any]]:
    """Return the nearest named variant, and the knobs that turn it into `variant`.

    Raises:
        ValueError: If no named variant can be turned into it by knobs.
    """
    found = sorted(_alike(game, game.variant(variant)), key=lambda one: len(one[1]))
    if not found:
        raise ValueError(
            f"a variant must be one of {game.name}, but for its knobs; got {variant.about!r}, "
            "which shifts to another: register a game with it"
        )
    return found[0]


def _alike(game: Game, variant: Variant) -> Iterator[tuple[str, dict[str, Any]]]:
    for name, own in game.variants.items():
        if type(own) is not type(variant):
            continue
        changes = variant.unlike(own)
        try:
            made = own.with_knobs(changes)
        except ValueError:
            continue
        if replace(made, about=variant.about) == variant:
            yield name, changes


def same_levels(told: Any, now: Variant) -> bool:
    """Return whether a variant written by any version has the same levels as `now`."""
    today = json.loads(json.dumps(now.to_json()))
    return _levels_of(_with_later_knobs(told, now)) == _levels_of(today)


def _with_later_knobs(told: Any, now: Variant) -> Any:
    """Return a written variant with the defaults of knobs that its version lacked."""
    if not isinstance(told, dict):
        return told
    later = {f.name: f.default for f in fields(now) if f.default is not MISSING}
    if told.get("shifted") is not None and now.shifted is not None:
        told = told | {"shifted": _with_later_knobs(told["shifted"], now.shifted)}
    return later | told


def _levels_of(variant: Any) -> Any:
    """Return the fields of a written variant that affect its levels, without an unused shift."""
    if isinstance(variant, dict) and variant.get("shift_probability") == 0:
        return variant | {"shifted": None}
    return variant
