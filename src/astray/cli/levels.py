"""Verbs that print, play, replay and compare levels."""

import sys
from itertools import chain
from pathlib import Path

from rich.table import Table
from tyro.conf import Positional

from astray import games
from astray.cli.arguments import (
    Drawn,
    Json,
    Knobs,
    PlayedLevel,
    level_numbers,
    played,
    print_json,
    show,
)
from astray.envs.beginnings import in_chunks
from astray.game import OWN, Game
from astray.level import Level
from astray.level_files import text_of
from astray.record import NEVER
from astray.validation import shown

LONGEST = 2**20  # characters of actions: more than any episode has
DIGITS = 10  # no number of an action has as many


def level(game: Drawn, levels: str = "0", text: bool = False, json: Json = False) -> None:
    """Print levels as drawings or as data; other verbs read both from files.

    Example: astray level maze corner-small --levels 5,17,100:103

    Args:
        levels: Level numbers and ranges, such as 5,17,100:200.
        text: Print only the drawings, without headings.

    Raises:
        ValueError: If data are asked for, too.
    """
    if text and json:
        raise ValueError("--text prints drawings, and --json data; give one of them")
    rules, variant = game.open()
    # Chunk by chunk, so that the first can be printed at once.
    for s in chain.from_iterable(in_chunks(rules, variant, level_numbers(levels))):
        if json:
            print_json(
                {"game": game.game, "variant": game.variant, "level": int(s.level)}
                | rules.editing.describe(s)
            )
        else:
            heading = "" if text else f"; {game.game} {game.variant} level {s.level}\n"
            print(f"{heading}{Level.of(rules, variant, s)}\n")


def play(game: Drawn, level: PlayedLevel = PlayedLevel(), art: str = OWN) -> None:
    """Play a game yourself, in a window that also shows the observation of an agent.

    By default the level is random.

    Example: astray play maze corner --level 17

    Args:
        art: Art that the game is drawn with: own or original.
    """
    from astray.play import play as window

    rules, levels = game.open()
    window(rules, levels, level.begun(rules, levels), art)


def replay(
    game: Drawn, actions: Path, level: PlayedLevel = PlayedLevel(), json: Json = False
) -> None:
    """Replay given actions in one level, and print each step.

    Example: astray replay maze corner-small --level 17 --actions actions.txt

    Args:
        actions: File with action names or numbers, separated by spaces, lines or commas; - for
            standard input.

    Raises:
        ValueError: If no level is named.
    """
    from astray.analysis.replay import replay as run

    rules, levels = game.open()
    text = standard_input(LONGEST) if str(actions) == "-" else text_of(actions, LONGEST)
    begun = level.begun(rules, levels)
    if begun is None:
        raise ValueError("name a --level or a --level-file")
    told = run(rules, levels, begun, action_numbers(rules, text))
    if json:
        number = level.level if level.level_file is None else str(level.level_file)
        print_json({"game": game.game, "variant": game.variant, "level": number} | told)
        return
    for k, step in enumerate(told["steps"], 1):
        print(f"{k:5}  {step['action']:10}  ({step['x']:g}, {step['y']:g})  {step['reward']:+g}")
    end = next((name for name in ("terminated", "truncated") if told[name]), "not ended")
    print(f"return {told['return']:g}, {end}")


def overlap(
    game: Positional[str],
    training: Positional[str],
    test: Positional[str],
    training_levels: str = "0:100000",
    test_levels: str = "100000:101000",
    knobs: Knobs = (),
    json: Json = False,
) -> None:
    """Count the test levels that also occur in training under other numbers.

    Example: astray overlap maze corner-small anywhere-small --test-levels 100000:101000

    Args:
        game: Name of the game.
        training: Variant that the agent is trained on.
        test: Variant that the agent is tested on.
        training_levels: Numbers and ranges of training levels, such as 5,17,100:200.
        test_levels: Numbers and ranges of test levels, such as 5,17,100:200.
    """
    from astray.analysis.overlap import overlap as count

    rules = games.find(game)
    shared = count(
        rules,
        played(rules, training, knobs),
        level_numbers(training_levels),
        played(rules, test, knobs),
        level_numbers(test_levels),
    )
    if json:
        print_json(shared.to_dicts())
        return
    table = Table("same", "different in training", "different in test", "of the test seen")
    for row in shared.to_dicts():
        seen = f"{100 * row['seen']:.1f} %"  # as in all tables
        table.add_row(row["same"], f"{row['training']:,}", f"{row['test']:,}", seen)
    show(table)


def action_numbers(game: Game, text: str) -> list[int]:
    """Parse actions given by name or number; raise ValueError for an unknown one."""
    found = []
    for word in text.replace(",", " ").replace("[", " ").replace("]", " ").split():
        name = word.strip("\"'")
        number = int(name) if name.isdecimal() and len(name) < DIGITS else NEVER
        if name in game.actions:
            number = game.actions.index(name)
        if not 0 <= number < len(game.actions):
            there = ", ".join(f"{k} {a}" for k, a in enumerate(game.actions))
            raise ValueError(f"unknown action {shown(name)}; there are: {there}")
        found.append(number)
    return found


def standard_input(most: int) -> str:
    """Read standard input; raise ValueError if it has more than `most` characters."""
    if sys.stdin is None:
        raise ValueError("standard input is closed; there is nothing to read")
    text = sys.stdin.read(most + 1)
    if len(text) > most:
        raise ValueError(f"standard input must be at most {most:,} characters; there are more")
    return text
