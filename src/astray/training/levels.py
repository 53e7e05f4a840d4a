"""Samplers: which level comes next in a training.

With "uniform" there is no sampler: the environments draw their levels themselves.
`training.replay` has the samplers that search for levels to learn from.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np

from astray.envs.beginnings import in_chunks
from astray.envs.loops import SHIFT
from astray.kernel.rng import fill_fractions
from astray.memory import check_memory
from astray.record import trusted
from astray.training.config import Config
from astray.training.settings import Schedule
from astray.validation import of_kind

SALT = 0x1E7E15  # salt of a sampler's random numbers
FIRST = 0.1  # fraction of the levels that `Growing` begins with
GROWS = 0.5  # default fraction of a training in which `Growing` adds levels
Arrays = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Plan:
    """Purpose of the next rollout.

    Attributes:
        learn: The network learns from it; otherwise it only scores levels.
        restart: Every environment begins a new level with it, as with the first plan of all.
        repeat: Every environment repeats one level until the next plan.
    """

    learn: bool = True
    restart: bool = False
    repeat: bool = False

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            of_kind(f"a plan's {name}", value, bool)


@dataclass(frozen=True, eq=False)
class Played:
    """Results of a rollout, [T, N]; environment i is place i of `Sampler.next`.

    Attributes:
        reward: float64, in game points.
        advantage: float32, generalised advantage estimates of normalised rewards.
        terminated: bool, the episode ended with this step.
        truncated: bool, its time was up.
    """

    reward: np.ndarray
    advantage: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray


@runtime_checkable
class Sampler(Protocol):
    """Source of training levels, which is informed of the results in them.

    A sampler is a class whose only argument is the training's `Config`: pass it as `train(config,
    folder, sampler=Mine)` or `--sampler my_package.levels:Mine`. Its draws must depend only on
    that and on `arrays`, so that a resumed training is the same.

    Examples:
        >>> from astray.training.levels import Growing
        >>> config = astray.Config("maze", "anywhere-small", levels=300, sampler="growing")
        >>> Growing(config).next(np.arange(2)).shape
        (2,)
    """

    def plan(self, steps: int) -> Plan:
        """Plan the next rollout, after `steps` environment steps of training."""
        ...

    def next(self, places: np.ndarray) -> np.ndarray:
        """Return the next levels of environments `places` [k]: numbers [k] int64 or states [k]."""
        ...

    def note(self, played: Played) -> None:
        """Record the results of the planned rollout."""
        ...

    def summary(self) -> dict[str, float]:
        """Return the values to log after every iteration."""
        ...

    def arrays(self) -> dict[str, np.ndarray]:
        """Return its state for a checkpoint; names, shapes and dtypes never change."""
        ...

    def restore(self, arrays: Arrays) -> None:
        """Continue from the result of `arrays`; raise ValueError if it is invalid."""
        ...


MakeSampler = Callable[[Config], Sampler]


def stream(config: Config, turn: int) -> np.random.Generator:
    """Return the random generator of draw `turn`, so that a checkpoint stores only the turn."""
    return np.random.default_rng([config.seed, SALT, turn])


def discounted_returns(
    reward: np.ndarray, ended: np.ndarray, gamma: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return each environment's mean and largest discounted episode return, both [N].

    Unfinished episodes count only in environments where no episode ended.

    Args:
        reward: [T, N], from a rollout in which every environment began a new episode.
        ended: [T, N] bool.
    """
    steps, n = reward.shape
    running, factor = np.zeros(n), np.ones(n)
    total, count, best = np.zeros(n), np.zeros(n), np.full(n, -np.inf)
    for t in range(steps):
        running += factor * reward[t]
        factor *= gamma
        over = ended[t] | ((count == 0) & (t == steps - 1))
        total += over * running
        count += over
        best = np.where(over, np.maximum(best, running), best)
        running[over], factor[over] = 0.0, 1.0
    return total / count, best


def positive_value_loss(advantage: np.ndarray) -> np.ndarray:
    """Return each environment's mean of max(advantage, 0), [T, N] -> [N].

    It is the gain that the critic did not expect (Jiang et al., "Replay-Guided Adversarial
    Environment Design", 2021).
    """
    return np.maximum(advantage, 0).mean(0, dtype=np.float64)


def part_at(schedule: Schedule, fraction: float, progress: float) -> float:
    """Return the part of the shifted levels begun by `progress`, 0 to 1, of a training.

    Early and late they fill the `fraction` of the training; annealed, they get fewer to its end.
    """
    if schedule == "early":
        return min(progress / fraction, 1.0)
    if schedule == "late":
        return max(1 - (1 - progress) / fraction, 0.0)
    return 1 - (1 - progress) ** 2 if schedule == "annealed" else progress


class Mixed:
    """Sampler that mixes in shifted levels, at a rate that depends on time.

    The variant's shift_probability decides which numbers are shifted levels, so all schedules
    share them. Early in training episodes are long, so equal fractions of the time contain fewer
    shifted levels. Set `shifted_levels` to begin the same number of them under every schedule:
    those due in a rollout then come first in it. Set `shifted_steps` to play as many steps in them:
    then as many environments at once play shifted levels as the steps due in a rollout need, and
    what their last episodes play too much is played less later.
    """

    def __init__(self, config: Config):
        stock = config.training_variant().shift_probability
        if not 0 < stock < 1:
            raise ValueError(
                "sampler 'mixed' needs a variant some of whose levels are shifted: "
                f"shift_probability must be between 0 and 1; got {stock}"
            )
        self.config = config
        self.fraction = stock if config.sampler.fraction is None else config.sampler.fraction
        doses = {x: getattr(config.sampler, x) for x in ("shifted_levels", "shifted_steps")}
        given = [name for name, dose in doses.items() if dose is not None]
        if len(given) > 1:
            raise ValueError(f"the shifted levels are either counted or their steps; got {doses}")
        if not self.fraction and given:
            raise ValueError(f"{given[0]} needs a fraction above 0; got 0")
        self.dose = doses[given[0]] if given else None
        self.in_steps = "shifted_steps" in given
        if config.sampler.schedule == "annealed" and self.fraction > 0.5:
            raise ValueError(f"fraction must be at most 0.5 to be annealed; got {self.fraction}")
        check_memory(10 * config.levels, f"{config.levels:,} training levels")
        fractions = np.empty(config.levels)
        fill_fractions(config.first_level, SHIFT, fractions)
        self.is_shifted = fractions < stock
        self.shifted = config.first_level + np.flatnonzero(self.is_shifted)
        if not 0 < len(self.shifted) < config.levels:
            raise ValueError(
                f"{len(self.shifted)} of {config.levels:,} training levels are shifted; some must "
                "be, and some not"
            )
        self.turn, self.now, self.due = 0, 0.0, 0
        self.begun = np.zeros(2, np.int64)  # numbers of levels: all, shifted
        self.played = np.zeros(1, np.int64)  # steps in shifted levels
        # For each environment, whether its levels are shifted: that of the last rollout's end, and
        # those begun since.
        self.inside: list[list[bool]] = [[False] for _ in range(config.num_envs)]

    def plan(self, steps: int) -> Plan:
        config, schedule = self.config, self.config.sampler.schedule
        now, then = steps / config.steps, min((steps + config.batch) / config.steps, 1.0)
        if self.dose is not None:
            self.due = round(part_at(schedule, self.fraction, then) * self.dose)
        elif self.fraction and now < 1:  # the mean over the rollout, which may be partly early
            parts = [part_at(schedule, self.fraction, progress) for progress in (now, then)]
            self.now = self.fraction * (parts[1] - parts[0]) / (then - now)
        return Plan(restart=not self.begun[0])

    def next(self, places: np.ndarray) -> np.ndarray:
        random, first = stream(self.config, self.turn), self.config.first_level
        self.turn += 1
        if self.dose is None:
            is_shifted = random.random(len(places)) < self.now
        else:
            is_shifted = random.permutation(len(places)) < self._wanted(places)
        numbers = random.integers(first, first + self.config.levels, len(places))
        while (wrong := ~is_shifted & self.is_shifted[numbers - first]).any():
            numbers[wrong] = random.integers(first, first + self.config.levels, wrong.sum())
        drawn = random.integers(len(self.shifted), size=len(places))
        numbers[is_shifted] = self.shifted[drawn[is_shifted]]
        self.begun += len(places), is_shifted.sum()
        for place, one in zip(places, is_shifted, strict=True):
            self.inside[place].append(bool(one))
        return numbers

    def _wanted(self, places: np.ndarray) -> int:
        """Return how many shifted levels are due in environments whose last level has ended."""
        if not self.in_steps:
            return self.due - self.begun[1]
        at_once = -(-(self.due - self.played[0]) // self.config.num_steps)
        others = set(range(len(self.inside))).difference(places.tolist())
        return at_once - sum(self.inside[i][-1] for i in others)

    def note(self, played: Played) -> None:
        """Count the steps in shifted levels."""
        ended = played.terminated | played.truncated
        for i, inside in enumerate(self.inside):
            lengths = np.diff(np.flatnonzero(ended[:, i]), prepend=-1, append=len(ended) - 1)
            # A restart before the rollout leaves a level of which no step was played.
            self.played += lengths @ inside[-len(lengths) :]
            self.inside[i] = inside[-1:]

    def summary(self) -> dict[str, float]:
        begun, shifted = map(float, self.begun)
        told = {"begun": begun, "shifted": shifted, "shifted_fraction": shifted / begun}
        return told | ({"shifted_steps": float(self.played[0])} if self.in_steps else {})

    def arrays(self) -> dict[str, np.ndarray]:
        kept = {"turn": np.array([self.turn]), "begun": self.begun}
        inside = np.array([levels[-1] for levels in self.inside])
        return kept | ({"played": self.played, "inside": inside} if self.in_steps else {})

    def restore(self, arrays: Arrays) -> None:
        self.turn, self.begun = int(arrays["turn"][0]), arrays["begun"].copy()
        if self.turn < 0 or not 0 <= self.begun[1] <= self.begun[0]:
            raise ValueError(f"its sampler began {self.begun} levels in {self.turn} turns")
        if self.in_steps:
            self.played = arrays["played"].copy()
            self.inside = [[bool(shifted)] for shifted in arrays["inside"]]
            if self.played[0] < 0:
                raise ValueError(f"its sampler played {self.played[0]} steps in shifted levels")


class Growing:
    """Curriculum from the smallest levels to all levels.

    The size of a level is the number of cells that its agent can reach. The fraction of levels in
    use grows linearly from `FIRST` to 1 during `fraction` of the steps. From then on all levels are
    equally likely, as without a sampler.
    """

    def __init__(self, config: Config):
        self.config, game = config, config.find_game()
        self.fraction = GROWS if config.sampler.fraction is None else config.sampler.fraction
        reachable, numbers = game.solver.reachable, np.array(config.training_levels)
        check_memory(17 * len(numbers), f"{len(numbers):,} training levels")
        begun = in_chunks(game, config.training_variant(), numbers)
        sizes = np.array([reachable(s).sum() for states in begun for s in trusted(states)])
        self.by_size = numbers[np.argsort(sizes, kind="stable")]
        self.turn, self.count = 0, len(numbers)

    def plan(self, steps: int) -> Plan:
        progress = steps / self.config.steps
        part = FIRST + (1 - FIRST) * progress / self.fraction if progress < self.fraction else 1.0
        self.count = max(round(part * len(self.by_size)), 1)
        return Plan(restart=not self.turn)

    def next(self, places: np.ndarray) -> np.ndarray:
        random = stream(self.config, self.turn)
        self.turn += 1
        return self.by_size[random.integers(self.count, size=len(places))]

    def note(self, played: Played) -> None:
        """Ignore the results: they do not affect the next levels."""

    def summary(self) -> dict[str, float]:
        return {"part": self.count / len(self.by_size)}

    def arrays(self) -> dict[str, np.ndarray]:
        return {"turn": np.array([self.turn])}

    def restore(self, arrays: Arrays) -> None:
        self.turn = int(arrays["turn"][0])
        if self.turn < 0:
            raise ValueError(f"its sampler was asked {self.turn} times")
