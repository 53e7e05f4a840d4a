"""Parts of a training's settings: the sampler of levels, and how it is computed; their checks."""

from __future__ import annotations

import types
import typing
from dataclasses import dataclass
from math import inf, isfinite
from typing import Annotated, Any, Literal

from tyro.conf import arg

from astray import imports
from astray.bounds import MOST, shown
from astray.game import MOST_EDITS, Mutation
from astray.record import LEVELS

KNOB = "variant."  # may stand before the name of a knob, which is not a setting then
MOST_STEPS = 10**15  # what the fastest machine does in a century
SEEDS = 2**27  # every seed has 2**36 streams of its own, and environments take up to 2**63
COUNTS = (
    "levels", "steps", "num_envs", "num_steps", "epochs", "minibatches", "scale", "width",
    "validation_every", "checkpoint_every", "threads", "microbatch", "groups", "buffer", "edits",
    "shifted_levels",
)  # fmt: skip
SHARES = ("gamma", "lam", "reward_gamma", "share", "staleness", "taught")
AMOUNTS = ("learning_rate", "clip", "value_weight", "entropy_weight", "gradient_norm")
RANGES = (
    {name: (1, MOST) for name in COUNTS}
    | {name: (0, 1) for name in SHARES}
    | {name: (0, inf) for name in AMOUNTS}
    | {"replay": (0.01, 1), "temperature": (0.01, 100), "edits": (1, MOST_EDITS)}
    | {"first_level": (0, LEVELS.stop), "seed": (0, SEEDS - 1), "steps": (1, MOST_STEPS)}
)

SAMPLERS = ("uniform", "mixed", "growing", "plr", "accel")  # of levels, astray's own
SCORING = ("plr", "accel")  # those that learn from how an agent did
SAMPLED = {  # whose they are
    "share": ("mixed", "growing"), "shifted_levels": ("mixed",), "replay": SCORING,
}  # fmt: skip
Schedule = Literal["throughout", "early", "late", "annealed"]
Score = Literal["regret", "max-monte-carlo", "positive-value-loss"]


def otherwise(default: str, text: str | None = None) -> Any:
    """Return how help tells the `default` of an option that is None, and the `text` of its help."""
    return arg(help=text, help_behavior_hint=f"(default: {default})")


@dataclass(frozen=True)
class Sampling:
    """Sampler of training levels.

    Raises ValueError where a setting is of another type, out of its bounds, or of another sampler.
    """

    # Sampler: uniform, mixed, growing, plr, accel, or your own as module:Class.
    kind: Annotated[str, arg(name="sampler")] = "uniform"
    # Chance of an episode to be in a shifted level, as the mean over steps (mixed); part of the
    # steps after which all levels are played (growing).
    share: Annotated[float | None, otherwise("shift_probability; 0.5 for growing")] = None
    schedule: Schedule = "throughout"  # When the shifted levels are played (mixed).
    # Number of shifted levels begun in all, early and late within a share of the steps (mixed).
    shifted_levels: Annotated[int | None, otherwise("as many as the chance comes to")] = None
    buffer: int = 4096  # Number of levels that are kept to be replayed (plr, accel).
    # Chance that a rollout replays levels (plr, accel).
    replay: Annotated[float | None, otherwise("1/3 for plr, 1/2 for accel")] = None
    # Temperature of replay: a level's chance is (1 / rank) ** (1 / temperature) (plr, accel).
    temperature: float = 0.1
    # Part of the chance that is of levels not replayed lately (plr, accel).
    staleness: float = 0.1
    score: Score = "max-monte-carlo"  # Score by which levels are ranked (plr, accel).
    mutation: Mutation = "constant"  # Edits of a level, and how often each is made (accel).
    edits: int = 12  # Number of edits of a level that make another (accel).

    def __post_init__(self) -> None:
        check(self)
        if self.kind not in SAMPLERS and not imports.is_name(self.kind):
            possible = f"{', '.join(SAMPLERS)}, or module:Class"
            raise ValueError(f"sampler must be one of {possible}; got {self.kind!r}")

    def check_kind(self) -> None:
        """Raise ValueError where a setting is one of another sampler."""
        for name, kinds in SAMPLED.items():
            if getattr(self, name) is not None and self.kind in set(SAMPLERS) - set(kinds):
                raise ValueError(
                    f"{name} is for the sampler {' or '.join(kinds)}; got {self.kind!r}"
                )


SUITS = otherwise("what suits the device")


@dataclass(frozen=True)
class Fast:
    """Acceleration: None is what suits the device, as `training.fast` resolves it."""

    # Compute the mlp and its loss by astray's own kernels.
    fused_cpu: Annotated[bool | None, SUITS] = None
    # Compute large products in bfloat16; weights and losses stay float32.
    bfloat16: Annotated[bool | None, SUITS] = None
    # Lay impala's weights and activations out channels last.
    channels_last: Annotated[bool | None, SUITS] = None
    # Compile the network by torch.compile, which fuses small operations.
    compile: Annotated[bool | None, SUITS] = None
    # Run acting and learning as CUDA graphs.
    cudagraphs: Annotated[bool | None, SUITS] = None
    # Number of samples that a network of convolutions sees at once.
    microbatch: Annotated[int | None, SUITS] = None
    # Number of groups of environments: one steps while the device infers for another.
    groups: Annotated[int | None, SUITS] = None

    def __post_init__(self) -> None:
        check(self)


def check(record: Any) -> None:
    """Raise ValueError where a field is not of its declared type, or out of its range.

    Fields that are records of settings themselves have checked themselves.
    """
    for name, kind in typing.get_type_hints(type(record)).items():
        value = getattr(record, name)
        if kind in (Sampling, Fast):
            if not isinstance(value, kind):
                raise ValueError(f"{name} must be a {kind.__name__}; got {shown(value)}")
            continue
        _check_type(name, value, kind)
        low, high = RANGES.get(name, (-inf, inf))
        if name in RANGES and value is not None and not low <= value <= high:
            said = f"at least {low}" if high == inf else f"from {low} to {high}"
            raise ValueError(f"{name} must be {said}; got {shown(value)}")


def _check_type(name: str, value: Any, kind: Any) -> None:
    if typing.get_origin(kind) is Literal:
        if value not in typing.get_args(kind):
            there = ", ".join(typing.get_args(kind))
            raise ValueError(f"unknown {name} {value!r}; there are: {there}")
        return
    parts = typing.get_args(kind) if isinstance(kind, types.UnionType) else (kind,)
    kinds = [typing.get_origin(part) or part for part in parts]
    if float in kinds:
        kinds.append(int)
    if type(value) not in kinds or (type(value) is float and not isfinite(value)):
        raise ValueError(f"{name} must be of type {kinds[0].__name__}; got {shown(value)}")
