"""What an experiment is: data."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from astray.analysis.outcomes import OUTCOMES, load_shift
from astray.training.config import Config

Size = Literal["smoke", "hour", "paper"]
SIZES: tuple[Size, ...] = get_args(Size)


@dataclass(frozen=True)
class Plan:
    """One size of an experiment."""

    config: Config  # of every agent but for its seed
    seeds: int  # agents
    levels: int  # played by every agent in each variant, none met in training under any number
    shift: str  # of the game: where the agents are trained and tested
    smaller: str  # what is smaller than in the paper

    def __post_init__(self) -> None:
        shift, trained = load_shift(self.config.game, self.shift), self.config.variant
        if shift.train != trained:
            raise ValueError(f"shift {self.shift!r} trains on {shift.train!r}, not on {trained!r}")
        if self.seeds < 1:
            raise ValueError(f"seeds is {self.seeds}; it is at least 1")
        if not 1 <= self.levels <= len(self.config.unseen_levels):
            raise ValueError(
                f"levels is {self.levels}; it is from 1 to {len(self.config.unseen_levels)}"
            )


@dataclass(frozen=True)
class Claim:
    """Something that should be true, with the band in which it counts as true.

    The share of episodes with `outcome` in the variant `where`, less the share with `minus`:
    the claim holds where the 95 % interval lies above `above`.
    """

    text: str
    where: Literal["train", "test"]
    outcome: str
    above: float
    minus: str | None = None
    paper: str = "not stated"  # the paper's figure

    def __post_init__(self) -> None:
        for name, given, there in (
            ("where", self.where, ("train", "test")),
            ("outcome", self.outcome, OUTCOMES),
            ("minus", self.minus, (None, *OUTCOMES)),
        ):
            if given not in there:
                raise ValueError(
                    f"unknown {name} {given!r} of a claim; there are: {', '.join(map(str, there))}"
                )
        if not -1 <= self.above <= 1:
            raise ValueError(f"above is {self.above}; it is from -1 to 1")


@dataclass(frozen=True)
class Experiment:
    """Agents trained on a shift's training variant, and what they do on its test variant."""

    title: str
    reproduces: str
    question: str
    sizes: Mapping[Size, Plan]
    claims: Sequence[Claim]

    def __post_init__(self) -> None:
        wrong = [size for size in self.sizes if size not in SIZES]
        if wrong or not self.sizes:
            raise ValueError(f"sizes are {list(self.sizes)}; they are some of {', '.join(SIZES)}")


@dataclass(frozen=True)
class Study:
    """An experiment that trains nothing: it is computed anew each time."""

    title: str
    reproduces: str
    question: str
    sizes: Mapping[Size, Any]  # what `tell` needs to know of each size
    tell: Callable[[Study, str, Size, Path], Path]  # (itself, name, size, folder) -> the report
