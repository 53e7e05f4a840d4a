"""All settings of a training."""

from __future__ import annotations

import contextlib
import itertools
import json
import types
import typing
from collections.abc import Mapping
from dataclasses import MISSING, asdict, dataclass, field, fields, replace
from math import inf, isfinite
from typing import Annotated, Any, Literal

from tyro.conf import Positional, Suppress

from astray import games, imports
from astray.agents.names import check_network, renamed_network
from astray.bounds import MOST, shown
from astray.game import MOST_EDITS, OWN, Game, Mutation, Variant
from astray.record import LEVELS

# Settings as older run folders have them, and what they are called now.
RENAMED = {
    "environments": "num_envs",
    "rollout": "num_steps",
    "kernels": "fused_cpu",
    "compiled": "compile",
    "graphs": "cudagraphs",
}
MOST_STEPS = 10**15  # what the fastest machine does in a century
SEEDS = 2**28  # every seed has streams of its own for training, validation, ...
COUNTS = (
    "levels", "steps", "num_envs", "num_steps", "epochs", "minibatches", "scale", "width",
    "validation_every", "checkpoint_every", "threads", "microbatch", "groups", "buffer", "edits",
    "shifted_levels",
)  # fmt: skip
SHARES = ("gamma", "lam", "reward_gamma", "share", "staleness")
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
Tracking = Literal["wandb", "trackio"]  # who else is told of a training
Schedule = Literal["throughout", "early", "late", "annealed"]
Score = Literal["regret", "max-monte-carlo", "positive-value-loss"]


@dataclass(frozen=True)
class Config:
    """PPO's settings. The defaults are the `paper` preset.

    Where the paper's text and its code differ, the defaults follow what was run: minibatches of
    8,192 (the text has 2,048, for each of 4 workers), a learning rate annealed linearly to 0,
    rewards normalised with a discount of their own. One departure: an episode cut by the time
    limit is bootstrapped; `timeouts="terminate"` is the original's treatment.

    Raises ValueError where a setting is of another type, out of its bounds or at odds with others.
    """

    game: Positional[str] = "maze"
    variant: Positional[str] = "corner"  # to train on
    # Of the variant, changed.
    knobs: Annotated[dict[str, Any], Suppress] = field(default_factory=dict)
    validation: str | None = None  # a variant played during training, never learned from
    first_level: int = 0
    levels: int = 100_000  # training levels, from first_level on; validation draws from the rest
    seed: int = 0

    sampler: str = "uniform"  # of levels: or mixed, growing, plr, accel; or your own, module:Class
    # Mixed: the chance of an episode to be in a shifted level, as the mean over environment steps;
    # None: shift_probability. Growing: the part of the steps after which all levels are played.
    share: float | None = None
    schedule: Schedule = "throughout"  # mixed: when the shifted levels are played
    # Mixed: how many shifted levels are begun in all, `early` and `late` within a `share` of the
    # steps; None: as many as the chance comes to.
    shifted_levels: int | None = None
    buffer: int = 4096  # plr, accel: levels that are kept, to be replayed
    replay: float | None = None  # plr, accel: chance that a rollout replays; None: 1/3 and 1/2
    temperature: float = 0.1  # plr, accel: a level's chance is (1 / its rank) ** (1 / temperature)
    staleness: float = 0.1  # plr, accel: share of the chance that is for levels not replayed lately
    score: Score = "max-monte-carlo"  # plr, accel: by which levels are ranked
    mutation: Mutation = "constant"  # accel: what is edited, and how often
    edits: int = 12  # accel: of a level, to make another

    observation: Literal["image", "symbolic"] = "image"
    art: str = OWN  # that images are drawn with; "original" has to be imported: astray art import
    network: str = "impala"  # or another for images; mlp, for symbols; your own, module:Class
    scale: int = 1  # of the channels of convolutions; the paper's sweeps have 4
    width: int = 64  # hidden units of the mlp

    steps: int = 200_000_000  # environment steps, over all environments
    num_envs: int = 256
    num_steps: int = 256  # steps of each environment between updates
    epochs: int = 3  # passes over a rollout
    minibatches: int = 8  # per epoch: 256 x 256 / 8 = 8,192 samples
    gamma: float = 0.999
    lam: float = 0.95
    learning_rate: float = 5e-4
    anneal: bool = True  # the learning rate, linearly to 0
    clip: float = 0.2  # of the probability ratio, and of the value (in normalised rewards)
    value_weight: float = 0.5
    entropy_weight: float = 0.01
    gradient_norm: float = 0.5  # largest, over all parameters
    normalise_reward: bool = True
    reward_gamma: float = 0.99  # of the returns whose deviation rewards are divided by
    normalise_advantage: bool = True  # over the whole rollout
    timeouts: Literal["bootstrap", "terminate"] = "bootstrap"
    loss: str | None = None  # your own, module:function, in the place of ppo.loss
    teacher: str | None = None  # what the agent is called that this one is distilled from

    validation_every: int = 1  # iterations
    checkpoint_every: int = 25  # iterations
    device: Literal["cpu", "cuda", "mps"] = "cpu"
    threads: int = 1  # that step environments; and, on a CPU, that torch uses

    # How it is computed; None is what suits the device, as `training.fast` resolves it.
    fused_cpu: bool | None = None  # our own kernels for the mlp and the loss, on a CPU
    bfloat16: bool | None = None  # for the large products; weights and losses stay float32
    channels_last: bool | None = None  # the layout of impala's weights and activations
    compile: bool | None = None  # by torch.compile, which fuses what is between the products
    cudagraphs: bool | None = None  # acting and learning from a minibatch are each a CUDA graph
    microbatch: int | None = None  # samples that a network of convolutions sees at once
    groups: int | None = None  # of environments: one steps while the device infers for another

    def __post_init__(self) -> None:
        for name, kind in typing.get_type_hints(Config).items():
            _check(name, getattr(self, name), kind)
        for name, (low, high) in RANGES.items():
            value = getattr(self, name)
            if value is not None and not low <= value <= high:
                said = f"at least {low}" if high == inf else f"from {low} to {high}"
                raise ValueError(f"{name} must be {said}; got {shown(value)}")
        if self.batch % self.minibatches:
            raise ValueError(
                f"{self.num_envs} environments x {self.num_steps} steps = {self.batch} samples "
                f"are not divided by {self.minibatches} minibatches"
            )
        if self.groups and self.num_envs % self.groups:
            raise ValueError(
                f"{self.num_envs} environments are not divided into {self.groups} groups"
            )
        if self.training_levels.stop >= LEVELS.stop:
            raise ValueError(
                f"training levels must be below {LEVELS.stop - 1}, as some are left for tests; "
                f"got {self.first_level} to {self.training_levels.stop - 1}"
            )
        check_network(self.network)
        if self.sampler not in SAMPLERS and not imports.is_name(self.sampler):
            possible = f"{', '.join(SAMPLERS)}, or module:Class"
            raise ValueError(f"sampler must be one of {possible}; got {self.sampler!r}")
        if self.teacher is not None and self.sampler in SCORING:
            raise ValueError(
                f"a student is not scored: its sampler must be another; got {self.sampler!r}"
            )
        if self.teacher is not None and (self.groups or 1) > 1:
            raise ValueError(f"a student's environments are one group; got {self.groups} groups")
        if self.loss is not None and not imports.is_name(self.loss):
            raise ValueError(f"loss must be module:function; got {self.loss!r}")
        variant = self.training_variant()
        # What text says is the same setting as the value itself.
        object.__setattr__(self, "knobs", {name: getattr(variant, name) for name in self.knobs})
        self.find_game().drawn(self.art)
        if self.validation is not None:
            self.validation_variant()

    @property
    def batch(self) -> int:
        """Samples per iteration."""
        return self.num_envs * self.num_steps

    @property
    def iterations(self) -> int:
        return -(-self.steps // self.batch)

    @property
    def milestones(self) -> list[int]:
        """Steps whose agents are kept: ten evenly spaced, and before the first, ever doubling."""
        return [self.steps >> k for k in range(8, 3, -1)] + [
            self.steps * k // 10 for k in range(1, 11)
        ]

    @property
    def training_levels(self) -> range:
        return range(self.first_level, self.first_level + self.levels)

    @property
    def unseen_levels(self) -> range:
        """All numbers after the training levels."""
        return range(self.training_levels.stop, LEVELS.stop)

    def find_game(self) -> Game:
        """The game that is played."""
        return games.find(self.game)

    def training_variant(self) -> Variant:
        """The variant to train on."""
        return self.variant_for(self.variant)

    def intended_goal(self) -> str:
        """The goal that the shifts of the training variant mean.

        Raises ValueError where none of the game's shifts has the variant.
        """
        shifts = self.find_game().shifts.values()
        for shift in shifts:
            if self.variant in (shift.train, shift.test):
                return shift.intended
        known = ", ".join(dict.fromkeys(shift.train for shift in shifts))
        raise ValueError(
            f"score 'regret' needs a variant of which a shift says the goal; got {self.variant!r}, "
            f"and there are: {known}"
        )

    def validation_variant(self) -> Variant:
        """The variant that is played during training and never learned from."""
        assert self.validation is not None
        return self.variant_for(self.validation)

    def variant_for(self, name: str, changes: Mapping[str, Any] | None = None) -> Variant:
        """The variant of that name for these agents, and some more `changes` of its knobs.

        Its knobs are changed as those of the training variant were, where the two were alike; but
        those that it cannot have, as a region where cheese is anywhere, change the training alone.

        Raises ValueError where it cannot have `changes`.
        """
        return self.find_game().variant(name).with_knobs(self.knobs_for(name, changes or {}))

    def knobs_for(self, name: str, changes: Mapping[str, Any]) -> dict[str, Any]:
        """What `variant_for` changes: `changes`, and as many of the training's as go with them."""
        if name == self.variant:
            return {**self.knobs, **changes}
        game = self.find_game()
        other = game.variant(name)
        kept = game.variant(self.variant).alike(self.knobs, other)
        for count in range(len(kept), 0, -1):
            for some in itertools.combinations(kept.items(), count):
                with contextlib.suppress(ValueError):
                    other.with_knobs({**dict(some), **changes})
                    return {**dict(some), **changes}
        return dict(changes)

    def to_json(self) -> dict[str, Any]:
        """All settings, and the variant written out."""
        return asdict(self) | {"training_variant": asdict(self.training_variant())}

    @staticmethod
    def from_json(data: Any) -> Config:
        """The settings that `to_json` wrote, also those of older versions; ValueError else."""
        if not isinstance(data, dict):
            raise ValueError(f"settings must be an object; got {shown(data)}")
        known = [f.name for f in fields(Config)]
        values = {name: value for name, value in data.items() if name != "training_variant"}
        for old, new in RENAMED.items():
            if old in values:
                values[new] = values.pop(old)
        values["network"] = renamed_network(values.get("network", Config.network))
        unknown = [name for name in values if name not in known]
        if unknown:
            raise ValueError(f"this version has no setting {unknown[0]!r}; a later one may")
        config = Config(**values)
        now = config.training_variant()
        variant = json.loads(json.dumps(asdict(now)))
        told = _with_later_knobs(data.get("training_variant", variant), now)
        if _levels_of(told) != _levels_of(variant):
            raise ValueError(f"its {config.game} {config.variant} is not that of this version")
        return config


def _with_later_knobs(told: Any, now: Variant) -> Any:
    """A variant, written out by this version or an older one: what that lacked has its default."""
    if not isinstance(told, dict):
        return told
    later = {f.name: f.default for f in fields(now) if f.default is not MISSING}
    if told.get("shifted") is not None and now.shifted is not None:
        told = told | {"shifted": _with_later_knobs(told["shifted"], now.shifted)}
    return later | told


def _levels_of(variant: Any) -> Any:
    """What of a variant, written out, decides its levels: what it never shifts to does not."""
    if isinstance(variant, dict) and variant.get("shift_probability") == 0:
        return variant | {"shifted": None}
    return variant


def _check(name: str, value: Any, kind: Any) -> None:
    """ValueError where `value` is not of the type that the setting is declared with."""
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


# For a CPU. One thread a run is steadier than two, and two runs at once do more than one with two
# threads. Many small updates of a wide network learned more in the same minutes than few large
# ones or convolutions.
SMALL = Config(
    observation="symbolic",
    network="mlp",
    width=256,
    steps=5_500_000,
    num_steps=64,
    minibatches=16,
    gamma=0.98,
    entropy_weight=0.003,
    validation_every=10,
    checkpoint_every=50,
)
PRESETS = {
    "paper": Config(),
    "small": SMALL,
    # The paper's images, by a network of few products; updates are as large as they need be, and
    # four times as many: mice learn from half the steps.
    "pixels": replace(
        SMALL,
        observation="image",
        network="patch",
        steps=4_000_000,
        num_envs=64,
        validation_every=40,
        checkpoint_every=200,
    ),
}
