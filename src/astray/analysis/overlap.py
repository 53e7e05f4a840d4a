"""Levels of a test that are levels of the training all the same, under other numbers."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator, Sequence
from hashlib import blake2b

import numpy as np
import polars as pl

from astray import games
from astray.analysis.episodes import CHUNK, initial_states
from astray.game import COMMON, Game, Variant, level_numbers
from astray.level import EMPTY

SEARCHED = 100  # levels looked at for each that is needed


def overlap(
    game: str | Game,
    training: str | Variant,
    training_levels: Sequence[int] | np.ndarray | range,
    test: str | Variant,
    test_levels: Sequence[int] | np.ndarray | range,
) -> pl.DataFrame:
    """How many levels coincide: rows "level" (all but its looks) and "walls" (without objects).

    Columns: same; training (different ones among the training levels); test (likewise);
    seen (share of the test levels that are among the training's).
    """
    seen, tested = (
        list(zip(*_digests(game, variant, levels), strict=True))
        for variant, levels in ((training, training_levels), (test, test_levels))
    )
    rows = []
    for same, before, after in zip(("level", "walls"), seen, tested, strict=True):
        known = set(before)
        share = float(np.mean([digest in known for digest in after]))
        rows.append({"same": same, "training": len(known), "test": len(set(after)), "seen": share})
    return pl.DataFrame(rows)


def met(game: str | Game, trainings: Iterable[tuple[str | Variant, range]]) -> set[bytes]:
    """What all levels of some trainings are known by, for `unseen`.

    trainings  the variant and the numbers of each; where levels of one number hardly differ
               between variants of the same numbers, many cost little more than one
    """
    variants: dict[range, list[str | Variant]] = {}
    for variant, numbers in dict.fromkeys(trainings):
        variants.setdefault(numbers, []).append(variant)
    known = set()
    for numbers, made in variants.items():
        for chunks in zip(*(_states(game, variant, numbers) for variant in made), strict=True):
            known.update(level for level, _ in _told(game, chunks[0]))
            for before, states in itertools.pairwise(chunks):
                known.update(level for level, _ in _told(game, states[_differ(before, states)]))
    return known


def unseen(
    game: str | Game, known: set[bytes], test: str | Variant, candidates: range, count: int
) -> np.ndarray:
    """The first `count` numbers among `candidates` whose level in `test` was in no training.

    known  the levels of the trainings, from `met`

    Levels are the same where all but their looks is. ValueError where too few are different.
    """
    found: list[int] = []
    looked = candidates[: SEARCHED * count]
    for first in range(0, len(looked), CHUNK):
        numbers = looked[first : first + CHUNK]
        fresh = [level not in known for level, _ in _digests(game, test, numbers)]
        found += np.array(numbers)[fresh].tolist()
        if len(found) >= count:
            return np.array(found[:count])
    raise ValueError(
        f"of {len(looked)} levels of {games.find(game).name} that no training drew from, only "
        f"{len(found)} are not in them; {count} are needed"
    )


def _digests(
    game: str | Game, variant: str | Variant, levels: Sequence[int] | np.ndarray | range
) -> Iterator[tuple[bytes, bytes]]:
    """Of each level: a digest of all but its looks, and one of its walls alone."""
    for states in _states(game, variant, levels):
        yield from _told(game, states)


def _states(
    game: str | Game, variant: str | Variant, levels: Sequence[int] | np.ndarray | range
) -> Iterator[np.ndarray]:
    """The states that levels begin in, CHUNK at a time; each chunk is gone with the next."""
    numbers = level_numbers(levels)
    for first in range(0, len(numbers), CHUNK):
        yield initial_states(game, variant, numbers[first : first + CHUNK])


def _differ(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Which of states [N] are not the same to the byte."""
    words, others = (s.view(np.ndarray).view(np.uint64).reshape(len(s), -1) for s in (one, other))
    return (words != others).any(1)


def _told(game: str | Game, states: np.ndarray) -> Iterator[tuple[bytes, bytes]]:
    """Of each state's level: a digest of all but its looks, and one of its walls alone.

    Of a game without editing both are of all fields of its own in the state.
    """
    game = games.find(game)
    if not game.editing:
        names = [name for name in states.dtype.names or () if name not in COMMON]
        for s in states:
            whole = blake2b(b"".join(s[name].tobytes() for name in names), digest_size=8).digest()
            yield whole, whole
        return
    objects = [game.editing.LEGEND[char] for char in game.editing.OBJECTS.values()]
    for s in states:
        told = game.editing.describe(s)
        grid = np.array(told["grid"], np.uint8)
        walls = np.where(np.isin(grid, objects), game.editing.LEGEND[EMPTY], grid)
        begun = grid.tobytes() + np.array(told["agent"]).tobytes()
        yield (
            blake2b(begun, digest_size=8).digest(),
            blake2b(walls.tobytes(), digest_size=8).digest(),
        )
