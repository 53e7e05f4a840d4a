"""Our environments and networks in Stable-Baselines3, with PPO set as ours is."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import Any, cast

import gymnasium
import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.distributions import CategoricalDistribution
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.policies import ActorCriticPolicy, BasePolicy
from stable_baselines3.common.type_aliases import Schedule
from stable_baselines3.common.vec_env import VecEnv, VecMonitor, VecNormalize
from torch import Tensor, nn

from astray.envs.sb3 import GameVecEnv
from astray.envs.vector import GameVectorEnv
from astray.training.config import Config


class NetworkPolicy(BasePolicy):
    """One of our networks, with all that Stable-Baselines3's PPO asks of a policy."""

    def __init__(
        self,
        observation_space: gymnasium.Space,
        action_space: gymnasium.spaces.Discrete,
        lr_schedule: Schedule,
        use_sde: bool,
        network: nn.Module,
    ):
        super().__init__(observation_space, action_space)
        assert not use_sde, "it explores by sampling"
        self.network = network
        self.distribution = CategoricalDistribution(int(action_space.n))
        self.optimizer = torch.optim.Adam(
            network.parameters(), lr_schedule(1), eps=1e-5, fused=True
        )

    def forward(self, obs: Tensor, deterministic: bool = False) -> tuple[Tensor, Tensor, Tensor]:
        """Actions, values and log-probabilities, all [B]."""
        logits, values = self.network(obs)
        chosen = self.distribution.proba_distribution(logits)
        actions = chosen.get_actions(deterministic)
        return actions, values, chosen.log_prob(actions)

    def predict_values(self, obs: Tensor) -> Tensor:
        return self.network(obs)[1]

    def evaluate_actions(self, obs: Tensor, actions: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Values, log-probabilities and entropies, all [B]."""
        logits, values = self.network(obs)
        chosen = self.distribution.proba_distribution(logits)
        return values, chosen.log_prob(actions), cast(Tensor, chosen.entropy())

    def _predict(self, observation: Any, deterministic: bool = False) -> Tensor:
        return self.forward(observation, deterministic)[0]


def ppo(config: Config, network: nn.Module) -> PPO:
    """Stable-Baselines3's PPO with the settings of `config`, beginning with a copy of `network`.

    Two differences are left. It normalises advantages in each minibatch, ours over the rollout.
    And where a value has moved by more than `config.clip` since the rollout, its loss is that of
    the clipped value, ours the larger of the two: only ours brings back one that moved away.
    """
    policy = cast(type[ActorCriticPolicy], NetworkPolicy)
    given = {"network": copy.deepcopy(network)}
    model = PPO(policy, played(config), policy_kwargs=given, **settings(config))
    model.set_logger(Logger(None, []))  # or it makes a temporary folder at each `learn`
    return model


def played(config: Config) -> VecEnv:
    """Our environments with the rewards that are learned from."""
    if config.anneal or config.timeouts != "bootstrap" or not config.normalise_advantage:
        raise ValueError("it needs anneal=False, timeouts='bootstrap', normalise_advantage=True")
    env = GameVectorEnv(
        config.game,
        config.training_variant(),
        config.num_envs,
        observation=config.observation,
        levels=config.training_levels,
        autoreset_mode="SameStep",
        threads=config.threads,
    )
    played: VecEnv = VecMonitor(GameVecEnv(env))
    if config.normalise_reward:
        played = VecNormalize(played, norm_obs=False, gamma=config.reward_gamma, clip_reward=10.0)
    return played


def settings(config: Config) -> dict[str, Any]:
    """The settings by the names that they have there."""
    return {
        "learning_rate": config.learning_rate,
        "n_steps": config.num_steps,
        "batch_size": config.batch // config.minibatches,
        "n_epochs": config.epochs,
        "gamma": config.gamma,
        "gae_lambda": config.lam,
        "clip_range": config.clip,
        "clip_range_vf": config.clip,
        "ent_coef": config.entropy_weight,
        "vf_coef": config.value_weight / 2,  # our loss has half the squared error
        "max_grad_norm": config.gradient_norm,
        "seed": config.seed,
        "device": config.device,
    }


def learning_curve(model: PPO, iterations: Sequence[int]) -> list[float]:
    """Train `model`; mean length of its last 100 episodes after so many iterations each."""
    lengths, batch = [], model.n_steps * model.n_envs
    for k in iterations:
        model.learn(k * batch - model.num_timesteps, reset_num_timesteps=False)
        assert model.ep_info_buffer is not None
        lengths.append(float(np.mean([episode["l"] for episode in model.ep_info_buffer])))
    return lengths
