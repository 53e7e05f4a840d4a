"""What several verbs take and print: levels, knobs, actions, JSON."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from rich.console import Console, RenderableType
from tyro.conf import UseAppendAction, arg

from astray.analysis import kept
from astray.bounds import bounded
from astray.game import Game, Variant
from astray.level import Level, read_levels
from astray.record import LEVELS, NEVER

Mode = Literal["sampled", "greedy"]
# Several after one --set, or one after each of several.
Words = tuple[tuple[str, ...], ...]
Knobs = UseAppendAction[Annotated[Words, arg(name="set", metavar="KNOB=VALUE")]]
AT_ONCE = 10_000_000  # level numbers of one command


def chosen(runs: Sequence[Path], agent: str | None) -> tuple[Path, ...]:
    """The run folders that were asked for: these, each by its path or an agent's name."""
    if agent is not None and runs:
        raise ValueError("an agent is given by a run folder or by --agent NAME, not both")
    if agent is None and not runs:
        raise ValueError("name a run folder, or an --agent")
    return tuple(map(kept.run_of, runs)) if agent is None else (kept.find(agent),)


def see_of_policy(game: str | None, observation: str | None, world: str | None = None) -> None:
    """ValueError where what only a policy of one's own needs is given without one."""
    for name, given in (("game", game), ("observation", observation), ("world", world)):
        if given is not None:
            raise ValueError(f"--{name} {given} needs --policy; a run says which it has")


def level_numbers(text: str) -> np.ndarray:
    """Level numbers from text like 5,17,100:200."""
    spans = []
    try:
        for part in text.split(","):
            first, colon, after = part.partition(":")
            spans.append(
                range(int(first), int(after)) if colon else range(int(first), int(first) + 1)
            )
    except ValueError:
        raise ValueError(
            f"levels must be numbers and ranges as 5,17,100:200; got {text!r}"
        ) from None
    spans = [span for span in spans if span]
    if not spans or any(s[0] < 0 or s[-1] >= LEVELS.stop for s in spans):
        raise ValueError(f"levels must be numbers from 0 to {LEVELS.stop - 1}; got {text!r}")
    count = sum(map(len, spans))
    if count > AT_ONCE:
        raise ValueError(f"{count} levels are given; at most {AT_ONCE} are taken at once")
    return np.concatenate([np.arange(span.start, span.stop) for span in spans])


def pairs(knobs: Words) -> dict[str, Any]:
    """Values by name, as text; ValueError where a knob has none, or two."""
    found: dict[str, Any] = {}
    for knob in (knob for together in knobs for knob in together):
        name, equals, value = knob.partition("=")
        if not equals:
            raise ValueError(f"a knob must be set as NAME=VALUE; got {knob!r}")
        if name in found:
            raise ValueError(f"knob {name!r} is set twice: to {found[name]!r} and to {value!r}")
        found[name] = value
    return found


def varied(game: Game, variant: str, knobs: Words) -> Variant:
    return game.variant(variant).with_knobs(pairs(knobs))


def one_level(
    game: Game, variant: Variant, number: int | None, file: Path | None, unsolvable: bool
) -> int | Level | None:
    """The level that was asked for by number or file; None where neither was."""
    if number is not None:
        bounded("level", number, LEVELS.start, LEVELS.stop - 1)
    if file is None:
        return number
    if number is not None:
        raise ValueError("a level is given by its number or in a file, not both")
    found = read_levels(file, game, variant, solvable=not unsolvable)
    if len(found) > 1:
        raise ValueError(f"one level is played; {file} holds {len(found)}")
    return next(iter(found.values()))


def action_numbers(game: Game, text: str) -> list[int]:
    """Actions by name or number."""
    found = []
    for word in text.replace(",", " ").replace("[", " ").replace("]", " ").split():
        name = word.strip("\"'")
        number = int(name) if name.isdecimal() else NEVER
        if name in game.actions:
            number = game.actions.index(name)
        if not 0 <= number < len(game.actions):
            there = ", ".join(f"{k} {a}" for k, a in enumerate(game.actions))
            raise ValueError(f"unknown action {name!r}; there are: {there}")
        found.append(number)
    return found


def show(*what: RenderableType, width: int | None = None) -> None:
    """Print tables and marked up text, as wide as the terminal or `width` characters."""
    console = Console(width=width)
    with console.capture() as shown:  # rich ends the process by itself where nobody reads
        for one in what:
            console.print(one)
    print(shown.get(), end="")


def standard_input(most: int) -> str:
    """All that is written to this process, if it is no more than `most` characters."""
    if sys.stdin is None:
        raise ValueError("standard input is closed; there is nothing to read")
    text = sys.stdin.read(most + 1)
    if len(text) > most:
        raise ValueError(f"standard input must be at most {most:,} characters; there are more")
    return text


def print_json(data: Any) -> None:
    print(json.dumps(data))
