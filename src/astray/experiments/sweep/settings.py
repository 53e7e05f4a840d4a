"""What is swept: settings, the values that each takes, and how they are written as text."""

from __future__ import annotations

import itertools
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from astray.analysis.outcomes import load_shift
from astray.analysis.runs import LEVELS_PLAYED, shift_of
from astray.bounds import bounded, shown
from astray.training.config import Config
from astray.training.settings import SEEDS

KNOB = "variant."  # before the name of a knob of the variant
SHORT = {"lr": "learning_rate"}
MOST = 10_000  # agents of a sweep
Cell = tuple[Any, ...]  # a value of each axis


@dataclass(frozen=True)
class Sweep:
    """Settings and the values that each of them takes, in all combinations.

    axes    a setting, or variant.KNOB -> its values, as they are set
    seeds   agents of each combination
    levels  that each agent is evaluated on, the first that its training does not draw from
    shift   which goals are intended and proxies; None: the one that the training is for
    """

    base: Config
    axes: Mapping[str, Sequence[Any]]
    seeds: int = 1
    levels: int = LEVELS_PLAYED
    shift: str | None = None

    def __post_init__(self) -> None:
        bounded("seeds", self.seeds, 1, SEEDS - self.base.seed)
        bounded("levels", self.levels, 1, MOST * 100)
        count = math.prod(map(len, self.axes.values())) * self.seeds
        if not self.axes or not all(self.axes.values()) or count > MOST:
            raise ValueError(
                f"a sweep must set something, in 1 to {MOST:,} agents; got {shown(self.axes)}"
            )
        for name, values in self.axes.items():
            if len({str(value) for value in values}) < len(values):
                raise ValueError(f"{name} must take each value once; got {shown(list(values))}")
        for config in self.cells().values():
            if config.teacher is not None:
                raise ValueError(f"a sweep has no teachers; got teacher {shown(config.teacher)}")
            load_shift(config.find_game(), self.shift or shift_of(config))

    def cells(self) -> dict[Cell, Config]:
        """The settings of each combination, but for the seed."""
        names = list(self.axes)
        return {
            values: changed(self.base, dict(zip(names, values, strict=True)))
            for values in itertools.product(*self.axes.values())
        }

    def columns(self) -> list[str]:
        """What the axes are called in tables, where episodes have a variant, and shares levels."""
        return [f"training_{name}" if name in ("levels", "variant") else name for name in self.axes]


def axes(texts: Sequence[str]) -> dict[str, list[Any]]:
    """Settings and their values from texts as lr=1e-4,5e-4 and variant.region=1,3,5.

    Raises ValueError where one is none.
    """
    found: dict[str, list[Any]] = {}
    for text in texts:
        name, is_set, values = text.partition("=")
        name = SHORT.get(name, name)
        if not is_set or not values or name in found:
            raise ValueError(
                f"a sweep must set NAME=VALUE,VALUE,... once for each name; got {text!r}"
            )
        found[name] = [value(part) for part in values.split(",")]
    return found


def value(text: str) -> Any:
    """A number or a truth where the text is one, else the text."""
    try:
        found = json.loads(text.lower())
    except (ValueError, RecursionError):
        return text
    return text if isinstance(found, str | list | dict) else found


def changed(base: Config, values: Mapping[str, Any]) -> Config:
    """The settings with some of them, and some knobs of the variant, changed.

    Raises ValueError where there is no such setting or knob, or it cannot be that.
    """
    known = [name for name in Config.names() if name not in ("knobs", "seed")]
    settings, knobs = {}, dict(base.knobs)
    for name, given in values.items():
        if name.startswith(KNOB):
            knobs[name.removeprefix(KNOB)] = given
        elif name in known:
            settings[name] = given
        else:
            raise ValueError(
                f"unknown setting {name!r}; there are: {', '.join(known)}, and {KNOB}KNOB"
            )
    return base.changed(knobs=knobs, **settings)
