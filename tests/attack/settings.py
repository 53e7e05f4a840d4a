"""Class 4: every setting of a training, on the command line, in sweeps and in a run's file."""

from __future__ import annotations

import functools
import json
from collections.abc import Iterator
from typing import Any

from attack import words
from attack.core import Attempt, Place
from helpers.flat import kinds

# Texts that no setting can have, by what settings are.
WRONG: dict[str, tuple[str, ...]] = {
    "int": ("-1", "many", "1e3"), "float": ("nan", "inf", "-1"), "bool": ("perhaps",),
    "str": ("Nothing-Such", ""), "Literal": ("Nothing-Such",),
}  # fmt: skip
# Values in a file of settings, which JSON can hold, and no setting is.
STRANGE: tuple[Any, ...] = ({}, [[]], 1e400)


def attempts() -> Iterator[Attempt]:
    for setting, hint in kinds().items():
        if setting == "knobs":
            continue
        kind = _kind(hint.__name__ if isinstance(hint, type) else str(hint))
        for value in WRONG[kind]:
            for where, act in (("train", _train), ("sweep", _sweep)):
                if where == "sweep" and value != WRONG[kind][0]:
                    continue
                name = f"{where} with {setting} {value!r}"
                yield Attempt(4, name, functools.partial(act, setting, value), "any", seconds=60)
        for value in STRANGE:
            act = functools.partial(_file, setting, value)
            wants = "any" if setting == "teacher" else "refusal"
            yield Attempt(4, f"a file with {setting} {value!r}", act, wants)


def _kind(text: str) -> str:
    first = text.replace("Positional[", "").split(" |")[0].rstrip("]")
    return first if first in WRONG else "Literal"


def _train(name: str, value: str, place: Place) -> Any:
    given = words.words_of("train", place)
    if name in ("game", "variant"):
        given[("game", "variant").index(name)] = value
    else:
        given = words.with_option(given, name.replace("_", "-"), value)
    return place.astray("train", *given)


def _sweep(name: str, value: str, place: Place) -> Any:
    given = words.words_of("sweep", place)
    at = given.index("--set")
    given[at + 1] = f"{name}={value}"
    return place.astray("sweep", *given)


def _file(name: str, value: Any, place: Place) -> Any:
    path = place.copy("run") / "config.json"
    data = json.loads(path.read_text())
    data["config"][name] = value
    path.write_text(json.dumps(data))
    return place.astray("evaluate", "run", "--levels", "0:2")
