"""Verbs for levels: print, play, replay, compare them."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from rich.table import Table
from tyro.conf import Positional

from astray import games
from astray.acting import CHUNK, initial_states
from astray.cli.arguments import (
    Knobs,
    action_numbers,
    level_numbers,
    one_level,
    print_json,
    show,
    standard_input,
    varied,
)
from astray.files import read
from astray.game import OWN, Game, Variant
from astray.level import Level

LONGEST = 2**20  # characters of actions: more than any episode has


def level(
    game: Positional[str],
    variant: Positional[str],
    numbers: str = "0",
    knobs: Knobs = (),
    text: bool = False,
    json: bool = False,
) -> None:
    """Print levels, as drawings or as data; other verbs read both from files.

    Args:
        numbers: numbers and ranges, as 5,17,100:200
        knobs: of the variant, changed
        text: print drawings alone, without their headings
        json: print JSON, a level a line
    """
    rules = games.find(game)
    levels = varied(rules, variant, knobs)
    for s in _states(rules, levels, level_numbers(numbers)):
        if json:
            print_json(
                {"game": game, "variant": variant, "level": int(s.level)}
                | rules.editing.describe(s)
            )
        else:
            heading = "" if text else f"; {game} {variant} level {s.level}\n"
            print(f"{heading}{Level.of(rules, levels, s)}\n")


def play(
    game: Positional[str],
    variant: Positional[str],
    level: int | None = None,
    level_file: Path | None = None,
    unsolvable: bool = False,
    art: str = OWN,
    knobs: Knobs = (),
) -> None:
    """Play a game in a window, what an agent sees of it beside.

    Args:
        level: the first level's number; by default one at random
        level_file: a level to play first; `astray level` prints such
        unsolvable: let the level have objects that cannot be reached
        art: that it is drawn with, own or original
        knobs: of the variant, changed
    """
    from astray.play import play as window

    rules = games.find(game)
    levels = varied(rules, variant, knobs)
    window(rules, levels, one_level(rules, levels, level, level_file, unsolvable), art)


def replay(
    game: Positional[str],
    variant: Positional[str],
    actions: Path,
    level: int | None = None,
    level_file: Path | None = None,
    unsolvable: bool = False,
    knobs: Knobs = (),
    json: bool = False,
) -> None:
    """Play given actions in one level and tell what happens, step by step.

    Args:
        actions: a file of action names or numbers, separated by white space or commas; - for
            standard input
        level: its number
        level_file: the level instead; `astray level` prints such
        unsolvable: let it have objects that cannot be reached
        knobs: of the variant, changed
        json: print JSON
    """
    from astray.analysis.replay import replay as run

    rules = games.find(game)
    text = standard_input(LONGEST) if str(actions) == "-" else read(actions, LONGEST).decode()
    levels = varied(rules, variant, knobs)
    begun = one_level(rules, levels, level, level_file, unsolvable)
    if begun is None:
        raise ValueError("name a --level or a --level-file")
    told = run(rules, levels, begun, action_numbers(rules, text))
    if json:
        number = level if level_file is None else str(level_file)
        print_json({"game": game, "variant": variant, "level": number} | told)
        return
    for k, step in enumerate(told["steps"], 1):
        print(f"{k:5}  {step['action']:10}  ({step['x']:g}, {step['y']:g})  {step['reward']:+g}")
    print(
        f"return {told['return']:g}, "
        + (
            "terminated"
            if told["terminated"]
            else "truncated"
            if told["truncated"]
            else "not ended"
        )
    )


def overlap(
    game: Positional[str],
    training: Positional[str],
    test: Positional[str],
    training_levels: str = "0:100000",
    test_levels: str = "100000:101000",
    knobs: Knobs = (),
    json: bool = False,
) -> None:
    """Count the levels of a test that are those of the training, under other numbers.

    Args:
        training: the variant trained on
        test: the variant tested on
        training_levels: numbers and ranges, as 5,17,100:200
        test_levels: likewise
        knobs: of both variants, changed
        json: print JSON
    """
    from astray.analysis.overlap import overlap as count

    rules = games.find(game)
    shared = count(
        rules,
        varied(rules, training, knobs),
        level_numbers(training_levels),
        varied(rules, test, knobs),
        level_numbers(test_levels),
    )
    if json:
        print_json(shared.to_dicts())
        return
    table = Table("same", "different in training", "different in test", "of the test seen")
    for row in shared.to_dicts():
        table.add_row(row["same"], f"{row['training']:,}", f"{row['test']:,}", f"{row['seen']:.1%}")
    show(table)


def _states(game: Game, variant: Variant, levels: np.ndarray) -> Iterator[Any]:
    """The state that each level begins in, so that the first are printed before the last are made.

    Many levels take no more memory than few.
    """
    for first in range(0, len(levels), CHUNK):
        yield from initial_states(game, variant, levels[first : first + CHUNK])
