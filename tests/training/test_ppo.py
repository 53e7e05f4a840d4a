"""Every formula of PPO against a slow, obvious version; the networks against the paper."""

import math
import re

import numpy as np
import pytest
import torch

from astray.agents.impala import Impala
from astray.agents.mlp import MLP, CircleEmbedding
from astray.agents.policy import Architecture, load, outputs, weights
from astray.training import ppo
from astray.training.ppo import RewardNormaliser

SHAPE, LARGEST = (4, 7, 7), (1, 1, 6, 6)


def naive_advantages(reward, value, after, terminated, truncated, gamma, lam):
    """The sum of discounted errors up to the end of the episode, term by term."""
    steps, n = reward.shape
    result = np.zeros((steps, n))
    for i in range(n):
        for t in range(steps):
            for k in range(t, steps):
                bootstrap = 0.0 if terminated[k, i] else gamma * after[k, i]
                error = reward[k, i] + bootstrap - value[k, i]
                result[t, i] += (gamma * lam) ** (k - t) * error
                if terminated[k, i] or truncated[k, i]:
                    break
    return result


def test_advantages_are_the_sum_of_errors_to_the_episodes_end():
    random = np.random.default_rng(0)
    reward, value, after = random.normal(size=(3, 20, 4))
    terminated = random.random((20, 4)) < 0.15
    truncated = (random.random((20, 4)) < 0.15) & ~terminated
    expected = naive_advantages(reward, value, after, terminated, truncated, 0.9, 0.8)
    given = (torch.from_numpy(x) for x in (reward, value, after, terminated, truncated))
    np.testing.assert_allclose(ppo.advantages(*given, gamma=0.9, lam=0.8), expected, atol=1e-6)


def test_losses_are_their_definitions_sample_by_sample():
    random = np.random.default_rng(1)
    log_ratio, advantage, value, old, target = random.normal(size=(5, 50))
    surrogate, critic = [], []
    for k in range(50):
        ratio = math.exp(log_ratio[k])
        bounded = min(max(ratio, 0.8), 1.2)
        surrogate.append(min(ratio * advantage[k], bounded * advantage[k]))
        near = old[k] + min(max(value[k] - old[k], -0.2), 0.2)
        critic.append(max((value[k] - target[k]) ** 2, (near - target[k]) ** 2))
    tensors = [torch.from_numpy(x) for x in (log_ratio, advantage, value, old, target)]
    assert ppo.policy_loss(*tensors[:2], 0.2).item() == pytest.approx(-np.mean(surrogate))
    assert ppo.value_loss(*tensors[2:], 0.2).item() == pytest.approx(0.5 * np.mean(critic))


def test_entropy_is_that_of_the_distributions():
    logits = torch.randn(30, 7, dtype=torch.float64)
    expected = torch.distributions.Categorical(logits=logits).entropy().mean()
    assert ppo.entropy(ppo.log_probabilities(logits)).item() == pytest.approx(expected.item())


def test_samples_have_the_probabilities_of_the_policy():
    logits = torch.tensor([0.0, 1.0, -2.0, 0.5])
    noise = torch.rand((200_000, 4), generator=torch.Generator().manual_seed(0))
    action, log_probability = ppo.sample(logits.expand(200_000, 4), noise)
    expected = logits.softmax(0)
    rate = torch.bincount(action, minlength=4) / len(action)
    torch.testing.assert_close(rate, expected, atol=0.005, rtol=0)
    torch.testing.assert_close(log_probability.exp(), expected[action])


def test_samples_survive_the_ends_of_the_noise():
    action, log_probability = ppo.sample(torch.zeros(2, 3), torch.tensor([[0.0] * 3, [1.0] * 3]))
    assert action.min() >= 0 and log_probability.isfinite().all()


def test_advantages_are_normalised_over_all_entries():
    x = ppo.normalised(torch.randn(10, 20) * 5 + 3)
    assert x.mean().item() == pytest.approx(0, abs=1e-6)
    assert x.std().item() == pytest.approx(1, abs=1e-6)


def test_reward_normalisation_keeps_the_moments_of_all_returns_so_far():
    random = np.random.default_rng(2)
    normaliser, history = RewardNormaliser(4, gamma=0.9), []
    running = np.zeros(4)
    for _ in range(200):
        reward, ended = random.normal(size=4) * 3, random.random(4) < 0.1
        running = 0.9 * running + reward
        history.append(running.copy())
        given = normaliser(reward, ended)
        spread = np.var(history)
        np.testing.assert_allclose(given, np.clip(reward / np.sqrt(spread), -10, 10), rtol=2e-3)
        running[ended] = 0
    assert normaliser.mean == pytest.approx(np.mean(history), abs=1e-3)


@pytest.mark.parametrize("vast", [2e154, -1e300])
def test_rewards_whose_variance_is_no_number_are_refused(vast):
    normaliser, ended = RewardNormaliser(2), np.zeros(2, bool)
    normaliser(np.array([1e140, 1.0]), ended)
    with pytest.raises(
        ValueError, match=re.escape(f"rewards up to {abs(vast):g} are too large for a v")
    ):
        normaliser(np.array([1.0, vast]), ended)


def test_normalised_rewards_are_clipped():
    normaliser = RewardNormaliser(1)
    for _ in range(100):
        normaliser(np.zeros(1), np.zeros(1, bool))
    assert normaliser(np.array([1e6]), np.zeros(1, bool))[0] == 10


@pytest.mark.parametrize("scale, count", [(1, 626_256), (4, 3_653_136)])
def test_impala_has_the_originals_parameters(scale, count):
    network = Impala((64, 64, 3), 15, scale)
    assert sum(p.numel() for p in network.parameters()) == count
    assert all(not p.any() for name, p in network.named_parameters() if name.endswith("bias"))
    logits, value = network(torch.randint(0, 256, (2, 64, 64, 3), dtype=torch.uint8))
    assert logits.shape == (2, 15) and value.shape == (2,)
    assert logits.abs().max() < 0.5  # a near-uniform policy


def test_every_activation_of_impala_is_a_named_module():
    names = [n for n, m in Impala((64, 64, 3), 15).named_modules() if isinstance(m, torch.nn.ReLU)]
    assert len(names) == 3 * 2 * 2 + 2  # three blocks, two residual units, two each; features
    assert "block2.residual1.relu1" in names and "features.relu" in names


def test_the_small_network_sees_every_plane():
    network = MLP(SHAPE, list(LARGEST), 15)
    base = torch.zeros((1, *SHAPE), dtype=torch.uint8)
    for plane in range(4):
        other = base.clone()
        other[0, plane, 4, 4] = 1
        assert not torch.equal(network(base)[1], network(other)[1])


def test_categories_are_spread_on_a_circle_around_nothing():
    planes = torch.zeros((1, 4, 1, 7), dtype=torch.uint8)
    planes[0, 2, 0] = torch.arange(7)
    points = CircleEmbedding(list(LARGEST))(planes)[0, [2, 4], 0].T
    assert not points[0].any()
    torch.testing.assert_close(points[1:].norm(dim=1), torch.ones(6))
    assert torch.pdist(points).min() > 0.99


@pytest.mark.parametrize("name", ["impala", "mlp"])
def test_a_saved_network_is_loaded_as_it_was(name, tmp_path):
    image = name == "impala"
    shape, largest = ((64, 64, 3), ()) if image else (SHAPE, LARGEST)
    architecture = Architecture(name, shape, largest, 15)
    network = architecture.build()
    (tmp_path / "agent").write_bytes(weights(network, architecture, "maze"))
    loaded, known = load(tmp_path / "agent", "maze")
    assert known == architecture
    x = torch.randint(0, 2, (3, *shape), dtype=torch.uint8)
    assert torch.equal(network(x)[0], loaded(x)[0])


@pytest.mark.parametrize("cut", [0, 7, 100, 5000])
def test_a_truncated_agent_is_explained(cut, tmp_path):
    architecture = Architecture("mlp", SHAPE, LARGEST, 15)
    path = tmp_path / "agent.safetensors"
    path.write_bytes(weights(architecture.build(), architecture, "maze")[:cut])
    with pytest.raises(ValueError, match="not an agent that can be used"):
        load(path, "maze")
    with pytest.raises(FileNotFoundError, match="no agent at"):
        load(tmp_path / "none", "maze")


def test_a_network_for_other_observations_is_refused():
    with pytest.raises(ValueError, match="'impala' does not see symbolic planes"):
        Architecture("impala", SHAPE, LARGEST, 15).build()


def test_outputs_do_not_depend_on_the_batch():
    network = Architecture("mlp", SHAPE, LARGEST, 15).build()
    x = torch.randint(0, 2, (300, *SHAPE), dtype=torch.uint8)
    logits, values = outputs(network, x)
    for part in (x[:1], x[:7], x[:299]):
        some_logits, some_values = outputs(network, part)
        assert torch.equal(some_logits, logits[: len(part)])
        assert torch.equal(some_values, values[: len(part)])
