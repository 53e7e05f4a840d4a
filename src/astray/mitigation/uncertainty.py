"""Uncertainty scores used to decide when to ask for help.

A score is a callable with a name: (environments, observations) -> [N] float64, higher for more
uncertainty. It may use the agent, the observations or, as `GoalPosterior` does, imagined episodes
in a copy of the world.
"""

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
from astray.envs.vector import GameVectorEnv
from astray.game import Shift, Variant
from astray.level import Level
from astray.validation import of_kind, one_of, shown

RANDOM_SALT = 2**34  # no agent has this seed, or a larger one
ROUNDS = 300  # of expectation and maximisation
RIDGE = 1e-3  # of the mean variance, added to every variance of features
Key = tuple[int, str, str, bytes]  # of a level that is played


class Score(Protocol):
    """An uncertainty score, [N] float64; the top of this module describes it."""

    @property
    def name(self) -> str: ...

    def __call__(self, env: GameVectorEnv, observations: np.ndarray) -> np.ndarray: ...


def _probabilities(logits: np.ndarray) -> np.ndarray:
    _check_logits(logits)
    exponential = np.exp(logits - logits.max(-1, keepdims=True))
    return exponential / exponential.sum(-1, keepdims=True)


def max_probability(logits: np.ndarray) -> np.ndarray:
    """Return 1 minus the largest action probability, [N, A] -> [N], or raise ValueError."""
    return 1 - _probabilities(logits).max(-1)


def margin(logits: np.ndarray) -> np.ndarray:
    """Return 1 minus the gap of the two largest chances, [N, A] -> [N], or raise ValueError."""
    ordered = np.sort(_probabilities(logits), -1)
    return 1 - (ordered[..., -1] - ordered[..., -2])


def entropy(logits: np.ndarray) -> np.ndarray:
    """Return the entropy of the policy in nats, [N, A] -> [N], or raise ValueError."""
    return entropy_of(_probabilities(logits))


def energy(logits: np.ndarray) -> np.ndarray:
    """Return the free energy (Liu et al. 2020), [N, A] -> [N], or raise ValueError."""
    _check_logits(logits)
    largest = logits.max(-1)
    return -(largest + np.log(np.exp(logits - largest[..., None]).sum(-1)))


def max_logit(logits: np.ndarray) -> np.ndarray:
    """Return the negative of the largest logit, [N, A] -> [N], or raise ValueError."""
    _check_logits(logits)
    return -logits.max(-1)


def _check_logits(logits: Any) -> None:
    """Raise ValueError unless `logits` are numbers [..., A]."""
    of_kind("logits", logits, np.ndarray)
    if not logits.size or not logits.ndim or logits.dtype.kind not in "fiu":
        raise ValueError(f"logits must be [N, A] numbers; got {logits.shape} {logits.dtype}")
    if not np.isfinite(logits.max(-1)).all():  # that of an impossible action may be -inf
        raise ValueError(f"the largest logit of each row must be finite; got {shown(logits)}")


def entropy_of(probabilities: np.ndarray) -> np.ndarray:
    """Return the entropy of distributions in nats, [..., K] -> [...]."""
    likely = np.where(probabilities > 0, probabilities, 1.0)
    return -(probabilities * np.log(likely)).sum(-1)


OF_LOGITS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "max probability": max_probability,
    "margin": margin,
    "entropy": entropy,
    "energy": energy,
    "max logit": max_logit,
}


def check_memoryless(agent: Agent) -> None:
    """Raise ValueError if an agent has memory: a score sees one observation, not an episode."""
    if getattr(agent, "caveat", ""):
        raise ValueError(f"a score of uncertainty needs an agent without memory; got {agent.path}")


@dataclass(frozen=True)
class OfLogits:
    """Score computed from the agent's logits, one of `OF_LOGITS`."""

    agent: Agent
    name: str

    def __post_init__(self) -> None:
        of_kind("agent", self.agent, Agent)
        check_memoryless(self.agent)
        one_of("score", self.name, OF_LOGITS)

    def __call__(self, env: GameVectorEnv, observations: np.ndarray) -> np.ndarray:
        logits = self.agent.outputs(observations)[0].double().numpy(force=True)
        return OF_LOGITS[self.name](logits)


@dataclass(frozen=True)
class Chance:
    """Random score: the baseline for asking for help at random."""

    seed: int = 0
    name: str = "random"

    def __call__(self, env: GameVectorEnv, observations: np.ndarray) -> np.ndarray:
        return episode_noise(self.seed, env.states, 1, RANDOM_SALT)[:, 0].astype(float)


@dataclass(frozen=True)
class Always:
    """Score that asks for help in every step."""

    name: str = "always"

    def __call__(self, env: GameVectorEnv, observations: np.ndarray) -> np.ndarray:
        return np.ones(len(env.states))


@dataclass(frozen=True)
class Disagreement:
    """Score of disagreement in nats between agents that differ in their seed.

    It is the entropy of their mean policy minus their mean entropy: 0 if all policies are equal.
    """

    agents: Sequence[Agent]
    name: str = "ensemble disagreement"

    def __post_init__(self) -> None:
        of_kind("agents", self.agents, Sequence)
        for agent in self.agents:
            of_kind(f"outputs of {shown(agent)}", getattr(agent, "outputs", None), Callable)
            check_memoryless(agent)
        if len(self.agents) < 2:
            raise ValueError(f"an ensemble must have two agents at least; got {len(self.agents)}")

    def __call__(self, env: GameVectorEnv, observations: np.ndarray) -> np.ndarray:
        all_logits = [a.outputs(observations)[0].double().numpy(force=True) for a in self.agents]
        each = _probabilities(np.stack(all_logits))
        return entropy_of(each.mean(0)) - entropy_of(each).mean(0)


@torch.no_grad()
def features(agent: Agent, observations: np.ndarray) -> np.ndarray:
    """Return the features [N, F] float64 of `observations` [N, ...], independent of the batch.

    Raises:
        ValueError: If the network is not one of astray's own.
    """
    network: Any = agent.network
    of_kind("the network of features", network, ActorCritic)
    shown = torch.from_numpy(observations).to(agent.device)
    chunk = AT_ONCE[agent.observation]
    found, _ = trained.outputs(lambda part: (network.hidden(part), part), shown, chunk)
    return found.double().numpy(force=True)


@dataclass(frozen=True, eq=False)
class Distance:
    """Score of the distance between an observation's features and those in training.

    With `precision` it is the Mahalanobis distance. Without, it is the distance of Deep SVDD (Ruff
    et al. 2018) from the mean, but in the agent's own features instead of ones trained for it.
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
    """Fit both distances to all steps of the agent's own episodes in training levels."""
    played = steps(agent, agent.game, variant, levels)
    seen = np.concatenate([features(agent, step.observations) for step in played])
    centre = seen.mean(0)
    covariance = np.atleast_2d(np.cov(seen.T))
    ridge = RIDGE * max(np.trace(covariance) / len(covariance), 1e-12)
    precision = np.linalg.inv(covariance + ridge * np.eye(len(covariance)))
    return [Distance(agent, centre, precision), Distance(agent, centre, None)]


@dataclass(eq=False)
class GoalPosterior:
    """Score from the goal that the agent pursues in imagined episodes, by the agency measure.

    Before a level begins, it is played with the goal in each of at most `cells` cells (its splay).
    This needs editable levels and a copy of the world. The score is constant in a level and
    independent of other levels.

    Attributes:
        kind: "entropy" is the entropy in nats of the explanations of the splay's episodes: the most
            likely fraction of each goal, and of "a device". It is high if the agent pursues various
            goals. "misgeneralization" is 1 minus the posterior of the intended goal in the level
            itself; an overseer has to name this goal.
    """

    agent: Policy
    shift: Shift
    kind: Literal["entropy", "misgeneralization"] = "entropy"
    cells: int = 12
    imagined: int = 0  # episodes so far
    _known: dict[Key, tuple[Any, float]] = field(default_factory=dict, repr=False)  # start, score

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
            at = float(s.x), float(s.y)
            if key not in self._known or (s.time == 0 and self._known[key][0] != at):
                self._known[key] = at, self._imagine(env, s)
        return np.array([self._known[key][1] for key in keys])

    def _key(self, env: GameVectorEnv, s: Any) -> Key:
        """Return a key of the level being played: number, variant, the goals' places, cells."""
        places = agency.named_places(env.game, s, self.shift)
        return int(s.level), repr(env.variant), repr(places), env.game.cells.free(s).tobytes()

    def _imagine(self, env: GameVectorEnv, s: Any) -> float:
        """Play the level of a state, or its splay, and return the score of the episodes."""
        level = Level.of(env.game, env.variant, s)
        played_ones = [level]
        if self.kind == "entropy":
            splay = goal_splay(level)
            played_ones = splay[:: max(1, -(-len(splay) // self.cells))]
        levels = {str(k): one for k, one in enumerate(played_ones)}
        played = agency.play(self.agent, env.game, env.variant, levels, self.shift)
        self.imagined += len(levels)
        if not played:  # a level that lacks one of the goals: nobody misgeneralizes there
            return 0.0
        assessed = agency.assess(played)
        if self.kind == "entropy":
            return float(entropy_of(likeliest_rates(assessed.log_evidence)))
        return 1 - float(assessed.episodes[f"p {self.shift.intended}"].to_numpy().mean())


def likeliest_rates(log_evidence: np.ndarray) -> np.ndarray:
    """Return the maximum-likelihood fractions [H] of explanations over episodes.

    They are found by expectation maximisation; `agency.population.rates` has intervals but is
    slower.

    Args:
        log_evidence: [E, H] nats, at least one finite value per row.
    """
    likelihood = np.exp(log_evidence - log_evidence.max(1, keepdims=True))
    theta = np.full(likelihood.shape[1], 1 / likelihood.shape[1])
    for _ in range(ROUNDS):
        mine = likelihood * theta
        theta = (mine / mine.sum(1, keepdims=True)).mean(0)
    return theta


def goal_splay(level: Level) -> list[Level]:
    """Return copies of `level` with the goal in every possible cell; an object under it stays.

    Raises:
        ValueError: If the level has no single goal.
    """
    for name in ("goal", "goal on other"):
        if name in level.game.editing.OBJECTS and level.where(name):
            (at,) = level.where(name)
            if name == "goal":
                return level.splay("goal")
            bare = level.removed(name).added("other", at)
            free = (one.agent for one in bare.splay("agent"))
            return bare.added("goal", next(at for at in free if at != bare.agent)).splay("goal")
    raise ValueError("the level has no goal that could be moved")
