"""Prioritised level replay (PLR) and ACCEL: train on the levels with the highest scores.

As in Abdel Sadek et al. ("Mitigating Goal Misgeneralization via Minimax Regret", RLC 2025),
rollouts on new levels only score them, and the network learns from levels that are replayed from a
buffer (robust PLR, Jiang et al. 2021). ACCEL (Parker-Holder et al. 2022) also scores edits of the
levels that were just replayed.
"""

from collections.abc import Callable

import numpy as np

from astray.envs.beginnings import initial_states
from astray.game import Game
from astray.memory import check_memory
from astray.record import NEVER, trusted
from astray.training.config import Config
from astray.training.levels import (
    Arrays,
    Plan,
    Played,
    discounted_returns,
    positive_value_loss,
    stream,
)

KINDS = GENERATE, REPLAY, MUTATE = range(3)  # of rollouts
CHANCES = {"plr": 1 / 3, "accel": 1 / 2}  # probability that a rollout replays, as in the paper
NAMES = ("generated", "replayed", "mutated")  # names of levels by kind of rollout
UNPLAYED = np.finfo(float).min  # the best return in a level that was never played
MOST = 1000  # steps of the solver that are looked at


def check_last(game: Game, states: np.ndarray, goal: str) -> None:
    """Raise ValueError if the level of `states` [1] goes on after its goal.

    The solver's return has the rewards up to the goal, and an agent's has all.
    """
    (s,) = states.copy()
    lead = game.solver.expert(s, goal)
    for _ in range(min(int(s.time_limit), MOST)):
        s.time += 1
        if game.rules.step(s, lead(s))[1]:
            return
        if s[game.event(goal)] != NEVER:
            told = f"{goal!r} does not end those of {game.name}, where rewards go on"
            raise ValueError(f"score 'regret' needs a goal that ends a level; {told}")


def probabilities(
    score: np.ndarray, age: np.ndarray, temperature: float, staleness: float
) -> np.ndarray:
    """Return each level's probability of replay, from its score and its age in replays; all [B].

    P = (1 - staleness) * (1 / rank) ** (1 / temperature) / sum + staleness * age / sum. Rank 1 is
    the highest score; equal scores are ranked in buffer order.
    """
    rank = np.empty(len(score), np.int64)
    rank[np.argsort(-score, kind="stable")] = np.arange(1, len(score) + 1)
    by_score = rank ** (-1 / temperature)
    return (1 - staleness) * by_score / by_score.sum() + staleness * age / age.sum()


def draw_distinct(chance: np.ndarray, count: int, random: np.random.Generator) -> np.ndarray:
    """Draw `count` distinct places with probabilities `chance` [B]; return them sorted."""
    with np.errstate(divide="ignore"):  # the logarithm of a chance too small for a number
        keys = np.log(chance) + random.gumbel(size=len(chance))
    return np.sort(np.argpartition(-keys, count - 1)[:count])


class Replay:
    """Sampler with a buffer of scored levels, for "plr" and "accel".

    A rollout has new levels, levels of the buffer, or mutated ones. In it every environment
    repeats one level.
    """

    def __init__(self, config: Config):
        self.config, self.variant, self.game = config, config.training_variant(), config.find_game()
        self.mutates = config.sampler.kind == "accel"
        if self.mutates and not self.game.mutation:
            self.game.mutation.mutate  # noqa: B018  # says that there is none
        n, size = config.num_envs, config.sampler.buffer
        if not self.mutates:  # each training level once, as those that are there enter no more
            size = min(size, max(n, config.levels))
        self.places = np.zeros(n, np.int64)  # places in the buffer of the last replay
        if size < n:
            raise ValueError(f"buffer must hold a level for each of {n} environments; got {size}")
        check_memory(2 * size * self.game.state.itemsize, f"a buffer of {size:,} levels")
        self.chance = config.sampler.replay or CHANCES[config.sampler.kind]
        self.intended = config.intended_goal() if config.sampler.score == "regret" else None
        if self.intended:
            check_last(self.game, self._generated(stream(config, 0))[:1], self.intended)
        self.states = np.zeros(size, self.game.state)
        self.score, self.best, self.optimal = self.scores = np.zeros((3, size))
        self.visited = np.zeros(size, np.int64)  # number of its last replay, from 1
        self.kind, self.turn = GENERATE, 0
        self.rollouts = np.zeros(len(KINDS), np.int64)
        self.current = np.zeros(n, self.game.state)

    def plan(self, steps: int) -> Plan:
        if not self.turn:
            self._fill()
        random = stream(self.config, self.turn)
        self.turn += 1
        if self.mutates and self.kind == REPLAY:
            self.kind = MUTATE
            before, its = self.states[self.places], self.config.sampler
            seeds, mutate = random.integers(2**32, size=len(before)), self.game.mutation.mutate
            self.current = mutate(before, self.variant, seeds, its.edits, its.mutation)
        elif random.random() < self.chance:
            self.kind = REPLAY
            self.places = draw_distinct(self.chances(), len(self.places), random)
            self.current = self.states[self.places]
        else:
            self.kind = GENERATE
            self.current = self._generated(random)
        return Plan(learn=self.kind == REPLAY, repeat=True)

    def next(self, places: np.ndarray) -> np.ndarray:
        return self.current[places]

    def note(self, played: Played) -> None:
        ended = played.terminated | played.truncated
        mean, best = discounted_returns(played.reward, ended, self.config.gamma)
        self.rollouts[self.kind] += 1
        if self.kind == REPLAY:
            best, optimal = np.maximum(best, self.best[self.places]), self.optimal[self.places]
        else:
            optimal = self._optimal(self.current)
        kinds: dict[str, Callable[[], np.ndarray]] = {
            "regret": lambda: optimal - mean,
            "max-monte-carlo": lambda: best - mean,
            "positive-value-loss": lambda: positive_value_loss(played.advantage),
        }
        scores = np.stack([kinds[self.config.sampler.score](), best, optimal])
        if self.kind == REPLAY:
            self._put(self.places, self.current, scores)
        else:
            self._insert(scores)

    def chances(self) -> np.ndarray:
        """Return the probability of each buffered level to be replayed next, [B]."""
        age, its = self.rollouts[REPLAY] - self.visited + 1, self.config.sampler
        return probabilities(self.score, age, its.temperature, its.staleness)

    def summary(self) -> dict[str, float]:
        counts = dict(zip(NAMES, (len(self.places) * self.rollouts).tolist(), strict=True))
        shifted, by_hand = self.states["shifted"], self.states["level"] == NEVER
        return {name: float(count) for name, count in counts.items()} | {
            "shifted_in_buffer": float(shifted.mean()),
            "shifted_replayed": float(self.current["shifted"].mean()),
            "mutated_in_buffer": float(by_hand.mean()),
            "score": float(self.score.mean()),
        }

    def arrays(self) -> dict[str, np.ndarray]:
        return {
            "states": self.states.view(np.uint8).reshape(len(self.states), -1),
            "scores": self.scores,
            "visited": self.visited,
            "rollouts": self.rollouts,
            "places": self.places,
            "turn": np.array([self.turn, self.kind]),
        }

    def restore(self, arrays: Arrays) -> None:
        states = arrays["states"].copy().view(self.game.state).reshape(-1)
        turn, kind = map(int, arrays["turn"])
        places, visited, rollouts = (arrays[name] for name in ("places", "visited", "rollouts"))
        are_places = ((places >= 0) & (places < len(states))).all() and turn >= 0
        are_counts = (visited <= rollouts[REPLAY]).all() and (rollouts >= 0).all()
        if kind not in KINDS or not are_places or not are_counts:
            raise ValueError("its sampler's buffer is not one that a training writes")
        if turn:
            self.game.check(states, self.variant)
        self.states, self.visited, self.rollouts = states, visited.copy(), rollouts.copy()
        self.score, self.best, self.optimal = self.scores = arrays["scores"].copy()
        self.turn, self.kind, self.places = turn, kind, places.copy()
        self.current = states[places]

    def _fill(self) -> None:
        """Fill the buffer with random levels of score 0."""
        random, n = stream(self.config, self.turn), len(self.places)
        self.turn += 1
        for first in range(0, len(self.states), n):
            some = slice(first, first + n)
            self.states[some] = self._generated(random)[: len(self.states) - first]
        self.best[:] = UNPLAYED
        self.optimal[:] = self._optimal(self.states)

    def _generated(self, random: np.random.Generator) -> np.ndarray:
        """Return the initial states of training levels, drawn for all environments."""
        levels = self.config.training_levels
        numbers = random.integers(levels.start, levels.stop, len(self.places))
        return initial_states(self.game, self.variant, numbers)

    def _insert(self, scores: np.ndarray) -> None:
        """Replace the least likely levels of the buffer by new ones with higher scores [3, N].

        A number that is already in the buffer is not inserted again.
        """
        score = scores[0]
        numbers = self.current["level"]
        first = np.zeros(len(numbers), bool)
        first[np.unique(numbers, return_index=True)[1]] = True
        new = (numbers == NEVER) | (first & ~np.isin(numbers, self.states["level"]))
        order = np.argsort(-np.where(new, score, -np.inf), kind="stable")
        low = np.argsort(self.chances(), kind="stable")[: len(order)]
        low = low[np.argsort(self.score[low], kind="stable")]
        enters = new[order] & (score[order] > self.score[low])
        chosen = order[enters]
        self._put(low[enters], self.current[chosen], scores[:, chosen])

    def _put(self, where: np.ndarray, states: np.ndarray, scores: np.ndarray) -> None:
        """Store levels [K] and their scores [3, K] at places of the buffer."""
        self.states[where], self.scores[:, where] = states, scores
        self.visited[where] = self.rollouts[REPLAY]

    def _optimal(self, states: np.ndarray) -> np.ndarray:
        """Return the optimal discounted return from each state [K]; 0 if it is not needed."""
        if self.intended is None:
            return np.zeros(len(states))
        best, gamma = self.game.solver.optimal_return, self.config.gamma
        return np.array([best(s, self.intended, gamma) for s in trusted(states.copy())])
