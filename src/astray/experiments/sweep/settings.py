"""The settings of a sweep, their values as text, and the plans of its combinations."""

import itertools
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from astray.analysis.outcomes import load_shift
from astray.analysis.runs import LEVELS_PLAYED, shift_of
from astray.experiments.levels import check_tests
from astray.experiments.spec import MOST_AGENTS, Plan, Test
from astray.training.config import Config
from astray.training.settings import KNOB, SEEDS, SHORT, make_plain
from astray.validation import bounded, of_kind, one_of, plain, read_value, shown
from astray.variant import knobs
from astray.world import WorldVariant

TRAINING, TEST = "in training", "in the test"
Cell = tuple[Any, ...]  # a value of each axis


@dataclass(frozen=True)
class Sweep:
    """Settings with values, in all combinations.

    Attributes:
        axes: Setting or variant.KNOB -> its values.
        seeds: Number of agents for each combination.
        levels: Number of levels for each evaluation, the first outside of the training.
        shift: Shift with intended goal and proxies; None for the one of the training.
        longest: Steps after which an episode of an evaluation is truncated; None for no limit.
    """

    base: Config
    axes: Mapping[str, Sequence[Any]]
    seeds: int = 1
    levels: int = LEVELS_PLAYED
    shift: str | None = None
    longest: int | None = None

    def __post_init__(self) -> None:
        make_plain(self, "seeds", "levels", "longest")
        of_kind("axes", self.axes, Mapping)
        for name, values in self.axes.items():
            if not isinstance(values, Iterable) or isinstance(values, str) or name != f"{name}":
                given = shown({name: values})
                raise ValueError(
                    f'axes must be a setting and its values, "width": [8]; got {given}'
                )
        axes = {name: [plain(one) for one in values] for name, values in self.axes.items()}
        object.__setattr__(self, "axes", axes)
        bounded("seeds", self.seeds, 1, SEEDS - self.base.seed)
        bounded("levels", self.levels, 1, MOST_AGENTS * 100)
        count = math.prod(map(len, self.axes.values())) * self.seeds
        if not self.axes or not all(self.axes.values()) or count > MOST_AGENTS:
            given, most = shown(self.axes), f"{MOST_AGENTS:,}"
            raise ValueError(f"a sweep must set something, in 1 to {most} agents; got {given}")
        for name, values in self.axes.items():
            if len({str(value) for value in values}) < len(values):
                raise ValueError(f"{name} must take each value once; got {shown(list(values))}")
        for config in self.cells().values():
            if config.teacher is not None:
                raise ValueError(f"a sweep has no teachers; got teacher {shown(config.teacher)}")
        for plan in self.plans().values():
            check_tests(plan)  # before hours of training, not after

    def cells(self) -> dict[Cell, Config]:
        """Return the settings of each combination, without the seed."""
        return {
            values: changed(self.base, dict(zip(self.axes, values, strict=True)))
            for values in itertools.product(*self.axes.values())
        }

    def plans(self) -> dict[Cell, Plan]:
        """Return the plan of each combination: its agents, played in training and in the test.

        Raises:
            ValueError: If a shift or a level is missing.
        """
        return {cell: self._plan(cell, config) for cell, config in self.cells().items()}

    def _plan(self, cell: Cell, config: Config) -> Plan:
        shift = shift_of(config) if self.shift is None else self.shift
        test = load_shift(config.find_game(), shift).test
        return Plan(
            agents={", ".join(map(str, cell)): config},
            seeds=self.seeds,
            first_seed=self.base.seed,
            tests={TRAINING: Test(config.variant, shift), TEST: Test(test, shift)},
            levels=self.levels,
            first_level=config.unseen_levels.start,
            longest=self.longest,
            differences="",
        )

    def columns(self) -> list[str]:
        """Return the axes' column names, which differ from the columns of episodes and rates."""
        game = self.base.find_game()
        taken = {"levels", "variant", *game.events, *game.measures}
        return [f"training_{name}" if name in taken else name for name in self.axes]

    def varied(self) -> list[str]:
        """Return the columns of the axes with several values; all of them if there is none."""
        both = zip(self.columns(), self.axes.values(), strict=True)
        return [name for name, values in both if len(values) > 1] or self.columns()


def axes(texts: Sequence[str], as_text: Collection[str] = ()) -> dict[str, list[Any]]:
    """Parse settings and knobs with values, such as lr=1e-4,5e-4 and region=1,3,5.

    A knob is named variant.NAME in the result; the texts may leave out `variant.`. Values of the
    knobs `as_text` are text, also of digits.

    Raises:
        ValueError: If a text is invalid.
    """
    found: dict[str, list[Any]] = {}
    for text in texts:
        name, is_set, values = text.partition("=")
        name = SHORT.get(name, name)
        if name and name not in Config.names() and not name.startswith(KNOB):
            name = f"{KNOB}{name}"
        if not is_set or not values or name in found:
            raise ValueError(
                f"a sweep must set NAME=VALUE,VALUE,... once for each name; got {text!r}"
            )
        is_text = name.removeprefix(KNOB) in as_text
        found[name] = [part if is_text else read_value(part) for part in values.split(",")]
    return found


def changed(base: Config, values: Mapping[str, Any]) -> Config:
    """Return a copy with some settings and knobs changed; values may be text.

    Raises:
        ValueError: If there is no such setting or knob, or the value is invalid.
    """
    known = [name for name in Config.names() if name not in ("knobs", "seed")]
    own = base.training_variant()  # of a World, its factory says which knobs there are
    there = [] if isinstance(own, WorldVariant) else list(knobs(type(own)))
    settings, changes = {}, dict(base.knobs)
    for word, given in values.items():
        name, knob = SHORT.get(word, word), word.removeprefix(KNOB)
        if name in known and name not in there:
            settings[name] = read_value(given) if isinstance(given, str) else given
        else:
            if not isinstance(own, WorldVariant):
                one_of("setting or knob", knob, (*known, *there))
            changes[knob] = given
    return base.changed(knobs=changes, **settings)
