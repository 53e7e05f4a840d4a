"""Rollouts: what a network did and saw in a player's environments, as samples to learn from."""

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from astray.acting import Answer, Turn
from astray.training import parallel, ppo
from astray.training.config import Config
from astray.training.levels import Played
from astray.training.player import Player, Stepped
from astray.training.ppo import Samples, Sequences


class Rollout:
    """Buffers for a player's observations and actions, [slots + 1, N]; see `Samples`.

    The last slot has only the observations after the final step, and their values.
    """

    def __init__(self, player: Player, slots: int, memory: int = 0):
        """Allocate buffers that are reused cyclically.

        Args:
            slots: Number of steps.
            memory: Size of the network's state, 0 without memory.
        """
        self.player, self.slots, device = player, slots, torch.device(player.device)
        (n, *shape), kind = player.images.shape, player.images.dtype
        self.observation = torch.empty((slots + 1, n, *shape), dtype=kind, device=device)
        self.action = torch.empty((slots + 1, n), dtype=torch.int64, device=device)
        self.log_probability, self.value = torch.empty((2, slots + 1, n), device=device)
        self.advantage, self.target = torch.zeros((2, slots, n), device=device)
        self.begins = torch.zeros((slots + 1, n), dtype=torch.bool, device=device)
        # The network's state before and after the current observation, and at the beginning.
        self.state, self.after, self._first = torch.zeros((3, n, memory), device=device)

    def begin(self, steps: int) -> None:
        """Draw the noise for a rollout's actions, and clear the records."""
        self.noise, self._first = self.player.noise(steps), self.state.clone()
        shape = steps, len(self.state)
        self.reward, ends = np.empty(shape), np.empty((2, *shape), bool)
        self.terminated, self.truncated = ends

    def recalled(self, t: int, group: int, begins: np.ndarray) -> tuple[Tensor, ...]:
        """Return a recurrent network's further inputs: states [n, memory] and `begins` [n] bool."""
        if not self.state.shape[1]:
            return ()
        slot, where = t % (self.slots + 1), self.player.groups[group]
        if t:  # otherwise a rollout begins where the last one ended
            self.state[where] = self.after[where]
        self.begins[slot, where] = torch.from_numpy(begins).to(self.begins.device)
        return self.state[where].clone(), self.begins[slot, where]  # a network may write to it

    def note(self, step: Stepped) -> None:
        """Record the results of a step."""
        t, where, *results, _ = step
        self.reward[t, where], self.terminated[t, where], self.truncated[t, where] = results

    def estimate(self, config: Config, next_value: Tensor) -> None:
        """Compute advantages and value targets, [T, N], from a rollout's rewards.

        Rewards are normalised with the player's statistics, advantages over all environments.
        """
        player, value, did = self.player, self.value[:-1], (self.terminated, self.truncated)
        reward = self.take_in() if config.normalise_reward else self.reward
        paid = torch.from_numpy(reward).float().to(value.device)
        ends, cuts = (torch.from_numpy(x).to(value.device) for x in did)
        if config.timeouts == "terminate":
            ends = ends | cuts
        advantage = ppo.advantages(paid, value, next_value, ends, cuts, config.gamma, config.lam)
        player.scored(lambda: Played(self.reward, advantage.numpy(force=True), *did))
        self.target[:] = advantage + value
        if config.normalise_advantage:
            joined = torch.from_numpy(parallel.joined(advantage.numpy(force=True), 1))
            advantage = ppo.normalised(joined.to(value.device))[:, player.here]
        self.advantage[:] = advantage

    def take_in(self) -> np.ndarray:
        """Return normalised rewards [T, N]; update the statistics in a rollout to learn from."""
        player, both = self.player, (self.reward, self.terminated | self.truncated)
        if not player.learns:
            return player.normaliser.scaled(self.reward)
        pairs = zip(*(parallel.joined(x, 1) for x in both), strict=True)
        return np.stack([player.normaliser(*pair)[player.here] for pair in pairs])

    def samples(self) -> Samples:
        """Return the training data, which the next rollout overwrites."""
        acted = self.observation, self.action, self.log_probability, self.value
        whole: Any = (*(x[:-1] for x in acted), self.advantage, self.target)
        if self.state.shape[1]:
            return Sequences(*whole, begins=self.begins[:-1], state=self._first)
        return Samples(*whole)


def act(network: Callable, noise: Tensor, *shown_here: Tensor) -> tuple[Tensor, ...]:
    """Sample actions; return them, their log-probabilities and the critic's values, all [n].

    A network with memory also returns its new states. ValueError is raised for anything else.
    """
    wanted = [tuple(noise.shape), (len(noise),), *(tuple(x.shape) for x in shown_here[1:2])]
    parts = returned if isinstance(returned := network(*shown_here), tuple | list) else [returned]
    got = [tuple(x.shape) if isinstance(x, Tensor) else type(x).__name__ for x in parts]
    if got != wanted:
        raise ValueError(
            f"a network must return logits, values and, with memory, its state, {wanted}; got {got}"
        )
    logits, value, *state = parts
    if [x.dtype for x in state] == [torch.float64]:
        raise ValueError("a network's state must be of float32, as it is given; got float64")
    return *ppo.sample(logits, noise), value, *state


class Actor:
    """Actor that samples from the network's policy, and records observations and actions."""

    def __init__(self, network: Callable, rollout: Rollout):
        self.network, self.rollout = network, rollout
        self._chosen = [np.empty(0, np.int64)] * len(rollout.player.groups)

    @torch.no_grad()
    def send(self, t: int, group: int, turn: Turn) -> None:
        kept = self.rollout
        at = t % (kept.slots + 1), kept.player.groups[group]
        kept.observation[at] = turn.observations
        noise = kept.noise[min(t, len(kept.noise) - 1), at[1]]
        memory = kept.recalled(t, group, turn.begins)
        action, old, value, *state = act(self.network, noise, kept.observation[at], *memory)
        kept.action[at], kept.log_probability[at], kept.value[at] = action, old, value
        if state:
            kept.after[at[1]] = state[0]
        self._chosen[group] = action.numpy(force=True)

    def receive(self, group: int) -> Answer:
        return Answer(self._chosen[group])
