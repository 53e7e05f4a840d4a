"""Overlap of test and training levels: equal levels with different numbers."""

from collections.abc import Iterable, Sequence
from hashlib import blake2b
from itertools import chain, islice, pairwise
from typing import Any

import numpy as np
import polars as pl

from astray import games
from astray.envs.beginnings import in_chunks
from astray.game import Game, Variant
from astray.level import EMPTY
from astray.record import COMMON

SEARCHED = 100  # levels looked at for each that is needed


def overlap(
    game: str | Game,
    training: str | Variant,
    training_levels: Sequence[int] | np.ndarray | range,
    test: str | Variant,
    test_levels: Sequence[int] | np.ndarray | range,
) -> pl.DataFrame:
    """Count equal levels: row "level" ignores looks, row "walls" also ignores objects.

    Columns: same; training and test (numbers of distinct levels); seen (fraction of the test
    levels that occur in training).
    """
    game = games.find(game)
    seen, tested = (
        [(_level(game, s), _walls(game, s)) for s in chain(*in_chunks(game, variant, levels))]
        for variant, levels in ((training, training_levels), (test, test_levels))
    )
    rows = []
    for same, before, after in zip(
        ("level", "walls"), zip(*seen, strict=True), zip(*tested, strict=True), strict=True
    ):
        known = set(before)
        fraction = float(np.mean([digest in known for digest in after]))
        rows.append(
            {"same": same, "training": len(known), "test": len(set(after)), "seen": fraction}
        )
    return pl.DataFrame(rows)


def met(game: str | Game, trainings: Iterable[tuple[str | Variant, range]]) -> set[bytes]:
    """Return fingerprints of all training levels, for use with `unseen`.

    Args:
        trainings: Variant and level numbers of each training. If variants hardly change a level,
            many of them cost little more than one.
    """
    game = games.find(game)
    variants: dict[range, list[str | Variant]] = {}
    for variant, numbers in dict.fromkeys(trainings):
        variants.setdefault(numbers, []).append(variant)
    known = set()
    for numbers, made in variants.items():
        for chunks in zip(*(in_chunks(game, variant, numbers) for variant in made), strict=True):
            known.update(_level(game, s) for s in chunks[0])
            for before, states in pairwise(chunks):
                words, others = (x.view(np.ndarray).view(np.uint64) for x in (before, states))
                differ = (words != others).reshape(len(states), -1).any(1)
                known.update(_level(game, s) for s in states[differ])
    return known


def unseen(
    game: str | Game, known: set[bytes], test: str | Variant, candidates: range, count: int
) -> np.ndarray:
    """Return the first `count` candidates [count] int64 whose level in `test` was in no training.

    Levels are equal if they differ in looks alone.

    Args:
        known: Fingerprints of the training levels, from `met`.

    Raises:
        ValueError: If there are too few such levels.
    """
    game = games.find(game)
    looked = candidates[: SEARCHED * count]
    states = chain.from_iterable(in_chunks(game, test, looked) if looked else ())
    new = (int(s["level"]) for s in states if _level(game, s) not in known)
    found = [*islice(new, count)]
    if len(found) < count:
        raise ValueError(
            f"of {len(looked)} levels of {game.name} that no training drew from, only "
            f"{len(found)} are not in them; {count} are needed"
        )
    return np.array(found)


def _level(game: Game, s: Any) -> bytes:
    """Return a digest of a state's level without its looks.

    In a game without editing it covers all of the game's own fields, and so does `_walls`.
    """
    if game.editing:
        return _digest(game.editing.grid(s), np.array(game.editing.centre(s)))
    return _digest(*(s[name] for name in game.state.names or () if name not in COMMON))


def _walls(game: Game, s: Any) -> bytes:
    """Return a digest of the walls of a state's level."""
    if not game.editing:
        return _level(game, s)
    grid, legend = game.editing.grid(s), game.editing.LEGEND
    objects = [legend[char] for char in game.editing.OBJECTS.values()]
    return _digest(np.where(np.isin(grid, objects), legend[EMPTY], grid))


def _digest(*arrays: np.ndarray) -> bytes:
    return blake2b(b"".join(array.tobytes() for array in arrays), digest_size=8).digest()
