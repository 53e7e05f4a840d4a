"""The agency measure: was it an agent or a device, and which goal did it pursue?

All evidence is a natural logarithm (nats). The two presets:

    PAPER       the specification of Appendix B.1, to the letter. It calls some policies without
                a goal agents: those that avoid walls, and half of random ones.
    CALIBRATED  for real policies with unknown goals. Only moves that change the cell count,
                devices of six kinds and pure noise oppose the agents, and agents err seldom
                (eps ~ Beta(1, 2)).
"""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from scipy.special import expit, logsumexp

from astray.agency import devices
from astray.agency.agents import Agents, AtGoal, of_every_cell
from astray.agency.devices import First, Observation
from astray.agency.gridworld import ACTIONS, Cell, Trajectory, World
from astray.agency.steps import SURE, Noise, Rule, log_product, log_table, rule
from astray.outcome import OTHER
from astray.validation import MOST, bounded, check_words, finite, of_kind, one_of

Goals = Literal["accessible and true", "accessible", "all cells"]
Goal = Cell | str  # a cell, or a name
TRUE = "true goal"


@dataclass(frozen=True)
class Options:
    """Choices that the paper leaves open; the defaults are our reading of it.

    Attributes:
        goals: Goals of the agents, equally likely: all reachable cells, with or without the true
            goal counted once more; or all H x W cells, where walls have probability 0.
        legal: Whether only moves that change the cell are actions; other steps are dropped.
        noise: Distribution of an agent's random actions.
        at_goal: See `agents.Agents`.
        beta: Parameter of the agents' prior eps ~ Beta(1, beta); 1 is uniform.
        observations: Classes of devices, equally likely.
        first: Devices' observation before the first action.
        noise_atom: Prior probability that a device is uniformly random throughout.
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
        check_words(self)
        of_kind("observations", self.observations, tuple)
        finite("noise_atom", self.noise_atom, 0, 1)
        finite("beta", self.beta, 1, SURE)
        for what in self.observations:
            one_of("observation", what, devices.OBSERVATIONS)
        if len(set(self.observations)) < max(1, len(self.observations)):
            raise ValueError(f"observations are {self.observations}; give some, each is given once")


PAPER = Options()
CALIBRATED = Options(
    legal=True, beta=2.0, noise_atom=0.5,
    observations=("type", "type+last", "ego", "egowalls", "abswalls", "abswalls+last"),
)  # fmt: skip
PRESETS = {"paper": PAPER, "calibrated": CALIBRATED}


@dataclass(frozen=True, eq=False)
class Episode:
    """A trajectory in a world, and the cell where the goal was shown; None for nowhere."""

    world: World
    trajectory: Trajectory
    true: Cell | None = None

    def __post_init__(self) -> None:
        of_kind("world", self.world, World)
        self.world.check(self.trajectory)


@dataclass(frozen=True, eq=False)
class Evidence:
    """Evidence from trajectories for G goals; -inf is the logarithm of 0."""

    goals: tuple[Goal, ...]
    log_prior: np.ndarray  # [G] of each goal among the agents
    log_goals: np.ndarray  # [G] log p(trajectories | goal)
    log_devices: Mapping[str, float]  # log p(trajectories | class of devices), and "noise"
    log_device: float  # of their mixture

    @property
    def log_agent(self) -> float:
        """Evidence for agents, log p(trajectories | agents), in nats."""
        return float(logsumexp(self.log_prior + self.log_goals))

    @property
    def log_factor(self) -> float:
        """Log Bayes factor of agents over devices, in nats."""
        return self.log_agent - self.log_device

    @property
    def agent(self) -> float:
        """p(agent | trajectories), from equal priors."""
        return float(expit(self.log_factor))

    @property
    def posterior(self) -> np.ndarray:
        """[G] p(goal | trajectories, agent), the behavioural objective."""
        joint = self.log_prior + self.log_goals
        return np.exp(joint - logsumexp(joint))

    def likeliest(self, count: int = 1) -> list[tuple[Goal, float]]:
        """Return the `count` most likely goals with their posteriors."""
        bounded("count", count, 0, MOST)
        posterior = self.posterior
        order = np.argsort(-posterior, kind="stable")[:count]
        return [(self.goals[i], float(posterior[i])) for i in order]


def measure(episodes: Episode | Sequence[Episode], options: Options = CALIBRATED) -> Evidence:
    """Return the evidence of one trajectory, or of several by one agent or device in one world.

    Several trajectories share one goal (a cell, or the true goal wherever it is), eps and device.
    An empty trajectory has no evidence: p(agent) is 1/2.
    """
    whole = prepared(episodes, options)
    goals, prior, columns = goals_in(whole, options)
    nodes = _rule(whole, options)
    table = log_table(nodes, options.noise)
    terms = np.zeros((len(goals), len(nodes.eps)))
    for episode, chosen in zip(whole, columns, strict=True):
        terms += log_product(cell_steps(episode, options), table)[chosen]
    return _evidence(whole, goals, prior, nodes.integrate(terms), options)


def goals_in(
    episodes: Sequence[Episode], options: Options
) -> tuple[list[Goal], float, list[np.ndarray]]:
    """Return the goals [G] of episodes in one world, their inverse prior, and each episode's cells.

    Raises:
        ValueError: If the episodes have different worlds.
    """
    world, start = episodes[0].world, episodes[0].trajectory.cells[0]
    if any(episode.world is not world for episode in episodes):
        raise ValueError("episodes in several worlds share no cells: see `measure_named`")
    accessible = world.accessible(start)
    if not all(np.isin(episode.trajectory.cells[0], accessible) for episode in episodes):
        raise ValueError("episodes begin in parts of the world without a way between them")
    goals: list[Goal] = [(x, y) for x, y in world.cells[accessible].tolist()]
    columns = [accessible] * len(episodes)
    if options.goals == "accessible and true":
        goals.append(TRUE)
        if any(episode.true is None for episode in episodes):
            raise ValueError("an episode must have a true goal, as the goals name it; got none")
        columns = [np.append(accessible, _number(one, one.true)) for one in episodes]
    prior = world.free.size if options.goals == "all cells" else len(goals)
    return goals, prior, columns


def measure_named(
    episodes: Sequence[Episode],
    goals: Sequence[Mapping[str, Sequence[Cell]]],
    options: Options = CALIBRATED,
) -> Evidence:
    """Return the evidence of episodes in any worlds, for goals that have a name in each.

    Args:
        goals: For each episode: name -> cells, of which the nearest is the goal. OTHER is a further
            goal, because none of the named goals may be right: some reachable cell, each equally
            likely, also those that have a name.

    Raises:
        ValueError: If episodes and goals do not fit.
    """
    whole = prepared(episodes, options)
    of_kind("goals", goals, Sequence)
    for named in goals:
        of_kind("goals of an episode", named, Mapping)
    if len(goals) != len(whole) or any(set(named) != set(goals[0]) for named in goals):
        raise ValueError("all episodes must have goals of the same names")
    if OTHER in goals[0] or not goals[0]:
        raise ValueError(f"goals must have a name other than {OTHER!r}")
    nodes = _rule(whole, options)
    table = log_table(nodes, options.noise)
    terms = np.zeros((len(goals[0]) + 1, len(nodes.eps)))
    for episode, named in zip(whole, goals, strict=True):
        agents = _named_agents(episode, [named[name] for name in goals[0]], options)
        terms[:-1] += log_product(agents.steps(episode.trajectory), table)
        accessible = episode.world.accessible(episode.trajectory.cells[0])
        each = log_product(cell_steps(episode, options)[:, accessible], table)
        terms[-1] += logsumexp(each, axis=0) - np.log(len(each))
    names = [*goals[0], OTHER]
    return _evidence(whole, names, len(names), nodes.integrate(terms), options)


def decisions(episode: Episode, goals: Mapping[str, Sequence[Cell]], options: Options) -> int:
    """Return the number of steps at which agents of the named goals would differ.

    Only these steps distinguish the goals.

    Raises:
        ValueError: If a goal has no cell, or one that is not free.
    """
    of_kind("episode", episode, Episode)
    of_kind("goals", goals, Mapping)
    (episode,) = prepared(episode, options)
    agents = _named_agents(episode, list(goals.values()), options)
    best = agents.best[episode.trajectory.cells[:-1]]
    return int((best != best[..., :1]).any((1, 2)).sum())


def prepared(episodes: Episode | Sequence[Episode], options: Options) -> list[Episode]:
    """Return the episodes as a list, without the steps that do not count.

    Raises:
        ValueError: If there are no episodes.
    """
    of_kind("options", options, Options)
    of_kind("episodes", episodes, Episode | Sequence)
    whole = [episodes] if isinstance(episodes, Episode) else list(episodes)
    for episode in whole:
        of_kind("an episode", episode, Episode)
    if not whole:
        raise ValueError("no episodes are given")
    if not options.legal:
        return whole
    return [Episode(e.world, e.world.moves(e.trajectory), e.true) for e in whole]


def _rule(episodes: Sequence[Episode], options: Options) -> Rule:
    return rule(sum(len(episode.trajectory) for episode in episodes), options.beta)


def _number(episode: Episode, cell: Any) -> int:
    """Return the number of a goal's cell, which must be reachable."""
    number = episode.world.number(cell)
    if not np.isfinite(episode.world.distance[episode.trajectory.cells[0], number]):
        raise ValueError(f"no way leads to the goal {tuple(cell)}")
    return number


def cell_steps(episode: Episode, options: Options) -> np.ndarray:
    """Return the kinds of the steps for agents of every free cell, [T, F]."""
    agents = of_every_cell(episode.world, options.legal, options.at_goal)
    return agents.steps(episode.trajectory)


def _named_agents(episode: Episode, goals: Sequence[Sequence[Cell]], options: Options) -> Agents:
    """Return agents for the nearest cell of each goal."""
    for cells in goals:
        of_kind("cells of a goal", cells, Collection)
    if not all(map(len, goals)) or not goals:
        raise ValueError("there must be a goal, and each must have at least one cell")
    numbers = [[_number(episode, cell) for cell in cells] for cells in goals]
    distance = np.stack([episode.world.distance[:, of].min(1) for of in numbers], 1)
    return Agents(episode.world, distance, options.legal, options.at_goal)


def mix_devices(log_devices: Mapping[str, float | np.ndarray], options: Options) -> np.ndarray:
    """Return the log of the mixture of device classes and "noise", [...] of any shape."""
    fraction = (1 - options.noise_atom) / (len(log_devices) - 1)
    fractions = [options.noise_atom if what == "noise" else fraction for what in log_devices]
    with np.errstate(divide="ignore"):
        each = [np.log(s) + log for s, log in zip(fractions, log_devices.values(), strict=True)]
    return np.logaddexp.reduce(each)


def log_noise(episode: Episode, options: Options) -> np.ndarray:
    """Return the log-probability of each step if all actions are equally likely, [T]."""
    legal = episode.world.legal[episode.trajectory.cells[:-1]]
    return -np.log(legal.sum(1) if options.legal else np.full(len(legal), len(ACTIONS)))


def _evidence(
    episodes: Sequence[Episode],
    goals: Sequence[Goal],
    prior: float,
    log_goals: np.ndarray,
    options: Options,
) -> Evidence:
    seen = options.observations
    log_devices: dict[str, float] = {what: _log_device(episodes, what, options) for what in seen}
    log_devices["noise"] = sum(float(log_noise(e, options).sum()) for e in episodes)
    return Evidence(
        tuple(goals),
        np.full(len(goals), -np.log(prior)),
        log_goals,
        log_devices,
        float(mix_devices(log_devices, options)),
    )


def _log_device(episodes: Sequence[Episode], what: Observation, options: Options) -> float:
    seen = devices.join([seen_in(episode, what, options) for episode in episodes])
    nodes = rule(len(seen))
    return devices.log_mixture(seen, nodes, log_table(nodes))


def seen_in(episode: Episode, what: Observation, options: Options) -> devices.Seen:
    """Return the observations of a device of that class."""
    world, goal = episode.world, episode.true
    shown = None if goal is None else world.number(goal)
    return devices.see(world, episode.trajectory, shown, what, options.first, legal=options.legal)
