"""Other people's tools train and look on, on our environments as they are."""

import sys
import types
from dataclasses import replace

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.vector import AutoresetMode
from gymnasium.wrappers import RecordVideo
from gymnasium.wrappers import vector as wrappers
from torch import nn

from astray import games  # and registers the environments

ID = "astray/maze-corner-small-v0"


def vector(n=8, **options):
    return gymnasium.make_vec(ID, num_envs=n, observation="symbolic", **options)


def test_stable_baselines3_trains_on_it():
    stable_baselines3 = pytest.importorskip("stable_baselines3")
    from astray.envs.sb3 import GameVecEnv

    env = GameVecEnv(vector(autoreset_mode="SameStep"))
    options = {
        "n_steps": 32,
        "batch_size": 64,
        "n_epochs": 2,
        "policy_kwargs": {"normalize_images": False},
    }
    model = stable_baselines3.PPO("MlpPolicy", env, seed=0, device="cpu", **options)
    before = [p.clone() for p in model.policy.parameters()]
    model.learn(3 * 32 * 8)
    assert model.num_timesteps == 3 * 32 * 8
    after = list(model.policy.parameters())
    assert any(not torch.equal(one, two) for one, two in zip(before, after, strict=True))
    assert all(p.isfinite().all() for p in after)
    env.close()


@pytest.mark.thorough  # `test_contract` has Gymnasium's checks, on which its wrapper relies
@pytest.mark.filterwarnings("ignore::DeprecationWarning", "ignore::UserWarning")
def test_torchrl_trains_on_it():
    pytest.importorskip("torchrl")
    from tensordict.nn import InteractionType, TensorDictModule
    from torchrl.envs.libs.gym import GymWrapper
    from torchrl.modules import OneHotCategorical, ProbabilisticActor, ValueOperator
    from torchrl.objectives import ClipPPOLoss
    from torchrl.objectives.value import GAE

    torch.manual_seed(0)
    env = GymWrapper(vector(autoreset_mode="Disabled"))  # it resets by itself
    env.set_seed(0)

    def body(out):
        return nn.Sequential(Floats(), nn.Linear(4 * 7 * 7, 32), nn.Tanh(), nn.Linear(32, out))

    logits = TensorDictModule(body(15), in_keys=["observation"], out_keys=["logits"])
    actor = ProbabilisticActor(
        logits,
        in_keys=["logits"],
        distribution_class=OneHotCategorical,
        return_log_prob=True,
        default_interaction_type=InteractionType.RANDOM,
    )
    critic = ValueOperator(body(1), in_keys=["observation"])
    with torch.no_grad():
        data = env.rollout(110, actor, break_when_any_done=False)
    assert data.batch_size == (8, 110) and data["observation"].dtype == torch.uint8
    assert data["next", "reward"].max() == 10 and data["next", "done"].any()
    loss = ClipPPOLoss(actor, critic)
    advantage = GAE(gamma=0.99, lmbda=0.95, value_network=critic)
    optimizer = torch.optim.Adam(loss.parameters(), 1e-2)
    told = []
    for _ in range(5):
        advantage(data)
        parts = loss(data.flatten(0, 1))
        total = parts["loss_objective"] + parts["loss_critic"] + parts["loss_entropy"]
        optimizer.zero_grad()
        total.backward()
        optimizer.step()
        told.append(float(parts["loss_critic"].detach()))
    assert np.isfinite(told).all() and told[-1] < told[0]
    env.close()


class Floats(nn.Module):
    def forward(self, planes):
        return planes.flatten(-3).float()


def test_a_script_of_one_page_trains_on_it():
    """As single-file implementations do it: next-step resets, arrays in, arrays out."""
    torch.manual_seed(0)
    env = wrappers.RecordEpisodeStatistics(vector(16))
    shape = int(np.prod(env.single_observation_space.shape))
    network = nn.Sequential(nn.Flatten(), nn.Linear(shape, 64), nn.Tanh(), nn.Linear(64, 16))
    optimizer = torch.optim.Adam(network.parameters(), 3e-3)
    observation, _ = env.reset(seed=1)
    lengths, ended = [], np.zeros(16, bool)
    for _ in range(4):
        logs, values, rewards, masks = [], [], [], []
        for _ in range(64):
            out = network(torch.from_numpy(observation).float())
            policy = torch.distributions.Categorical(logits=out[:, :15])
            action = policy.sample()
            observation, reward, terminated, truncated, info = env.step(action.numpy())
            logs.append(policy.log_prob(action))
            values.append(out[:, 15])
            rewards.append(torch.from_numpy(reward).float())
            masks.append(torch.from_numpy(~ended))  # a step that only resets has no reward
            assert (reward[ended] == 0).all()
            ended = terminated | truncated
            if "episode" in info:
                lengths += info["episode"]["l"][info["_episode"]].tolist()
        value, mask = torch.stack(values), torch.stack(masks)
        advantage = (torch.stack(rewards) - value) * mask
        loss = (advantage.detach() * -torch.stack(logs)).mean() + advantage.square().mean()
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        assert loss.isfinite()
    assert len(lengths) > 10 and min(lengths) >= 1 and max(lengths) <= 100
    env.close()


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_episode_statistics_are_those_of_the_episodes(mode):
    env = wrappers.RecordEpisodeStatistics(vector(4, autoreset_mode=mode))
    env.reset(seed=0)
    returns, lengths, told, counted = np.zeros(4), np.zeros(4, int), [], []
    fresh = np.zeros(4, bool)
    for actions in np.random.default_rng(0).integers(9, size=(300, 4)):
        _, reward, terminated, truncated, info = env.step(actions)
        returns, lengths = returns + reward, lengths + ~fresh
        ended = terminated | truncated
        for i in np.flatnonzero(ended):
            counted.append((returns[i], lengths[i]))
            told.append((info["episode"]["r"][i], info["episode"]["l"][i]))
            returns[i], lengths[i] = 0, 0
        fresh = ended if mode is AutoresetMode.NEXT_STEP else np.zeros(4, bool)
    assert len(told) > 8 and told == counted


def test_rewards_are_normalised():
    env = wrappers.NormalizeReward(vector(4))
    env.reset(seed=0)
    actions = np.random.default_rng(0).integers(9, size=(500, 4))
    rewards = np.stack([env.step(action)[1] for action in actions])
    assert 0 < rewards.max() < 10


@pytest.fixture
def videos(monkeypatch):
    """The frames of the videos that Gymnasium writes; in place of moviepy, which is not needed."""
    written = []

    class ImageSequenceClip:
        def __init__(self, frames, fps):
            self.frames = frames

        def write_videofile(self, path, **options):
            written.append(np.stack(self.frames))

    for name in ("moviepy", "moviepy.video", "moviepy.video.io"):
        monkeypatch.setitem(sys.modules, name, types.ModuleType(name))
    module = types.ModuleType("moviepy.video.io.ImageSequenceClip")
    module.ImageSequenceClip = ImageSequenceClip
    monkeypatch.setitem(sys.modules, module.__name__, module)
    return written


def test_videos_are_recorded(videos, tmp_path):
    short = replace(games.find("maze").variant("corner-small"), time_limit=20)
    made = gymnasium.make(ID, variant=short, render_mode="rgb_array")
    env = RecordVideo(made, str(tmp_path / "videos"))
    env.reset(seed=0)
    ended = False
    while not ended:
        _, _, terminated, truncated, _ = env.step(4)
        ended = terminated or truncated
    env.close()
    assert [video.shape for video in videos] == [(21, 512, 512, 3)]  # the beginning, and 20 steps


def test_frames_of_a_batch_are_recorded(videos, tmp_path):
    env = wrappers.RecordVideo(
        vector(4, render_mode="rgb_array"), str(tmp_path / "videos"), video_length=10
    )
    env.reset(seed=0)
    for _ in range(12):
        env.step(np.full(4, 4))
    env.close()
    assert [len(video) for video in videos] == [11]  # the beginning, and 10 steps
