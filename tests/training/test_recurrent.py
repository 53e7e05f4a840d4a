"""Networks with memory: what they remember, and that PPO learns from whole sequences of them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

import astray
from astray.acting import steps
from astray.agents.mlp import MLP
from astray.agents.policy import Architecture
from astray.agents.recurrent import Recurrent
from astray.analysis.adapters import from_trainer
from astray.analysis.evaluate import evaluate
from astray.training import checkpoint, loop, ppo
from astray.training.trainer import Trainer
from helpers.trainings import TINY, digest, train_to_first_checkpoint

CELLS = ("gru", "lstm")
CONFIG = replace(TINY, network="mlp+gru", minibatches=4, validation=None)
SHAPE, LARGEST = (3, 5, 5), (1, 1, 3)
PLAYED = CONFIG.variant_for("anywhere-small")


def network(cell):
    torch.manual_seed(0)
    return Architecture(f"mlp+{cell}", SHAPE, LARGEST, 9, width=8).build()


def shown(*shape):
    return torch.randint(0, 2, (*shape, *SHAPE), dtype=torch.uint8)


def sigmoid(x):
    return 1 / (1 + torch.exp(-x))


def remembered(cell, features, state):
    """The next state of one episode, by the formulas of Cho et al. 2014 and of LSTMs."""
    w, u, b, c = (getattr(cell, f"{k}_{i}h") for i in "ih" for k in ("weight", "bias"))
    w, b, u, c = cell.weight_ih, cell.bias_ih, cell.weight_hh, cell.bias_hh
    n = len(features)
    x, h = w @ features + b, u @ state[:n] + c
    if isinstance(cell, nn.GRUCell):
        reset, update = sigmoid(x[:n] + h[:n]), sigmoid(x[n : 2 * n] + h[n : 2 * n])
        new = torch.tanh(x[2 * n :] + reset * h[2 * n :])
        return (1 - update) * new + update * state
    into, forget, new, out = (x + h).split(n)
    inner = sigmoid(forget) * state[n:] + sigmoid(into) * torch.tanh(new)
    return torch.cat([sigmoid(out) * torch.tanh(inner), inner])


def slow(net, observation, state, begins):
    """What `net` says of [T, N], an episode and a step at a time."""
    logits, values = [], []
    for t in range(len(observation)):
        rows = []
        for i in range(len(state)):
            before = torch.zeros_like(state[i]) if begins[t, i] else state[i]
            features = net.body.hidden(observation[t, i : i + 1])[0]
            rows.append(remembered(net.cell, features, before))
        state = torch.stack(rows)
        said = [net.body.heads(row[: net.width]) for row in rows]
        logits.append(torch.stack([one for one, _ in said]))
        values.append(torch.stack([one for _, one in said]))
    return torch.stack(logits), torch.stack(values), state


@pytest.mark.parametrize("cell", CELLS)
def test_a_cell_remembers_as_its_formulas_say_and_forgets_where_an_episode_begins(cell):
    net, observation = network(cell), shown(6, 4)
    state, begins = torch.randn(4, net.memory), torch.rand(6, 4) < 0.3
    ours, theirs = net.unroll(observation, state, begins), slow(net, observation, state, begins)
    by_step = Recurrent.unroll(net, observation, state, begins)
    for one, two, three in zip(ours, theirs, by_step, strict=True):
        assert torch.allclose(one, two, atol=1e-5) and torch.allclose(one, three, atol=1e-5)


@pytest.mark.parametrize("cell", CELLS)
def test_the_gradient_of_a_minibatch_is_that_of_its_sequences_unrolled(cell):
    net, (t, n) = network(cell), (5, 6)
    observation, begins = shown(t, n), torch.rand(t, n) < 0.3
    action, noise = torch.randint(0, 9, (t, n)), torch.randn(4, t, n)
    state = torch.randn(n, net.memory)
    whole = ppo.Sequences(observation, action, -2 + 0.1 * noise[0], *noise[1:], begins, state)
    some = torch.tensor([4, 1, 2])
    batch = whole.flat().at(some)
    gradients = []
    for said in (lambda _: batch.said(net), lambda _: tuple(
        x.flatten(0, 1) for x in slow(net, observation[:, some], state[some], begins[:, some])[:2]
    )):  # fmt: skip
        loss = ppo.loss(said, batch, CONFIG)["loss"]
        gradients.append(torch.autograd.grad(loss, list(net.parameters())))
    for one, two in zip(*gradients, strict=True):
        assert torch.allclose(one, two, atol=1e-5)
    assert any(x.abs().max() > 1e-3 for x in gradients[0])


@pytest.mark.parametrize("cell", CELLS)
def test_acting_and_learning_agree_in_every_rollout(cell):
    """Also in the second, which begins amid episodes."""
    trainer = Trainer(replace(CONFIG, network=f"mlp+{cell}"))
    for _ in range(2):
        rollout = loop.collect(trainer)
        assert isinstance(rollout, ppo.Sequences) and rollout.begins[1:].any()
        batch = rollout.at(torch.arange(len(rollout)))
        with torch.no_grad():
            logits, values = batch.said(trainer.network)
        old = ppo.log_probabilities(logits).gather(1, batch.action[:, None])[:, 0]
        assert torch.allclose(values, batch.value, atol=1e-5)
        assert torch.allclose(old, batch.log_probability, atol=1e-5)
    assert not rollout.begins[0].all() and rollout.state[~rollout.begins[0]].abs().max() > 0
    assert loop.update(trainer, rollout, 1e-3)["first_kl"] < 1e-9


def test_what_is_cut_off_is_valued_with_the_memory_of_its_episode(monkeypatch):
    trainer = Trainer(replace(CONFIG, num_steps=32, normalise_advantage=False))
    asked, values = [], type(trainer.fast).values

    def see(self, parts, memory):
        asked.extend(memory)
        return values(self, parts, memory)

    monkeypatch.setattr(type(trainer.fast), "values", see)
    rollout = loop.collect(trainer)
    state, cut = rollout.state, trainer.actor.rollout.truncated
    with torch.no_grad():
        for t in range(len(cut)):
            *_, state = trainer.network.recall(rollout.observation[t], state, rollout.begins[t])
            if cut[t].any():
                assert torch.allclose(asked.pop(0), state[torch.from_numpy(cut[t])], atol=1e-5)
    assert cut.any() and not asked


@pytest.mark.parametrize("cell", CELLS)
def test_a_stopped_training_with_memory_goes_on_to_the_bit(cell, tmp_path, monkeypatch):
    config = replace(CONFIG, network=f"mlp+{cell}", validation="anywhere-small")
    loop.train(config, tmp_path / "one", progress=False)
    train_to_first_checkpoint(config, tmp_path / "two", monkeypatch)
    loop.train(config, tmp_path / "two", progress=False)
    assert digest(tmp_path / "one") == digest(tmp_path / "two")
    assert np.frombuffer(digest(tmp_path / "one")["training.memory"], np.float32).any()


@pytest.mark.parametrize("batch", [1, 3, 256])
def test_an_agent_with_memory_plays_a_level_alike_in_any_batch(batch, tmp_path):
    loop.train(replace(CONFIG, steps=256), tmp_path, progress=False)
    agent, levels = astray.load_agent(tmp_path), range(10)
    moves = {k: [] for k in levels}
    for step in steps(agent, "maze", PLAYED, levels, batch=batch):
        for k, action in zip(step.level.tolist(), step.actions.tolist(), strict=True):
            moves[k].append(action)
    for k in (0, 7):
        alone = [s.actions[0] for s in steps(agent, "maze", PLAYED, [k])]
        assert moves[k] == alone
    with pytest.raises(ValueError, match="has a memory: it can be played, and not yet be asked"):
        agent.outputs(np.zeros((1, *agent.architecture.shape), np.uint8))


def test_a_training_with_memory_is_played_as_its_checkpoint(tmp_path):
    for iteration in loop.iterate(replace(CONFIG, steps=256), tmp_path):
        learner = from_trainer(iteration.trainer)
        now = evaluate(learner, "maze", PLAYED, range(5))
    saved = evaluate(astray.load_agent(tmp_path), "maze", PLAYED, range(5))
    assert now.equals(saved)


class Own(Recurrent):
    """Counts the steps of its episode, which it values."""

    memory = 1

    def __init__(self, a):
        super().__init__()
        self.body = MLP(a.shape, list(a.largest), a.actions, a.width)

    def recall(self, observation, state, begins):
        state = state * ~begins[:, None] + 1
        logits, value = self.body(observation)
        return logits, value + state[:, 0], state


def test_a_network_of_ones_own_remembers_by_the_same_interface():
    trainer = Trainer(CONFIG, network=Own)
    loop.collect(trainer)
    steps_before = np.concatenate([env.states["time"] for env in trainer.player.envs])
    assert trainer.actor.rollout.after[:, 0].tolist() == (steps_before + 1).tolist()
    assert loop.update(trainer, loop.collect(trainer), 1e-3)["first_kl"] < 1e-9


@pytest.mark.parametrize(
    "change, said",
    [
        ({"minibatches": 32, "num_steps": 32}, "16 of 1 processes are not divided by 32"),
        ({"network": "mlp+rnn"}, r"unknown network 'mlp\+rnn'; there are: .*each with \+gru or"),
        ({"network": "mlp+"}, "unknown network"),
        ({"teacher": "solver"}, "a student must have no memory"),
    ],
)
def test_what_memory_cannot_be_is_refused(change, said):
    with pytest.raises(ValueError, match=said):
        Trainer(replace(CONFIG, **change))


def test_a_checkpoint_names_its_cell(tmp_path):
    loop.train(replace(CONFIG, steps=256, network="mlp+lstm"), tmp_path, progress=False)
    agent = astray.load_agent(tmp_path)
    assert agent.architecture.name == "mlp+lstm" and agent.network.memory == 2 * CONFIG.width
    assert checkpoint.read_config(tmp_path).network == "mlp+lstm"
