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


@dataclass(frozen=True)
class Sampling:
    """Sampler of training levels.

    Raises ValueError where a setting is of another type, out of its bounds, or of another sampler.
    """

    # Sampler of training levels: uniform, mixed, growing, plr, accel, or your own as module:Class.
    kind: Annotated[str, arg(name="sampler")] = "uniform"
    # Chance of an episode to be in a shifted level, as the mean over environment steps (mixed;
    # default: the variant's shift_probability); or the part of the steps after which all levels
    # are played (growing; default: 0.5).
    share: float | None = None
    schedule: Schedule = "throughout"  # When the shifted levels are played (mixed only).
    # Number of shifted levels that are begun in all, early and late within a share of the steps
    # (mixed only; default: as many as the chance comes to).
    shifted_levels: int | None = None
    buffer: int = 4096  # Number of levels that are kept to be replayed (plr and accel only).
    # Chance that a rollout replays levels (default: 1/3 for plr, 1/2 for accel).
    replay: float | None = None
    # Temperature of replay: a level's chance is (1 / rank) ** (1 / temperature) (plr, accel).
    temperature: float = 0.1
    # Part of the chance that is of levels not replayed lately (plr and accel only).
    staleness: float = 0.1
    score: Score = "max-monte-carlo"  # Score by which levels are ranked (plr and accel only).
    mutation: Mutation = "constant"  # Edits of a level, and how often each is made (accel only).
    edits: int = 12  # Number of edits of a level that make another (accel only).

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


@dataclass(frozen=True)
class Fast:
    """Acceleration: None is what suits the device, as `training.fast` resolves it."""

    # Compute the mlp and its loss by astray's own kernels (CPU only; default: where they suit).
    fused_cpu: bool | None = None
    # Compute large products in bfloat16; weights and losses stay float32 (default: where it suits).
    bfloat16: bool | None = None
    # Lay impala's weights and activations out channels last (default: where it suits).
    channels_last: bool | None = None
    # Compile the network by torch.compile, which fuses small operations (default: where it suits).
    compile: bool | None = None
    # Run acting and learning as CUDA graphs (default: where it suits).
    cudagraphs: bool | None = None
    # Number of samples that a network of convolutions sees at once (default: what suits it).
    microbatch: int | None = None
    # Number of groups of environments: one steps while the device infers for another (default:
    # what suits the device).
    groups: int | None = None

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
