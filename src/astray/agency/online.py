"""Evidence step by step, and agents that change their goals."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.special import expit, logsumexp

from astray.agency import devices
from astray.agency.measure import (
    CALIBRATED,
    Episode,
    Goal,
    Options,
    cell_steps,
    goals_in,
    log_noise,
    mix_devices,
    prepared,
    seen_in,
)
from astray.agency.steps import IMPOSSIBLE, Rule, log_table, rule
from astray.validation import finite

BY_TIME = "1/(t+1)"
Switch = float | Literal["1/(t+1)"]


@dataclass(frozen=True, eq=False)
class Growth:
    """Evidence after 0, 1, ..., T steps; the last is that of the whole trajectory."""

    goals: tuple[Goal, ...]
    log_agent: np.ndarray  # [T + 1] nats
    log_device: np.ndarray  # [T + 1] nats
    posterior: np.ndarray  # [T + 1, G] of the goal pursued now, if an agent; NaN if none can be

    @property
    def agent(self) -> np.ndarray:
        """[T + 1] p(agent | steps so far), from equal priors."""
        return expit(self.log_agent - self.log_device)


def measure_online(episode: Episode, options: Options = CALIBRATED, switch: Switch = 0.0) -> Growth:
    """Return the evidence after every step that counts (see `Options.legal`).

    Args:
        switch: Probability that the goal is redrawn before a step; "1/(t+1)" for 1 / (t + 1) after
            t steps. The paper's agents never switch.

    Raises:
        ValueError: If the probability is out of range.
    """
    if switch != BY_TIME:
        finite(f"switch, where it is not {BY_TIME!r},", switch, 0, 1)
    (episode,) = prepared(episode, options)
    goals, prior, (columns,) = goals_in([episode], options)
    nodes = rule(len(episode.trajectory), options.beta)
    table = np.vstack([log_table(nodes, options.noise), np.full(len(nodes.eps), -np.inf)])
    kinds = cell_steps(episode, options)[:, columns]
    assert len(table) == IMPOSSIBLE + 1
    log_agent, posterior = _goals_online(kinds, table, nodes, switch, -np.log(prior))
    return Growth(tuple(goals), log_agent, _devices_online(episode, options), posterior)


def _goals_online(
    kinds: np.ndarray, table: np.ndarray, nodes: Rule, switch: Switch, log_prior: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return log p_agt [T + 1] and the posterior [T + 1, G], given step kinds [T, G]."""
    goals = kinds.shape[1]
    weights = np.full((goals, len(nodes.eps)), log_prior)  # of goal and eps, jointly
    log_agent, posterior = [], []
    for t in range(len(kinds) + 1):
        if t:
            weights = weights + table[kinds[t - 1]]
        by_goal = nodes.integrate(weights)
        log_agent.append(logsumexp(by_goal))
        posterior.append(np.exp(by_goal - log_agent[-1]))
        fraction = 1 / (t + 1) if isinstance(switch, str) else switch
        if fraction and t:
            anew = np.log(fraction) + logsumexp(weights, axis=0) - np.log(goals)
            with np.errstate(divide="ignore"):
                weights = np.logaddexp(np.log1p(-fraction) + weights, anew)
    return np.array(log_agent), np.array(posterior)


def _devices_online(episode: Episode, options: Options) -> np.ndarray:
    """Return log p_dev [T + 1]."""
    steps = len(episode.trajectory)
    nodes = rule(steps)
    log_devices: dict[str, np.ndarray] = {}
    for what in options.observations:
        grown = devices.log_mixture_online(seen_in(episode, what, options), nodes, log_table(nodes))
        unassessed = steps + 1 - len(grown)  # the first step, where it is skipped
        log_devices[what] = np.append(np.zeros(unassessed), grown)
    log_devices["noise"] = np.append(0.0, np.cumsum(log_noise(episode, options)))
    return mix_devices(log_devices, options)
