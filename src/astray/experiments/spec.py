"""What an experiment is: data."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, get_args

from astray.training.config import Config

Size = Literal["smoke", "hour", "paper"]
SIZES: tuple[Size, ...] = get_args(Size)


@dataclass(frozen=True)
class Plan:
    """One size of an experiment."""

    config: Config  # of every agent but for its seed
    seeds: int  # agents
    levels: int  # played by every agent in each variant, none of them seen in training
    shift: str  # of the game: where the agents are trained and tested
    smaller: str  # what is smaller than in the paper


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


@dataclass(frozen=True)
class Experiment:
    """Agents trained on a shift's training variant, and what they do on its test variant."""

    title: str
    reproduces: str
    question: str
    sizes: Mapping[Size, Plan]
    claims: Sequence[Claim]
