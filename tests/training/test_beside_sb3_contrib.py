"""Our PPO for networks with memory is sb3-contrib's RecurrentPPO: rollouts and updates."""

import copy

import numpy as np
import pytest
import torch

from astray.training.config import PRESETS
from astray.training.loop import collect, update
from astray.training.ppo import Sequences, normalised
from astray.training.trainer import Trainer

pytest.importorskip("sb3_contrib")
from sb3_contrib import RecurrentPPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from benchmarks import sb3

CONFIG = PRESETS["paper"].changed(
    game="maze",
    variant="corner-small",
    knobs={"world": 5, "largest": 5, "time_limit": 20},
    observation="symbolic",
    network="mlp+lstm",
    width=32,
    num_envs=64,
    num_steps=32,
    minibatches=1,
    gamma=0.99,
    learning_rate=1e-4,
    anneal=False,
    normalise_advantage=True,
    steps=10**6,
    seed=2,  # with which untrained mice do different things
    bfloat16=False,
)


class Body(BaseFeaturesExtractor):
    """A copy of our network's features."""

    def __init__(self, space, body):
        super().__init__(space, body.policy.in_features)
        self.body = copy.deepcopy(body)

    def forward(self, observations):
        return self.body.hidden(observations.to(torch.uint8))


class Keep(BaseCallback):
    """Keeps the first rollout as it was before learning from it."""

    def _on_step(self):
        return True

    def _on_rollout_end(self):
        self.rollout = copy.deepcopy(self.locals["rollout_buffer"])


def both(config, sure=1.0):
    """Our trainer and theirs with the same weights; their critic does not train the LSTM."""
    trainer = Trainer(config)
    net, body = trainer.network, trainer.network.body
    with torch.no_grad():
        body.policy.weight.mul_(sure)
    body.heads = lambda x: (body.policy(x), body.value(x.detach()).squeeze(-1))
    given = dict(
        features_extractor_class=Body, features_extractor_kwargs={"body": body}, net_arch=[],
        lstm_hidden_size=net.width, shared_lstm=True, enable_critic_lstm=False, ortho_init=False,
        optimizer_kwargs={"eps": 1e-5}, normalize_images=False,
    )  # fmt: skip
    model = RecurrentPPO(
        "MlpLstmPolicy", sb3.played(config), policy_kwargs=given, **sb3.settings(config)
    )
    model.set_logger(Logger(None, []))
    for ours, theirs in pairs(net, model.policy):
        theirs.data.copy_(ours)
    return trainer, model


def pairs(net, policy):
    """The weights of both, layer by layer."""
    lstm = dict(policy.lstm_actor.named_parameters())
    yield from ((x, lstm[f"{name}_l0"]) for name, x in net.cell.named_parameters())
    features = dict(policy.features_extractor.body.named_parameters())
    for name, x in net.body.named_parameters():
        head, _, part = name.partition(".")
        heads = {"policy": policy.action_net, "value": policy.value_net}
        yield x, getattr(heads[head], part) if head in heads else features[name]


def learned(config, model):
    keep = Keep()
    model.learn(config.batch, callback=keep)
    return keep.rollout


def test_rollouts_with_memory_are_the_same():
    trainer, model = both(CONFIG, sure=1e8)  # of its actions, so that both draw the same
    model.get_env().seed(int(trainer.player.envs[0].states["seed"][0]))
    theirs, ours = learned(CONFIG, model), collect(trainer)
    assert isinstance(ours, Sequences)
    ends = [length for _, length, *_ in trainer.player.recent]
    assert 0 < sum(length < 20 for length in ends) < len(ends), "ends of both kinds"
    np.testing.assert_array_equal(ours.observation, theirs.observations)
    np.testing.assert_array_equal(ours.action, theirs.actions[:, :, 0])
    np.testing.assert_array_equal(ours.begins, theirs.episode_starts)
    np.testing.assert_allclose(ours.value, theirs.values, atol=1e-4)
    np.testing.assert_allclose(ours.target, theirs.returns, atol=1e-4)
    advantage = normalised(torch.from_numpy(theirs.advantages))
    np.testing.assert_allclose(ours.advantage, advantage, atol=1e-4)


def test_updates_of_networks_with_memory_are_the_same():
    trainer, model = both(CONFIG)
    before = [x.clone() for x in trainer.network.parameters()]
    kept = learned(CONFIG, model)
    given = map(
        torch.from_numpy,
        (kept.observations.astype(np.uint8), kept.actions[:, :, 0].astype(np.int64), kept.log_probs,
         kept.values, kept.advantages, kept.returns, kept.episode_starts > 0),
    )  # fmt: skip
    observation, action, log_probability, value, advantage, target, begins = given
    rollout = Sequences(
        observation, action, log_probability, value, normalised(advantage), target, begins,
        torch.zeros(CONFIG.num_envs, trainer.memory),
    )  # fmt: skip
    update(trainer, rollout, CONFIG.learning_rate)
    moved = dict(zip(map(id, trainer.network.parameters()), before, strict=True))
    for ours, theirs in pairs(trainer.network, model.policy):
        size = (ours - moved[id(ours)]).norm()
        assert size > 1e-6 and (ours - theirs).norm() < 1e-2 * size
