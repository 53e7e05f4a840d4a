"""Distillation: a student learns its teacher's policy in its own episodes.

The student acts, in training levels alone, so that the student's ambiguity about goals stays. In
each of its states the teacher gives action probabilities. The teacher is an agent or the game's
exact solver, and may stop before the training ends. An agent that stays to the end gives its
values, too. Otherwise the critic learns from the student's own rewards: measured against the values
of a better policy, whatever a student does when it is alone would look like a loss.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from astray.acting import Actor, Answer, Turn
from astray.agents import policy
from astray.agents.recurrent import Recurrent
from astray.files import read, write_aside
from astray.record import trusted
from astray.training import ppo
from astray.training.config import Config
from astray.training.folders import TEACHER
from astray.training.ppo import Samples, Sequences
from astray.training.rollout import Rollout

SALT = 0x5CA77E4  # salt of random places
SURE = 0.9  # the chance that a solver gives its action; all others share what is left


@dataclass(frozen=True)
class Taught(Samples):
    """Samples with the teacher's policy; advantages are unused."""

    wanted: Tensor  # [..., actions] float32, logarithms of the teacher's probabilities


@dataclass(frozen=True)
class TaughtSequences(Sequences, Taught):
    """Samples of a student with memory."""


def give(weights: Path, run: Path, name: str = TEACHER) -> None:
    """Write another agent's weights to a run folder; raise ValueError if others are there."""
    path, data = run / name, read(weights)
    if path.exists():
        if read(path) != data:
            raise ValueError(f"{path} must be the agent at {weights}; it is another")
        return
    write_aside(path, data)


class Lessons:
    """Actor that asks a teacher about the states of another actor, the student."""

    def __init__(self, config: Config, student: Actor, rollout: Rollout):
        self.config, self.student, self.rollout = config, student, rollout
        shape = config.num_steps, len(rollout.player.images), rollout.player.actions
        self._wanted = torch.empty(shape, device=config.device)

    def begin(self, steps: int) -> None:
        """Prepare the student for a rollout after `steps` environment steps of training."""
        if self.config.lessons == "anywhere":
            self.rollout.player.scatter(np.random.default_rng([self.config.seed, SALT, steps]))

    def send(self, t: int, group: int, turn: Turn) -> None:
        self.student.send(t, group, turn)
        if t < len(self._wanted):  # while a GPU infers for the student
            self._wanted[t] = self.says(t, turn.begins)

    def receive(self, group: int) -> Answer:
        return self.student.receive(group)

    def samples(self) -> Taught:
        """Return the student's samples of a rollout, with the teacher's policies."""
        own = self.rollout.samples()
        made = TaughtSequences if isinstance(own, Sequences) else Taught
        return made(**vars(own), wanted=self._wanted)

    def says(self, t: int, begins: np.ndarray) -> Tensor:
        """Return log-probabilities [N, actions] for the current states.

        Args:
            t: Step of the rollout.
            begins: [N] bool, whether an episode has begun.
        """
        raise NotImplementedError


class Teacher(Lessons):
    """Lessons of an agent.

    Raises:
        ValueError: If it does not support the variant's observations.
    """

    def __init__(self, path: Path, config: Config, student: Actor, rollout: Rollout):
        super().__init__(config, student, rollout)
        self.network, known = policy.load(path, config.game, config.device)
        size = self.network.memory if isinstance(self.network, Recurrent) else 0
        # What a teacher with memory remembers of the student's episodes.
        self.state = torch.zeros((len(rollout.player.images), size), device=config.device)
        observation = "symbolic" if known.largest else "image"
        self.shown = rollout.player.envs[0].shown_as(observation, config.art)
        sees = self.shown().shape[1:]
        if (sees, rollout.player.actions) != (known.shape, known.actions):
            raise ValueError(
                f"the teacher {config.teacher} must know observations of {sees}, those of "
                f"{config.variant}; it knows {known.shape}"
            )
        self._value = torch.empty(self._wanted.shape[:2], device=config.device)

    def samples(self) -> Taught:
        made = super().samples()
        is_whole = self.config.learns_values_of_teacher
        return replace(made, target=self._value) if is_whole else made

    def says(self, t: int, begins: np.ndarray) -> Tensor:
        observations = torch.from_numpy(self.shown()).to(self.config.device)
        if isinstance(self.network, Recurrent):
            first = torch.from_numpy(begins).to(self.config.device)
            logits, values, self.state = self.network.recall(observations, self.state, first)
        else:
            logits, values = self.network(observations)
        self._value[t] = values
        return ppo.log_probabilities(logits)


class Solver(Lessons):
    """Lessons of the game's exact solver, which takes the shortest way to the intended goal."""

    def __init__(self, config: Config, student: Actor, rollout: Rollout):
        super().__init__(config, student, rollout)
        self.goal = config.intended_goal()
        self.experts: list[Callable[[Any], int] | None] = [None] * len(rollout.player.images)

    def begin(self, steps: int) -> None:
        """Plan anew, as a training that was resumed must do."""
        super().begin(steps)
        self.experts = [None] * len(self.experts)

    def says(self, t: int, begins: np.ndarray) -> Tensor:
        player = self.rollout.player
        states, shape = trusted(player.envs[0].get_state()), self._wanted.shape[1:]
        wanted = np.full(shape, np.log((1 - SURE) / (player.actions - 1)), np.float32)
        for i, s in enumerate(states):
            expert = self.experts[i]
            if expert is None or begins[i]:
                expert = self.experts[i] = player.game.solver.expert(s, self.goal)
            wanted[i, expert(s)] = np.log(SURE)
        return torch.from_numpy(wanted).to(self.config.device)


def loss(network: Callable, minibatch: Samples, config: Config) -> dict[str, Tensor]:
    """Return the student's distillation loss on a minibatch [B], as for `ppo.loss`.

    Samples without the teacher use `ppo.loss` itself. Logged are kl, KL(teacher || student), and
    agree, the fraction of samples with the same most likely action.
    """
    if not isinstance(minibatch, Taught):
        return ppo.loss(network, minibatch, config)
    logits, value = ppo.outputs(network, minibatch)
    of_all = ppo.log_probabilities(logits)
    wanted = minibatch.wanted
    kl = (wanted.exp() * (wanted - of_all)).sum(-1).mean()
    critic = 0.5 * (value - minibatch.target).square().mean()
    with torch.no_grad():
        agree = (of_all.argmax(-1) == wanted.argmax(-1)).float().mean()
    return {
        "loss": kl + config.value_weight * critic,
        "kl": kl,
        "value_loss": critic,
        "entropy": ppo.entropy(of_all),
        "agree": agree,
    }
