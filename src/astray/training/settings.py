"""Nested records of a training's settings, and their checks."""

import functools
import types
import typing
from collections.abc import Mapping
from dataclasses import dataclass
from math import inf
from sys import float_info
from typing import Annotated, Any, Literal

from tyro.conf import arg

from astray import imports
from astray.game import MOST_EDITS, Mutation
from astray.record import LEVELS
from astray.validation import MOST, of_kind, one_of, plain, shown, types_of

KNOB = "variant."  # prefix that marks a name as a knob rather than a setting
SHORT = {"lr": "learning_rate"}  # other names of settings
MOST_STEPS = 10**15  # a century on the fastest machine
SEEDS = 2**27  # every seed has 2**36 streams of its own, and environments take up to 2**63
COUNTS = (
    "levels", "steps", "num_envs", "num_steps", "epochs", "minibatches", "scale", "width",
    "validation_every", "checkpoint_every", "threads", "microbatch", "groups", "buffer", "edits",
    "shifted_levels", "shifted_steps",
)  # fmt: skip
FRACTIONS = ("gamma", "lam", "reward_gamma", "fraction", "staleness", "taught")
RATES = ("learning_rate", "lesson_rate")
AMOUNTS = (*RATES, "clip", "value_weight", "entropy_weight", "gradient_norm")
RANGES = (
    {name: (1, MOST) for name in COUNTS}
    | {name: (0, 1) for name in FRACTIONS}
    | {name: (0, 1e38) for name in AMOUNTS}  # float32 has a little more
    | {"replay": (0.01, 1), "temperature": (0.01, 100), "edits": (1, MOST_EDITS)}
    | {"first_level": (0, LEVELS.stop), "seed": (0, SEEDS - 1), "steps": (1, MOST_STEPS)}
)

SAMPLERS = ("uniform", "mixed", "growing", "plr", "accel")  # astray's own samplers
SCORING = ("plr", "accel")  # samplers that score levels
SAMPLED = {"fraction": ("mixed", "growing")}  # settings -> their samplers
SAMPLED |= dict.fromkeys(("schedule", "shifted_levels", "shifted_steps"), ("mixed",))
SAMPLED |= dict.fromkeys(("buffer", "replay", "temperature", "staleness", "score"), SCORING)
SAMPLED |= dict.fromkeys(("mutation", "edits"), ("accel",))
Schedule = Literal["throughout", "early", "late", "annealed"]
Score = Literal["regret", "max-monte-carlo", "positive-value-loss"]


def otherwise(default: str, text: str | None = None) -> Any:
    """Return the help of an option that is None: its computed `default`, and its `text`."""
    return arg(help=text, help_behavior_hint=f"(default: {default})")


@dataclass(frozen=True)
class Sampling:
    """Sampler of training levels.

    Examples:
        >>> astray.Sampling("mixed", fraction=0.1, schedule="early").fraction
        0.1

    Raises:
        ValueError: If a setting has another type, is out of its bounds, or belongs to another
            sampler.
    """

    # Sampler: uniform, mixed, growing, plr, accel, or your own as module:Class.
    kind: Annotated[str, arg(name="sampler")] = "uniform"
    # Probability that an episode is in a shifted level, as the mean over steps (mixed); fraction of
    # the steps after which all levels are played (growing).
    fraction: Annotated[float | None, otherwise("shift_probability; 0.5 for growing")] = None
    schedule: Schedule = "throughout"  # Time at which shifted levels are played (mixed).
    # Total number of shifted levels begun; early and late use a fraction of the steps (mixed).
    shifted_levels: Annotated[int | None, otherwise("follows from the fraction")] = None
    # Total number of steps played in shifted levels, instead of levels begun (mixed).
    shifted_steps: Annotated[int | None, otherwise("follows from the fraction")] = None
    # Number of levels in the replay buffer; for plr at most that of training levels (plr, accel).
    buffer: int = 4096
    # Probability that a rollout replays levels (plr, accel).
    replay: Annotated[float | None, otherwise("1/3 for plr, 1/2 for accel")] = None
    # Temperature of replay: a level's weight is (1 / rank) ** (1 / temperature) (plr, accel).
    temperature: float = 0.1
    # Fraction of the replay probability that favours levels not replayed lately (plr, accel).
    staleness: float = 0.1
    score: Score = "max-monte-carlo"  # Score by which levels are ranked (plr, accel).
    mutation: Mutation = "constant"  # Kind of edits to levels (accel).
    edits: int = 12  # Number of edits that turn a level into a new one (accel).

    def __post_init__(self) -> None:
        check(self)
        if self.kind not in SAMPLERS and not imports.is_name(self.kind):
            possible = f"{', '.join(SAMPLERS)}, or module:Class"
            raise ValueError(f"sampler must be one of {possible}; got {self.kind!r}")

    def check_kind(self) -> None:
        """Raise ValueError if a setting belongs to another sampler."""
        for name, its in SAMPLED.items():
            if getattr(self, name) != getattr(Sampling, name) and self.kind in {*SAMPLERS} - {*its}:
                raise ValueError(f"{name} is for the sampler {' or '.join(its)}; got {self.kind!r}")


SUITS = otherwise("depends on the device")


@dataclass(frozen=True)
class Fast:
    """Acceleration. None means whatever suits the device, as resolved by `training.fast`."""

    # Compute the mlp and its loss with astray's compiled kernels.
    fused_cpu: Annotated[bool | None, SUITS] = None
    # Compute large products in bfloat16; weights and losses stay float32.
    bfloat16: Annotated[bool | None, SUITS] = None
    # Store impala's weights and activations channels-last.
    channels_last: Annotated[bool | None, SUITS] = None
    # Compile the network with torch.compile, which fuses small operations.
    compile: Annotated[bool | None, SUITS] = None
    # Run acting and learning as CUDA graphs.
    cudagraphs: Annotated[bool | None, SUITS] = None
    # Number of samples per forward pass of a convolutional network.
    microbatch: Annotated[int | None, SUITS] = None
    # Number of groups of environments: one group steps while the network acts for another.
    groups: Annotated[int | None, SUITS] = None

    def __post_init__(self) -> None:
        check(self)


def make_plain(record: Any, *names: str) -> None:
    """Make NumPy's numbers Python's in fields of a frozen record, also those by name in a field."""
    for name in names:
        by_name = isinstance(given := getattr(record, name), Mapping)
        told = {key: plain(one) for key, one in given.items()} if by_name else plain(given)
        object.__setattr__(record, name, told)


def check(record: Any) -> None:
    """Make NumPy's numbers Python's; raise ValueError for a field of wrong type or out of range."""
    for name, kind in types_of(type(record)).items():
        object.__setattr__(record, name, value := plain(getattr(record, name)))
        if kind in (Sampling, Fast):
            of_kind(name, value, kind)
            continue
        _check_type(name, value, kind)
        low, high = RANGES.get(name, (-inf, inf))
        if name in RANGES and value is not None and not low <= value <= high:
            raise ValueError(f"{name} must be from {low} to {high}; got {shown(value)}")


@functools.cache
def _kinds(kind: Any) -> tuple[type, ...]:
    """Return the types that values of an annotated type may have, none for a Literal."""
    if typing.get_origin(kind) is Literal:
        return ()
    parts = typing.get_args(kind) if isinstance(kind, types.UnionType) else (kind,)
    kinds = tuple(typing.get_origin(part) or part for part in parts)
    return (*kinds, int) if float in kinds else kinds


def _check_type(name: str, value: Any, kind: Any) -> None:
    if not (kinds := _kinds(kind)):
        one_of(name, value, kind)
        return
    is_number = type(value) in (int, float)  # as which none of 400 digits counts
    if type(value) not in kinds or (is_number and not abs(value) <= float_info.max):
        finite = ", finite" * (is_number and type(value) in kinds)
        raise ValueError(f"{name} must be of type {kinds[0].__name__}{finite}; got {shown(value)}")
