"""Scripted policies for base rates; `trained` has learned ones."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium import Space
from gymnasium.spaces import Discrete

from astray.acting import Answer, Policy, Turn
from astray.envs.vector import Observation
from astray.envs.worlds import WorldVectorEnv
from astray.game import OWN, Game, Shift
from astray.kernel.rng import fill_noise
from astray.validation import MOST, bounded, check_words
from astray.world import World

RANDOM_SALT = 2**32  # no agent has this seed, or a larger one


def episode_noise(seed: int, states: np.ndarray, count: int, salt: int = 0) -> np.ndarray:
    """Return noise [N, count] for the next action in states [N], independent of the batch.

    Raises:
        ValueError: If the seed is invalid.
    """
    bounded("seed", seed, 0, MOST)
    out = np.empty((len(states), count), np.float32)
    fill_noise(salt + int(seed), states["level"].copy(), states["time"].copy(), out)
    return out


@dataclass
class Random:
    """Policy whose actions are uniformly random."""

    seed: int = 0
    name: str = "random"
    observation: Observation = "symbolic"
    art: str = OWN

    def __post_init__(self) -> None:
        bounded("seed", self.seed, 0, MOST)
        check_words(self)

    def actions(self, turn: Turn) -> Answer:
        env, space = turn.env, turn.env.single_action_space
        if not isinstance(space, Discrete):
            pairs = zip(env.states["level"].tolist(), env.states["time"].tolist(), strict=True)
            return Answer(np.array([_drawn(space, self.seed, *pair) for pair in pairs]))
        noise = episode_noise(self.seed, env.states, int(space.n), RANDOM_SALT)
        if isinstance(env, WorldVectorEnv):
            noise = np.where(env.allowed, noise, -1)
        return Answer(int(space.start) + noise.argmax(1))


def _drawn(space: Space, seed: int, level: int, time: int) -> Any:
    """Draw an element of a space, determined by seed, level and step."""
    numbers = np.random.SeedSequence((RANDOM_SALT + int(seed), level, time)).generate_state(1)
    space.seed(int(numbers[0]))
    return space.sample()


@dataclass
class Walk:
    """Policy that takes the shortest way to one goal, ignores all others, and stays there.

    Attributes:
        remembers: Solve each level number only once, assuming that it is always the same level.
    """

    goal: str
    observation: Observation = "symbolic"
    art: str = OWN
    remembers: bool = False
    _experts: dict[int, Callable] = field(default_factory=dict, repr=False)  # by level

    @property
    def name(self) -> str:
        return f"walk to {self.goal}"

    def actions(self, turn: Turn) -> Answer:
        if isinstance(turn.env, WorldVectorEnv):
            return Answer(turn.env.leads(self.goal))
        return Answer(self.ways(turn.env.game, turn.env.states))

    def ways(self, game: Game, states: Any) -> np.ndarray:
        """Return the actions [n] towards the goal from states [n].

        An episode may join the batch at any step, and leave it at any.
        """
        # Columns are read whole, as a field of each record takes longer.
        named = zip(states, states["level"].tolist(), states["time"].tolist(), strict=True)
        return np.array([self._action(game, *one) for one in named], np.int64)

    def _action(self, game: Game, s: Any, level: int, time: int) -> int:
        if level not in self._experts or (time == 0 and not self.remembers):
            self._experts[level] = game.solver.expert(s, self.goal)
        return self._experts[level](s)


def scripts_of(game: Game | World, shift: Shift) -> list[Policy]:
    """Return the scripts for base rates: a walk to each goal of a shift, and random actions."""
    goals = (shift.intended, *shift.proxies)
    return [*(Walk(goal) for goal in goals if goal in game.walked), Random()]
