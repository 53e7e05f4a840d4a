"""Which level comes next in a training: what a sampler is, and levels mixed with a share.

"uniform" is none of these: then the environments draw their levels themselves, as everywhere.
`training.replay` has those that look for levels to learn from.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from astray.bounds import of_kind
from astray.envs.loops import SHIFT
from astray.envs.vector import GameVectorEnv
from astray.kernel.rng import fill_shares
from astray.memory import check_memory
from astray.record import trusted
from astray.training.config import Config
from astray.training.settings import Schedule

SALT = 0x1E7E15  # of a sampler's draws, beside those of actions and minibatches
FIRST = 0.1  # the part of the levels that is played first, where levels grow
GROWS = 0.5  # the part of a training in which they do, if nothing else is said
MEASURED = 1000  # levels at once
Arrays = Mapping[str, np.ndarray]


@dataclass(frozen=True)
class Plan:
    """What the next rollout is for.

    learn    the network learns from it; else it is played to score levels, and forgotten
    restart  every environment begins a new level with it
    repeat   every environment begins one level and plays it again and again, to the next plan
    """

    learn: bool = True
    restart: bool = False
    repeat: bool = False

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            of_kind(f"a plan's {name}", value, bool)


@dataclass(frozen=True, eq=False)
class Played:
    """How a rollout went, in arrays [T, N]: environment i is place i of `Sampler.next`.

    reward      the game's own, float64
    advantage   generalised advantage estimates, of normalised rewards, float32
    terminated  the episode ended with this step
    truncated   its time was up
    """

    reward: np.ndarray
    advantage: np.ndarray
    terminated: np.ndarray
    truncated: np.ndarray


class Sampler(Protocol):
    """Says which level comes next, and is told what came of it.

    One of your own is a class that is given the training's `Config` and nothing else:
    `train(config, folder, sampler=Mine)`, or `--sampler my_package.levels:Mine`. All that it
    draws must follow from that and from `arrays`, for a training that is resumed to be the same.
    """

    def plan(self, steps: int) -> Plan:
        """What the next rollout is for, after `steps` environment steps were learned from."""
        ...

    def next(self, places: np.ndarray) -> np.ndarray:
        """The levels that the environments `places` [k] begin: numbers [k] int64, or states [k]."""
        ...

    def note(self, played: Played) -> None:
        """Take in how the rollout that was planned last went."""
        ...

    def summary(self) -> dict[str, float]:
        """What is logged of it, after every iteration."""
        ...

    def arrays(self) -> dict[str, np.ndarray]:
        """All that it goes on from, for a checkpoint: always the same names, shapes and types."""
        ...

    def restore(self, arrays: Arrays) -> None:
        """Go on from what `arrays` returned; ValueError where that cannot be."""
        ...


MakeSampler = Callable[[Config], Sampler]


def stream(config: Config, turn: int) -> np.random.Generator:
    """The random numbers of a sampler's draw number `turn`: so a checkpoint only keeps the turn."""
    return np.random.default_rng([config.seed, SALT, turn])


def discounted_returns(
    reward: np.ndarray, ended: np.ndarray, gamma: float
) -> tuple[np.ndarray, np.ndarray]:
    """The mean and the largest discounted return of each environment's episodes, both [N].

    reward, ended  [T, N], of a rollout that every environment began with a new episode

    What an environment did after its last end does not count, as it goes on elsewhere; but where
    no episode ended, the reward so far is its return.
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
    """The mean of the positive advantages, others as 0, of each environment: [T, N] -> [N].

    What the critic did not expect to gain (Jiang et al., "Replay-Guided Adversarial Environment
    Design", 2021).
    """
    return np.maximum(advantage, 0).mean(0, dtype=np.float64)


def share_at(schedule: Schedule, share: float, progress: float) -> float:
    """The share of shifted levels when `progress`, 0 to 1, of a training is done.

    Over the whole training it is `share` on average, whatever the schedule.
    """
    if schedule == "early":
        return float(progress < share)
    if schedule == "late":
        return float(progress >= 1 - share)
    return 2 * share * (1 - progress) if schedule == "annealed" else share


def part_at(schedule: Schedule, share: float, progress: float) -> float:
    """The part of all shifted levels that are begun by then: what `share_at` sums up to, of 1."""
    if schedule == "early":
        return min(progress / share, 1.0)
    if schedule == "late":
        return max(1 - (1 - progress) / share, 0.0)
    return 1 - (1 - progress) ** 2 if schedule == "annealed" else progress


class Mixed:
    """Levels of the training variant, its shifted ones with a share that time decides.

    Which numbers are shifted levels, the variant's shift_probability says, so that with every
    schedule they are the same ones. A share of steps is not one of levels: who has not learned
    yet needs many steps for one. So `shifted_levels` counts them instead, each schedule to the
    same sum: those that are due by the end of a rollout come first in it.
    """

    def __init__(self, config: Config):
        stock = config.training_variant().shift_probability
        if not 0 < stock < 1:
            raise ValueError(
                "sampler 'mixed' needs a variant some of whose levels are shifted: "
                f"shift_probability must be between 0 and 1; got {stock}"
            )
        self.config, self.share = (
            config,
            stock if config.sampler.share is None else config.sampler.share,
        )
        if not self.share and config.sampler.shifted_levels:
            raise ValueError("shifted_levels needs a share above 0; got 0")
        if config.sampler.schedule == "annealed" and self.share > 0.5:
            raise ValueError(f"share must be at most 0.5 to be annealed; got {self.share}")
        check_memory(10 * config.levels, f"{config.levels:,} training levels")
        shares = np.empty(config.levels)
        fill_shares(config.first_level, SHIFT, shares)
        self.is_shifted = shares < stock
        self.shifted = config.first_level + np.flatnonzero(self.is_shifted)
        if not 0 < len(self.shifted) < config.levels:
            raise ValueError(
                f"{len(self.shifted)} of {config.levels:,} training levels are shifted; some must "
                "be, and some not"
            )
        self.turn, self.now, self.due = 0, 0.0, 0
        self.begun = np.zeros(2, np.int64)  # levels: all, and the shifted ones

    def plan(self, steps: int) -> Plan:
        config = self.config
        if config.sampler.shifted_levels is None:
            self.now = share_at(config.sampler.schedule, self.share, steps / config.steps)
        else:
            progress = min((steps + config.batch) / config.steps, 1.0)
            part = part_at(config.sampler.schedule, self.share, progress)
            self.due = round(part * config.sampler.shifted_levels)
        return Plan(restart=not self.begun[0])

    def next(self, places: np.ndarray) -> np.ndarray:
        random, first = stream(self.config, self.turn), self.config.first_level
        self.turn += 1
        if self.config.sampler.shifted_levels is None:
            is_shifted = random.random(len(places)) < self.now
        else:
            is_shifted = random.permutation(len(places)) < self.due - self.begun[1]
        numbers = random.integers(first, first + self.config.levels, len(places))
        while (wrong := ~is_shifted & self.is_shifted[numbers - first]).any():
            numbers[wrong] = random.integers(first, first + self.config.levels, wrong.sum())
        drawn = random.integers(len(self.shifted), size=len(places))
        numbers[is_shifted] = self.shifted[drawn[is_shifted]]
        self.begun += len(places), is_shifted.sum()
        return numbers

    def note(self, played: Played) -> None:
        """What came of a level does not matter here."""

    def summary(self) -> dict[str, float]:
        begun, shifted = map(float, self.begun)
        return {"begun": begun, "shifted": shifted, "shifted_share": shifted / begun}

    def arrays(self) -> dict[str, np.ndarray]:
        return {"turn": np.array([self.turn]), "begun": self.begun}

    def restore(self, arrays: Arrays) -> None:
        self.turn, self.begun = int(arrays["turn"][0]), arrays["begun"].copy()
        if self.turn < 0 or not 0 <= self.begun[1] <= self.begun[0]:
            raise ValueError(f"its sampler began {self.begun} levels in {self.turn} turns")


class Growing:
    """The smallest levels first, then larger ones too, and at last all of them, all alike.

    A level is as large as the number of cells that its agent can get to. Which part of the training
    levels is played grows evenly from `FIRST` to all, over `share` of the steps. From then on each
    is as likely as any other, as without a sampler.
    """

    def __init__(self, config: Config):
        self.config, game = config, config.find_game()
        self.share = GROWS if config.sampler.share is None else config.sampler.share
        reachable, numbers = game.solver.reachable, np.array(config.training_levels)
        check_memory(17 * len(numbers), f"{len(numbers):,} training levels")
        shown, n = "symbolic" if game.symbols else "image", min(len(numbers), MEASURED)
        nursery = GameVectorEnv(game, config.training_variant(), n, observation=shown)
        sizes = np.empty(len(numbers), np.int64)
        for first in range(0, len(numbers), n):
            first = min(first, len(numbers) - n)  # as many as environments
            nursery.reset(options={"level": numbers[first : first + n]})
            states = trusted(nursery.get_state())
            sizes[first : first + n] = [reachable(s).sum() for s in states]
        nursery.close()
        self.by_size = numbers[np.argsort(sizes, kind="stable")]
        self.turn, self.count = 0, len(numbers)

    def plan(self, steps: int) -> Plan:
        progress = steps / self.config.steps
        part = FIRST + (1 - FIRST) * progress / self.share if progress < self.share else 1.0
        self.count = max(round(part * len(self.by_size)), 1)
        return Plan(restart=not self.turn)

    def next(self, places: np.ndarray) -> np.ndarray:
        random = stream(self.config, self.turn)
        self.turn += 1
        return self.by_size[random.integers(self.count, size=len(places))]

    def note(self, played: Played) -> None:
        """What came of a level does not matter here."""

    def summary(self) -> dict[str, float]:
        return {"part": self.count / len(self.by_size)}

    def arrays(self) -> dict[str, np.ndarray]:
        return {"turn": np.array([self.turn])}

    def restore(self, arrays: Arrays) -> None:
        self.turn = int(arrays["turn"][0])
        if self.turn < 0:
            raise ValueError(f"its sampler was asked {self.turn} times")
