"""What else is played as an agent is: a plain callable, a model of Stable-Baselines3, a training.

policy = Function(lambda images: np.full(len(images), 7), name="right")
evaluate(policy, "coinrun", "coin-anywhere", range(1000))
evaluate(from_sb3(PPO.load("mouse.zip")), "maze", "anywhere", range(1000))
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, Protocol

import numpy as np
import torch
from gymnasium.spaces import Discrete

from astray.acting import Answer, Turn
from astray.agents import policy as trained
from astray.agents.recurrent import Recurrent
from astray.analysis.trained import AT_ONCE, chosen, recalled
from astray.bounds import shown
from astray.envs.vector import Observation
from astray.game import OWN
from astray.training.trainer import Trainer
from astray.words import check_word


class Model(Protocol):
    """What there is of a model of Stable-Baselines3 here."""

    def predict(
        self,
        observation: Any,
        state: tuple[np.ndarray, ...] | None = None,
        episode_start: np.ndarray | None = None,
        deterministic: bool = False,
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...] | None]: ...


@dataclass
class Function:
    """A function of a batch of observations [N, ...] uint8 that returns actions [N], as a policy.

    observation  that it is shown: images [N, 64, 64, 3] or symbolic planes [N, C, H, W]
    art          that images are drawn with

    Raises ValueError where it cannot be called, or returns something else than an action for each.
    """

    choose: Callable[[np.ndarray], np.ndarray]
    name: str = "function"
    observation: Observation = "image"
    art: str = OWN

    def __post_init__(self) -> None:
        if not callable(self.choose):
            raise ValueError(f"choose must be a function of observations; got {shown(self.choose)}")

    def actions(self, turn: Turn) -> Answer:
        """Return an action for each of what is shown; ValueError where there is none."""
        return Answer(_actions(self.name, self.choose(turn.observations), turn))


@dataclass
class Predictor:
    """A model of Stable-Baselines3 as a policy; see `from_sb3`."""

    model: Model
    name: str
    greedy: bool
    observation: Observation
    art: str

    def actions(self, turn: Turn) -> Answer:
        chosen, state = self.model.predict(
            turn.observations,
            state=_turned(turn.memory),
            episode_start=turn.begins,
            deterministic=self.greedy,
        )
        return Answer(_actions(self.name, chosen, turn), _turned(state))


def _turned(state: tuple[np.ndarray, ...] | None) -> tuple[np.ndarray, ...] | None:
    """A recurrent model's state, [layers, N, ...], by episode, [N, layers, ...]; or back."""
    return None if state is None else tuple(np.swapaxes(part, 0, 1) for part in state)


def _actions(name: str, chosen: Any, turn: Turn) -> np.ndarray:
    """The actions [N] that a policy of that name chose; ValueError where they are none."""
    chosen, n, space = np.asarray(chosen), turn.env.num_envs, turn.env.single_action_space
    if not isinstance(space, Discrete):  # of a world, which sees itself what its actions are
        return chosen
    first, count = int(space.start), int(space.n)
    if chosen.shape != (n,) or not np.issubdtype(chosen.dtype, np.integer):
        raise ValueError(
            f"{name} must return {n} integers, an action for each observation; got "
            f"{chosen.dtype} of shape {chosen.shape}"
        )
    if chosen.min() < first or chosen.max() >= first + count:
        raise ValueError(
            f"actions of {name} must be from {first} to {first + count - 1}; got {chosen.min()} to "
            f"{chosen.max()}"
        )
    return chosen.astype(np.int64)


def from_sb3(
    model: Model,
    *,
    name: str = "sb3",
    greedy: bool = False,
    observation: Observation = "image",
    art: str = OWN,
) -> Predictor:
    """A model of Stable-Baselines3 as a policy; its actions are drawn by torch's random state.

    A recurrent one, as of sb3-contrib, begins every episode without memory, and keeps it in it.

    greedy  takes its likeliest action instead
    """
    return Predictor(model, name, greedy, observation, art)


@dataclass
class Learner:
    """The network of a training that goes on, as a policy; see `from_trainer`."""

    trainer: Trainer
    mode: Literal["sampled", "greedy"]

    @property
    def name(self) -> str:
        return self.mode

    @property
    def observation(self) -> Observation:
        return self.trainer.config.observation

    @property
    def art(self) -> str:
        return self.trainer.config.art

    def actions(self, turn: Turn) -> Answer:
        config, network, memory = self.trainer.config, self.trainer.network, None
        chunk = AT_ONCE[self.observation]
        if isinstance(network, Recurrent):
            logits, memory = recalled(network, turn, config.device, chunk)
        else:
            shown = torch.from_numpy(turn.observations).to(config.device)
            logits = trained.outputs(network, shown, chunk)[0]
        return Answer(chosen(logits, self.mode, config.seed, turn.env), memory)


def from_trainer(trainer: Trainer, mode: Literal["sampled", "greedy"] = "sampled") -> Learner:
    """The agent of a training that goes on, as a policy: what its next checkpoint would do.

    mode  "sampled" draws its actions from its policy, "greedy" takes the likeliest
    """
    check_word("mode", mode, Literal["sampled", "greedy"])
    return Learner(trainer, mode)
