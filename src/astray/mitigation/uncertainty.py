"""Scores of the uncertainty of an agent, by which it could ask for help.

A score is a callable with a name: (environments, what they show) -> [N] float64, higher where help
is sooner asked for. It may look at the agent, at what it is shown, or, as `GoalPosterior`, play the
level in a copy of the world first.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
import torch

from astray.acting import Levels, Policy, steps
from astray.agents import policy as trained
from astray.agents.actor_critic import ActorCritic
from astray.analysis import agency
from astray.analysis.policies import episode_noise
from astray.analysis.trained import AT_ONCE, Agent
from astray.bounds import of_kind, shown
from astray.envs.vector import GameVectorEnv
from astray.game import Shift, Variant
from astray.level import Level

RANDOM_SALT = 2**34  # no agent has this seed, or a larger one
ROUNDS = 300  # of expectation and maximisation
RIDGE = 1e-3  # of the mean variance, added to every variance of features
Key = tuple[int, str, bytes]  # of a level that is played


class Score(Protocol):
    """How much reason there is to ask for help, [N] float64; see above."""

    @property
    def name(self) -> str: ...

    def __call__(self, env: GameVectorEnv, observations: np.ndarray) -> np.ndarray: ...


def _probabilities(logits: np.ndarray) -> np.ndarray:
    _check_logits(logits)
    exponential = np.exp(logits - logits.max(-1, keepdims=True))
    return exponential / exponential.sum(-1, keepdims=True)


def max_probability(logits: np.ndarray) -> np.ndarray:
    """1 less the probability of the likeliest action, [N, A] -> [N]."""
    return 1 - _probabilities(logits).max(-1)


def margin(logits: np.ndarray) -> np.ndarray:
    """1 less how much likelier the likeliest action is than the next, [N, A] -> [N]."""
    ordered = np.sort(_probabilities(logits), -1)
    return 1 - (ordered[..., -1] - ordered[..., -2])


def entropy(logits: np.ndarray) -> np.ndarray:
    """The entropy of the policy, nats, [N, A] -> [N]."""
    return entropy_of(_probabilities(logits))


def energy(logits: np.ndarray) -> np.ndarray:
    """The free energy, -log sum exp of the logits, [N, A] -> [N] (Liu et al. 2020)."""
    _check_logits(logits)
    largest = logits.max(-1)
    return -(largest + np.log(np.exp(logits - largest[..., None]).sum(-1)))


def max_logit(logits: np.ndarray) -> np.ndarray:
    """The negative of the largest logit, [N, A] -> [N]."""
    _check_logits(logits)
    return -logits.max(-1)


def _check_logits(logits: Any) -> None:
    """ValueError where `logits` are no array [..., A] of numbers."""
    of_kind("logits", logits, np.ndarray)
    if not logits.size or not logits.ndim or logits.dtype.kind not in "fiu":
        raise ValueError(f"logits must be [N, A] numbers; got {logits.shape} {logits.dtype}")


def entropy_of(probabilities: np.ndarray) -> np.ndarray:
    """The entropy of distributions [..., K], nats."""
    likely = np.where(probabilities > 0, probabilities, 1.0)
    return -(probabilities * np.log(likely)).sum(-1)


OF_LOGITS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "max probability": max_probability,
    "margin": margin,
    "entropy": entropy,
    "energy": energy,
    "max logit": max_logit,
}


@dataclass(frozen=True)
class OfLogits:
    """A score of the agent's logits, one of `OF_LOGITS`."""

    agent: Agent
    name: str

    def __post_init__(self) -> None:
        of_kind("agent", self.agent, Agent)
        if self.name not in OF_LOGITS:
            raise ValueError(f"unknown score {self.name!r}; there are: {', '.join(OF_LOGITS)}")

    def __call__(self, env: GameVectorEnv, observations: np.ndarray) -> np.ndarray:
        logits = self.agent.outputs(observations)[0].double().numpy(force=True)
        return OF_LOGITS[self.name](logits)


@dataclass(frozen=True)
class Chance:
    """Random score: the baseline for asking for help at random."""

    seed: int = 0
    name: str = "random"

    def __call__(self, env: GameVectorEnv, observations: np.ndarray) -> np.ndarray:
        return episode_noise(RANDOM_SALT + self.seed, env.states, 1)[:, 0].astype(float)


@dataclass(frozen=True)
class Always:
    """Asks in every step."""

    name: str = "always"

    def __call__(self, env: GameVectorEnv, observations: np.ndarray) -> np.ndarray:
        return np.ones(len(env.states))


@dataclass(frozen=True)
class Disagreement:
    """How far agents of the same training but other seeds are apart, nats.

    The entropy of their mean policy less their mean entropy: 0 where all do the same.
    """

    agents: Sequence[Agent]
    name: str = "ensemble disagreement"

    def __post_init__(self) -> None:
        of_kind("agents", self.agents, Sequence)
        for agent in self.agents:
            if not callable(getattr(agent, "outputs", None)):
                raise ValueError(f"an agent of an ensemble must have outputs; got {shown(agent)}")
        if len(self.agents) < 2:
            raise ValueError(f"an ensemble must have two agents at least; got {len(self.agents)}")

    def __call__(self, env: GameVectorEnv, observations: np.ndarray) -> np.ndarray:
        all_logits = [a.outputs(observations)[0].double().numpy(force=True) for a in self.agents]
        each = _probabilities(np.stack(all_logits))
        return entropy_of(each.mean(0)) - entropy_of(each).mean(0)


@torch.no_grad()
def features(agent: Agent, observations: np.ndarray) -> np.ndarray:
    """What the agent's logits and value are linear functions of, [N, F] float64.

    The same for an observation whatever stands beside it.

    Raises ValueError where the network is none of astray's own.
    """
    network = agent.network
    if not isinstance(network, ActorCritic):
        raise ValueError(f"features need a network of astray's; got {type(network).__name__}")
    shown = torch.from_numpy(observations).to(agent.device)
    chunk = AT_ONCE[agent.observation]
    found, _ = trained.outputs(lambda part: (network.hidden(part), part), shown, chunk)
    return found.double().numpy(force=True)


@dataclass(frozen=True, eq=False)
class Distance:
    """How far what the agent makes of an image is from what it made of those in training.

    With `precision` the distance of Mahalanobis; without, that of Deep SVDD (Ruff et al. 2018) from
    the centre of all, but in the features that the agent has, where theirs are trained for it.
    """

    agent: Agent
    centre: np.ndarray  # [F]
    precision: np.ndarray | None  # [F, F]

    @property
    def name(self) -> str:
        return "distance from the centre" if self.precision is None else "mahalanobis"

    def __call__(self, env: GameVectorEnv, observations: np.ndarray) -> np.ndarray:
        away = features(self.agent, observations) - self.centre
        turned = away if self.precision is None else away @ self.precision
        return np.sqrt(np.maximum((turned * away).sum(1), 0.0))


def distances(agent: Agent, variant: str | Variant, levels: Levels) -> list[Distance]:
    """Both distances, fitted to all steps of the agent's own episodes in training levels."""
    played = steps(agent, agent.game, variant, levels)
    seen = np.concatenate([features(agent, step.observations) for step in played])
    centre = seen.mean(0)
    covariance = np.atleast_2d(np.cov(seen.T))
    ridge = RIDGE * max(np.trace(covariance) / len(covariance), 1e-12)
    precision = np.linalg.inv(covariance + ridge * np.eye(len(covariance)))
    return [Distance(agent, centre, precision), Distance(agent, centre, None)]


@dataclass(eq=False)
class GoalPosterior:
    """What goal the agent would pursue in a level, by the agency measure on imagined episodes.

    Before a level begins, it is played with the goal in each of at most `cells` cells (its splay);
    so this needs a game whose levels can be edited, and a copy of the world to try in. Known with
    the first step, it stays the same throughout the level, whatever other levels are played beside
    it: each level's episodes are imagined by themselves.

    kind  "entropy": entropy, in nats, of the most likely fractions of the splay's episodes that
          each goal, and "a device", explain. It is high if the agent pursues various goals.
          "misgeneralization": 1 minus the posterior of the intended goal in the level as it is;
          an overseer has to name this goal.
    """

    agent: Policy
    shift: Shift
    kind: Literal["entropy", "misgeneralization"] = "entropy"
    cells: int = 12
    imagined: int = 0  # episodes so far
    _known: dict[Key, float] = field(default_factory=dict, repr=False)

    def __post_init__(self) -> None:
        # A script remembers the levels that it is in, by number; imagined ones are others.
        self.agent = copy.deepcopy(self.agent)

    @property
    def name(self) -> str:
        return {
            "entropy": "goal entropy under a splay",
            "misgeneralization": "goal misgeneralization",
        }[self.kind]

    def __call__(self, env: GameVectorEnv, observations: np.ndarray) -> np.ndarray:
        keys = [self._key(env, s) for s in env.states]
        for key, s in zip(keys, env.states, strict=True):
            if key not in self._known:
                self._known[key] = self._imagine(env, s)
        return np.array([self._known[key] for key in keys])

    def _key(self, env: GameVectorEnv, s: Any) -> Key:
        """What a level is known by while it is played: its number, the goals' places, its cells."""
        places = agency.named_places(env.game, s, self.shift)
        return int(s.level), repr(places), env.game.cells.free(s).tobytes()

    def _imagine(self, env: GameVectorEnv, s: Any) -> float:
        """Play the level of a state, or its splay, and tell what the episodes say."""
        level = Level.of(env.game, env.variant, s)
        played_ones = [level]
        if self.kind == "entropy":
            splay = goal_splay(level)
            played_ones = splay[:: max(1, -(-len(splay) // self.cells))]
        levels = {str(k): one for k, one in enumerate(played_ones)}
        played = agency.play(self.agent, env.game, env.variant, levels, self.shift)  # pyright: ignore
        self.imagined += len(levels)
        if not played:  # a level that lacks one of the goals: nobody misgeneralizes there
            return 0.0
        assessed = agency.assess(played)
        if self.kind == "entropy":
            logs = assessed.episodes.select([f"log {name}" for name in assessed.explanations])
            return float(entropy_of(likeliest_shares(logs.to_numpy())))
        return 1 - float(assessed.episodes[f"p {self.shift.intended}"].to_numpy().mean())


def likeliest_shares(log_evidence: np.ndarray) -> np.ndarray:
    """The shares [H] of explanations under which episodes are likeliest, each of one of them.

    log_evidence  [E, H] nats; one of each row is finite

    By expectation and maximisation: `agency.population.shares` has intervals, and takes longer.
    """
    likelihood = np.exp(log_evidence - log_evidence.max(1, keepdims=True))
    theta = np.full(likelihood.shape[1], 1 / likelihood.shape[1])
    for _ in range(ROUNDS):
        mine = likelihood * theta
        theta = (mine / mine.sum(1, keepdims=True)).mean(0)
    return theta


def goal_splay(level: Level) -> list[Level]:
    """`level` with its goal in every cell that is free for it; what it lay on stays."""
    for name in ("goal", "goal on other"):
        if name in level.game.editing.OBJECTS and level.where(name):
            (at,) = level.where(name)
            if name == "goal":
                return level.splay("goal")
            bare = level.removed(name).added("other", at)
            free = (one.agent for one in bare.splay("agent"))
            return bare.added("goal", next(at for at in free if at != bare.agent)).splay("goal")
    raise ValueError("the level has no goal that could be moved")
