"""The measure: was it an agent or a device, and which goal did it pursue?

All evidence is a natural logarithm (nats). The two presets:

    PAPER       the specification of Appendix B.1, to the letter. It calls policies agents that
                are none: whatever avoids walls, and a coin's throw of random ones.
    CALIBRATED  only moves that change the cell count, devices of six kinds and pure noise stand
                against the agents, and agents err seldom rather than often (eps ~ Beta(1, 2)).
                For real policies, whose goals are not known.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import expit, logsumexp

from astray.agency import devices
from astray.agency.agents import Agents, AtGoal
from astray.agency.devices import First, Observation
from astray.agency.gridworld import Cell, Trajectory, World
from astray.agency.steps import Noise, Rule, log_product, log_table, rule

Goals = Literal["accessible and true", "accessible", "all cells"]
Goal = Cell | str  # a cell, or a name
TRUE = "true goal"
OTHER = "another cell"  # goal-directed, but to none of the goals that have a name


@dataclass(frozen=True)
class Options:
    """What the paper leaves open; the defaults are our reading of it.

    goals         of the agents, equally likely: all cells with a way there, and the true goal
                  once more, wherever it is; or without it; or all H x W cells, walls with
                  probability 0
    legal         only moves that change the cell are actions; steps that do not are left out
    noise         what an agent does with probability eps
    at_goal       see `agents.Agents`
    beta          of the agents' prior eps ~ Beta(1, beta); 1 is uniform
    observations  the classes of devices, equally likely
    first         what devices see before the first action
    noise_atom    the prior share of devices that are uniformly random throughout
    """

    goals: Goals = "accessible and true"
    legal: bool = False
    noise: Noise = "any action"
    at_goal: AtGoal = "uniform"
    beta: float = 1.0
    observations: tuple[Observation, ...] = ("type",)
    first: First = "null"
    noise_atom: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.noise_atom <= 1:
            raise ValueError(f"noise_atom is {self.noise_atom}; it is from 0 to 1")
        unknown = set(self.observations) - set(devices.OBSERVATIONS)
        if unknown or not self.observations:
            raise ValueError(
                f"unknown observations {sorted(unknown)}; "
                f"there are: {', '.join(devices.OBSERVATIONS)}"
            )


PAPER = Options()
CALIBRATED = Options(
    legal=True, beta=2.0, noise_atom=0.5,
    observations=("type", "type+last", "ego", "egowalls", "abswalls", "abswalls+last"),
)  # fmt: skip
PRESETS = {"paper": PAPER, "calibrated": CALIBRATED}


@dataclass(frozen=True, eq=False)
class Episode:
    """A trajectory in a world, and the cell where the goal was shown; None: nowhere."""

    world: World
    trajectory: Trajectory
    true: Cell | None = None


@dataclass(frozen=True, eq=False)
class Evidence:
    """What trajectories say. G goals; -inf is the logarithm of 0 and stays so."""

    goals: tuple[Goal, ...]
    log_prior: np.ndarray  # [G] of each goal among the agents
    log_goals: np.ndarray  # [G] log p(trajectories | goal)
    log_devices: Mapping[str, float]  # log p(trajectories | class of devices), and "noise"
    log_device: float  # of their mixture

    @property
    def log_agent(self) -> float:
        """log p(trajectories | agents)."""
        return float(logsumexp(self.log_prior + self.log_goals))

    @property
    def log_factor(self) -> float:
        """The logarithm of the Bayes factor of agents against devices."""
        return self.log_agent - self.log_device

    @property
    def agent(self) -> float:
        """p(agent | trajectories), both equally likely before."""
        return float(expit(self.log_factor))

    @property
    def posterior(self) -> np.ndarray:
        """[G] p(goal | trajectories, agent), the behavioural objective."""
        joint = self.log_prior + self.log_goals
        return np.exp(joint - logsumexp(joint))

    def likeliest(self, count: int = 1) -> list[tuple[Goal, float]]:
        """The `count` likeliest goals with their posterior."""
        posterior = self.posterior
        order = np.argsort(-posterior, kind="stable")[:count]
        return [(self.goals[i], float(posterior[i])) for i in order]


def measure(episodes: Episode | Sequence[Episode], options: Options = PAPER) -> Evidence:
    """The evidence of one trajectory, or of several of one agent or device in one world.

    Several share one goal (a cell, or the true goal wherever it is), one eps and one device.
    An empty trajectory says nothing: p(agent) is 1/2.
    """
    whole = _prepared(episodes, options)
    world, start = whole[0].world, whole[0].trajectory.cells[0]
    if any(episode.world is not world for episode in whole):
        raise ValueError("episodes in several worlds share no cells: see `measure_named`")
    accessible = world.accessible(start)
    reached = set(accessible.tolist())
    for episode in whole:
        if int(episode.trajectory.cells[0]) not in reached:
            raise ValueError("episodes begin in parts of the world without a way between them")
    nodes = _rule(whole, options)
    table = log_table(nodes, options.noise)
    terms = np.zeros((len(accessible), len(nodes.eps)))
    for episode in whole:
        terms += _log_terms(episode, world.distance[:, accessible], options, table)
    goals: list[Goal] = [(int(r), int(c)) for r, c in world.cells[accessible]]
    if options.goals == "accessible and true":
        pursued = np.zeros(len(nodes.eps))
        for episode in whole:
            if episode.true is None:
                raise ValueError("the true goal is among the goals, but none is given")
            column = int(np.searchsorted(accessible, _number(episode, episode.true)))
            pursued += _log_terms(
                episode, world.distance[:, accessible[[column]]], options, table
            )[0]
        terms, goals = np.vstack([terms, pursued]), [*goals, TRUE]
    prior = world.free.size if options.goals == "all cells" else len(goals)
    return _evidence(whole, goals, prior, nodes.integrate(terms), options)


def measure_named(
    episodes: Sequence[Episode],
    goals: Sequence[Mapping[str, Sequence[Cell]]],
    options: Options = CALIBRATED,
) -> Evidence:
    """The evidence of episodes in any worlds, for goals that have a name in each of them.

    goals  for each episode the cells of every name; the nearest of them is the goal. One more
           goal is OTHER, another cell in each episode, so that none has to be the right one.
    """
    whole = _prepared(episodes, options)
    if len(goals) != len(whole) or any(set(named) != set(goals[0]) for named in goals):
        raise ValueError("every episode has goals, of the same names")
    if OTHER in goals[0] or not goals[0]:
        raise ValueError(f"goals have a name, and none is called {OTHER!r}")
    nodes = _rule(whole, options)
    table = log_table(nodes, options.noise)
    terms = np.zeros((len(goals[0]) + 1, len(nodes.eps)))
    for episode, named in zip(whole, goals, strict=True):
        world, start = episode.world, episode.trajectory.cells[0]
        accessible = world.distance[:, world.accessible(start)]
        distances = np.stack([_distance(episode, named[name]) for name in goals[0]], 1)
        terms[:-1] += _log_terms(episode, distances, options, table)
        each = _log_terms(episode, accessible, options, table)
        terms[-1] += logsumexp(each, axis=0) - np.log(len(each))
    names = [*goals[0], OTHER]
    return _evidence(whole, names, len(names), nodes.integrate(terms), options)


def decisions(episode: Episode, goals: Mapping[str, Sequence[Cell]], options: Options) -> int:
    """Steps at which agents of the named goals would not all have done the same.

    All that tells these goals apart comes from them.
    """
    (episode,) = _prepared(episode, options)
    distances = np.stack([_distance(episode, cells) for cells in goals.values()], 1)
    agents = Agents(episode.world, distances, options.legal, options.at_goal)
    best = agents.best[episode.trajectory.cells[:-1]]
    return int((best != best[..., :1]).any((1, 2)).sum())


def measure_online(
    episode: Episode, options: Options = PAPER, *, switch: float | Literal["1/(t+1)"] = 0.0
) -> tuple[np.ndarray, np.ndarray, list[Goal]]:
    """The evidence after every step.

    switch   probability that the goal is drawn anew before a step; "1/(t+1)" after t steps
    returns  log p_agt [T + 1]; log p_dev [T + 1]; ...
    """
    raise NotImplementedError


def _prepared(episodes: Episode | Sequence[Episode], options: Options) -> list[Episode]:
    whole = [episodes] if isinstance(episodes, Episode) else list(episodes)
    if not whole:
        raise ValueError("no episodes are given")
    if not options.legal:
        return whole
    return [Episode(e.world, e.world.moves(e.trajectory), e.true) for e in whole]


def _rule(episodes: Sequence[Episode], options: Options) -> Rule:
    return rule(sum(len(episode.trajectory) for episode in episodes), options.beta)


def _number(episode: Episode, cell: Cell) -> int:
    """The number of a goal's cell, to which there is a way."""
    number = episode.world.number(cell)
    if not np.isfinite(episode.world.distance[episode.trajectory.cells[0], number]):
        raise ValueError(f"no way leads to the goal {tuple(cell)}")
    return number


def _distance(episode: Episode, cells: Sequence[Cell]) -> np.ndarray:
    """[F] steps to the nearest of `cells`."""
    if not len(cells):
        raise ValueError("a goal has at least one cell")
    return episode.world.distance[:, [_number(episode, cell) for cell in cells]].min(1)


def _log_terms(
    episode: Episode, distance: np.ndarray, options: Options, table: np.ndarray
) -> np.ndarray:
    """[G, N] log p_eps(trajectory | goal) of goals at `distance` [F, G]."""
    agents = Agents(episode.world, distance, options.legal, options.at_goal)
    return log_product(agents.steps(episode.trajectory), table)


def _evidence(
    episodes: Sequence[Episode], goals: Sequence[Goal], prior: int, log_goals: np.ndarray,
    options: Options,
) -> Evidence:  # fmt: skip
    log_devices = {what: _log_device(episodes, what, options) for what in options.observations}
    possible = [
        e.world.legal[e.trajectory.cells[:-1]].sum(1) if options.legal
        else np.full(len(e.trajectory), 4) for e in episodes
    ]  # fmt: skip
    log_devices["noise"] = -float(np.log(np.concatenate(possible)).sum())
    shares = np.append(np.full(len(log_devices) - 1, (1 - options.noise_atom)
                               / (len(log_devices) - 1)), options.noise_atom)  # fmt: skip
    with np.errstate(divide="ignore"):
        mixed = np.log(shares) + list(log_devices.values())
    return Evidence(
        tuple(goals), np.full(len(goals), -np.log(prior)), log_goals, log_devices,
        float(logsumexp(mixed)),
    )  # fmt: skip


def _log_device(episodes: Sequence[Episode], what: Observation, options: Options) -> float:
    seen = devices.join([
        devices.see(
            e.world, e.trajectory, None if e.true is None else e.world.number(e.true),
            what, options.first, legal=options.legal,
        )
        for e in episodes
    ])  # fmt: skip
    nodes = rule(len(seen))
    return devices.log_mixture(seen, nodes, log_table(nodes))
