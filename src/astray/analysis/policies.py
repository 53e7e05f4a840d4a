"""Scripted policies, for base rates; `trained` has those that learned."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from gymnasium import Space
from gymnasium.spaces import Discrete

from astray.acting import Answer, Turn
from astray.envs.vector import Observation
from astray.envs.worlds import WorldVectorEnv
from astray.game import OWN, Game
from astray.kernel.rng import fill_noise

RANDOM_SALT = 2**32  # no agent has this seed, or a larger one


def episode_noise(seed: int, states: np.ndarray, count: int) -> np.ndarray:
    """Noise [N, count] for the next action in each of `states`, whatever batch they are in."""
    out = np.empty((len(states), count), np.float32)
    fill_noise(seed, states["level"].copy(), states["time"].copy(), out)
    return out


@dataclass
class Random:
    """Every action equally likely."""

    seed: int = 0
    name: str = "random"
    observation: Observation = "symbolic"
    art: str = OWN

    def actions(self, turn: Turn) -> Answer:
        env, space = turn.env, turn.env.single_action_space
        if not isinstance(space, Discrete):
            pairs = zip(env.states["level"].tolist(), env.states["time"].tolist(), strict=True)
            return Answer(np.array([_drawn(space, self.seed, *pair) for pair in pairs]))
        noise = episode_noise(RANDOM_SALT + self.seed, env.states, int(space.n))
        return Answer(int(space.start) + noise.argmax(1))


def _drawn(space: Space, seed: int, level: int, time: int) -> Any:
    """Any element of a space, which a seed, a level and a step decide."""
    numbers = np.random.SeedSequence((RANDOM_SALT + seed, level, time)).generate_state(1)
    space.seed(int(numbers[0]))
    return space.sample()


@dataclass
class Walk:
    """Goes the best way to a goal, and is blind to all else; then stays there.

    remembers  a level of a number is the same one whenever it comes, and is solved but once
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
        """The actions [n] that lead on from some states [n], of those that it is asked for.

        An episode has to be asked for in its first step, and may be left out from then on.
        """
        return np.array([self._action(game, s) for s in states], np.int64)

    def _action(self, game: Game, s: Any) -> int:
        level = int(s.level)
        if s.time == 0 and not (self.remembers and level in self._experts):
            self._experts[level] = game.solver.expert(s, self.goal)
        return self._experts[level](s)
