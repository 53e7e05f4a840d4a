"""A trained agent as a policy: what its network gives, and the actions drawn from it."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import torch

from astray.acting import Answer, Turn
from astray.agents import policy
from astray.agents.names import is_own
from astray.agents.recurrent import Recurrent
from astray.analysis.policies import episode_noise
from astray.bounds import of_kind
from astray.envs.vector import GameVectorEnv, Observation
from astray.game import OWN
from astray.training import ppo
from astray.words import check_words

# Observations that a network is shown together: for a large one more are no sooner, and those that
# a batch lacks to a multiple of it take their time, too.
AT_ONCE = {"symbolic": 64, "image": 16}
# Products of weights, of that many observations, for which a second thread costs more than it
# saves: five times as much where other programs keep the processors busy.
FEW = 200_000_000


def chosen(
    logits: torch.Tensor, mode: Literal["sampled", "greedy"], seed: int, env: GameVectorEnv
) -> np.ndarray:
    """The actions [N] that a policy of these logits [N, A] takes in the states of `env`."""
    if mode == "greedy":
        return logits.argmax(-1).numpy(force=True)
    uniform = torch.from_numpy(episode_noise(seed, env.states, logits.shape[1]))
    return ppo.sample(logits, uniform.to(logits.device))[0].numpy(force=True)


def recalled(
    network: Recurrent, turn: Turn, device: str, chunk: int
) -> tuple[torch.Tensor, torch.Tensor]:
    """The logits [N, A] of a network with memory in a turn, and its states then."""
    shown, begins = (torch.from_numpy(x).to(device) for x in (turn.observations, turn.begins))
    state = turn.memory
    if state is None:
        state = torch.zeros((len(shown), network.memory), device=device)
    logits, _, state = policy.outputs(network.recall, shown, chunk, state, begins)
    return logits, state


@dataclass
class Agent:
    """A trained network; `mode` "sampled" draws from its policy, "greedy" takes the likeliest."""

    path: Path  # of a checkpoint's agent.safetensors
    game: str
    mode: Literal["sampled", "greedy"] = "sampled"
    seed: int = 0  # of the sampling
    device: str = "cpu"
    art: str = OWN  # that it is shown
    network: torch.nn.Module = field(init=False, repr=False)
    architecture: policy.Architecture = field(init=False)
    threads: int = field(init=False, repr=False)  # that `outputs` takes on a CPU
    # Within `asked_once`: the last observations, and what the network gave for them.
    _keeps: bool = field(init=False, repr=False, compare=False, default=False)
    _kept: Any = field(init=False, repr=False, compare=False, default=None)

    def __post_init__(self) -> None:
        check_words(self)
        self.network, self.architecture = policy.load(self.path, self.game, self.device)
        self.threads = torch.get_num_threads()
        if is_own(self.architecture.name):  # others may not bear to be tried
            each = policy.products(self.network, self.architecture.shape, self.device)
            if each * AT_ONCE[self.observation] < FEW:
                self.threads = 1

    @property
    def name(self) -> str:
        return self.mode

    @property
    def observation(self) -> Observation:
        return "symbolic" if self.architecture.largest else "image"

    def outputs(self, observations: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Logits [N, A] and values [N] on `observations` [N, ...].

        Raises ValueError where the agent has a memory: what it says depends on what was before.
        """
        of_kind("observations", observations, np.ndarray)
        if isinstance(self.network, Recurrent):
            raise ValueError(
                f"the agent at {self.path} has a memory: it can be played, and not yet be asked "
                "about observations out of their episodes"
            )
        if self._kept and self._kept[0] is observations:
            return self._kept[1]
        shown, known = observations.shape[1:], self.architecture.shape
        if shown != known:
            raise ValueError(f"the agent sees observations of shape {known}, not {shown}")
        chunk = AT_ONCE[self.observation]
        shown_here = torch.from_numpy(observations).to(self.device)
        before = torch.get_num_threads()
        torch.set_num_threads(self.threads)
        try:
            logits, values = policy.outputs(self.network, shown_here, chunk)
        finally:
            torch.set_num_threads(before)
        if self._keeps:
            self._kept = observations, (logits, values)
        return logits, values

    @contextlib.contextmanager
    def asked_once(self) -> Iterator[None]:
        """What the network gives for an array is computed once, however often it is asked for.

        Within it nobody may change the array, or the network.
        """
        self._keeps = True
        try:
            yield
        finally:
            self._keeps, self._kept = False, None

    def actions(self, turn: Turn) -> Answer:
        env = turn.env
        if self.observation == "image" and env.art != self.art:
            raise ValueError(
                f"the agent is to see art {self.art!r}; these images are drawn with {env.art!r}"
            )
        memory = None
        if isinstance(self.network, Recurrent):
            chunk = AT_ONCE[self.observation]
            logits, memory = recalled(self.network, turn, self.device, chunk)
        else:
            logits, _ = self.outputs(turn.observations)
        if not logits.isfinite().all():
            raise ValueError(f"the agent at {self.path} gives logits that are not finite")
        return Answer(chosen(logits, self.mode, self.seed, env), memory)
