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

from astray.agents import policy as trained
from astray.analysis.policies import Observation
from astray.analysis.trained import AT_ONCE, chosen
from astray.bounds import shown
from astray.envs.vector import GameVectorEnv
from astray.game import OWN
from astray.training.trainer import Trainer
from astray.words import check_word


class Model(Protocol):
    """What there is of a model of Stable-Baselines3 here."""

    def predict(
        self, observation: Any, *, deterministic: bool = False
    ) -> tuple[np.ndarray, Any]: ...


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

    def actions(self, env: GameVectorEnv, observations: np.ndarray) -> np.ndarray:
        """An action for each of `observations` [N, ...]; ValueError where there is none."""
        chosen, count = np.asarray(self.choose(observations)), len(env.game.actions)
        if chosen.shape != (len(observations),) or not np.issubdtype(chosen.dtype, np.integer):
            raise ValueError(
                f"{self.name} must return {len(observations)} integers, an action for each "
                f"observation; got {chosen.dtype} of shape {chosen.shape}"
            )
        if chosen.min() < 0 or chosen.max() >= count:
            raise ValueError(
                f"actions of {self.name} must be from 0 to {count - 1}; got {chosen.min()} to "
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
) -> Function:
    """A model of Stable-Baselines3 as a policy; its actions are drawn by torch's random state.

    greedy  takes its likeliest action instead
    """
    return Function(
        lambda shown: model.predict(shown, deterministic=greedy)[0], name, observation, art
    )


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

    def actions(self, env: GameVectorEnv, observations: np.ndarray) -> np.ndarray:
        config = self.trainer.config
        shown = torch.from_numpy(observations).to(config.device)
        logits, _ = trained.outputs(self.trainer.network, shown, AT_ONCE[self.observation])
        return chosen(logits, self.mode, config.seed, env)


def from_trainer(trainer: Trainer, mode: Literal["sampled", "greedy"] = "sampled") -> Learner:
    """The agent of a training that goes on, as a policy: what its next checkpoint would do.

    mode  "sampled" draws its actions from its policy, "greedy" takes the likeliest
    """
    check_word("mode", mode, Literal["sampled", "greedy"])
    return Learner(trainer, mode)
