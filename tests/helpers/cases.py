"""Variants that tests are made for, and where recordings of the original are."""

import os
from collections.abc import Iterator, Mapping
from pathlib import Path

from astray import games, grid
from astray.game import Variant
from helpers.thorough import thorough

REFERENCE = Path(__file__).parents[1] / "reference"
ALL = [(game, variant) for game in games.OWN for variant in games.find(game).variants]


def informative(variants: Mapping[str, Variant]) -> Iterator[str]:
    """The variants in which a knob has a value that none before has; sides of regions are alike."""
    known: set[tuple[str, object]] = set()
    for name, variant in variants.items():
        values = {
            (knob, value)
            for knob, value in vars(variant).items()
            if knob not in ("about", "region", "shifted")
        }
        if not values <= known:
            yield name
        known |= values


def few(game: str) -> list[str]:
    """Variants with every value of every knob; of a grid world, which shares most, the fullest."""
    found = games.find(game)
    if grid.world_of(found):
        return [max(found.variants, key=lambda name: fullness(found.variants[name]))]
    return list(informative(found.variants))


def fullness(variant: Variant) -> int:
    """Return how many things the levels of a grid world have, in all."""
    return sum(n for knob, n in vars(variant).items() if knob != "time_limit" and type(n) is int)


# For tests that do the same in each variant; `make fuzz` takes all.
FEW = (
    ALL
    if os.environ.get("ASTRAY_FUZZ")
    else [(game, variant) for game in games.OWN for variant in few(game)]
)


def shape(game: str, variant: str) -> tuple[object, ...]:
    """What arrays depend on: the shape of symbols, and the side of the world."""
    found = games.find(game)
    made = found.variant(variant)
    return game, found.symbols.planes(made).shape, getattr(made, "world", None)


# Every shape, for tests that are slow and do not depend on what is in a level.
SHAPES = list({shape(*case): case for case in reversed(FEW)}.values())[::-1]
# For tests that are slow and differ little from one variant of a game to another.
FIRST = [*{game: (game, variant) for game, variant in reversed(SHAPES)}.values()][::-1]
FIRST_OF_ALL = [*FIRST, *thorough(*(case for case in FEW if case not in FIRST))]
