"""Networks with memory: what they remember, and that PPO learns from whole sequences of them."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import nn

import astray
from astray.acting import steps
from astray.agents.drc import DRC
from astray.agents.mlp import MLP
from astray.agents.policy import Architecture
from astray.agents.recurrent import Recurrent
from astray.analysis.adapters import from_trainer
from astray.analysis.evaluate import evaluate
from astray.mitigation.uncertainty import OfLogits
from astray.training import checkpoint, loop, ppo
from astray.training.checks import UNROLLED
from astray.training.trainer import Trainer
from helpers.thorough import thorough
from helpers.trainings import TINY, digest, train_to_first_checkpoint

NETWORKS = ("mlp+gru", "mlp+lstm", "drc-2-2")
TRAINED = ("mlp+gru", "mlp+lstm", "drc-1-1")
CONFIG = replace(TINY, network="mlp+gru", num_steps=8, steps=512, validation=None)
SHAPE, LARGEST = (3, 5, 5), (1, 1, 3)
PLAYED = CONFIG.variant_for("anywhere-small")


def network(name):
    torch.manual_seed(0)
    return Architecture(name, SHAPE, LARGEST, 9, width=8).build()


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


def convolved(conv, x):
    """A 3 x 3 convolution of [C, H, W], place by place."""
    padded = nn.functional.pad(x, (1, 1, 1, 1))
    rows = [
        torch.stack([
            (conv.weight * padded[:, i : i + 3, j : j + 3]).sum((1, 2, 3)) + conv.bias
            for j in range(x.shape[2])
        ])
        for i in range(x.shape[1])
    ]  # fmt: skip
    return torch.stack(rows).permute(2, 0, 1)


def ticked(net, seen, state):
    """The next state of one episode of a DRC, by the formulas of Guez et al. 2019."""
    depth = len(net.layers)
    hidden, inner = state.view(2, depth, *seen.shape).clone()
    edge = torch.tensor(
        [[[1.0 * (0 in (i, j) or 4 in (i, j)) for j in range(5)] for i in range(5)]]
    )
    for _ in range(net.repeats):
        for d, layer in enumerate(net.layers):
            flat = hidden[d].flatten(1)
            pooled = layer.pooled.weight @ torch.cat([flat.max(1)[0], flat.mean(1)])
            injected = (pooled + layer.pooled.bias)[:, None, None].expand_as(seen)
            sees = torch.cat([seen, hidden[d - 1], hidden[d], injected, edge])
            into, forget, new, out = convolved(layer.gates, sees).split(len(seen))
            cell = sigmoid(forget) * inner[d] + sigmoid(into) * torch.tanh(new)
            inner = torch.cat([inner[:d], cell[None], inner[d + 1 :]])
            top = sigmoid(out) * torch.tanh(cell)
            hidden = torch.cat([hidden[:d], top[None], hidden[d + 1 :]])
    return torch.cat([hidden, inner]).flatten()


def slow(net, observation, state, begins):
    """What `net` says of [T, N], an episode and a step at a time."""
    logits, values = [], []
    for t in range(len(observation)):
        rows, said = [], []
        for i in range(len(state)):
            before = torch.zeros_like(state[i]) if begins[t, i] else state[i]
            if isinstance(net, DRC):
                seen = net.encode(observation[t, i : i + 1])[0]
                rows.append(ticked(net, seen, before))
                top = rows[-1][: seen.numel() * len(net.layers)].view(-1, *seen.shape)[-1]
                features = net.features(torch.cat([top, seen])[None])[0]
                said.append((net.policy(features), net.value(features)[0]))
            else:
                features = net.body.hidden(observation[t, i : i + 1])[0]
                rows.append(remembered(net.cell, features, before))
                said.append(net.body.heads(rows[-1][: net.width]))
        state = torch.stack(rows)
        logits.append(torch.stack([one for one, _ in said]))
        values.append(torch.stack([one for _, one in said]))
    return torch.stack(logits), torch.stack(values), state


@pytest.mark.parametrize("name", NETWORKS)
def test_a_network_remembers_as_its_formulas_say_and_forgets_where_an_episode_begins(name):
    net, observation = network(name), shown(3, 2)
    state, begins = torch.randn(2, net.memory), torch.tensor([[0, 1], [1, 0], [0, 0]]).bool()
    ours, theirs = net.unroll(observation, state, begins), slow(net, observation, state, begins)
    by_step = Recurrent.unroll(net, observation, state, begins)
    for one, two, three in zip(ours, theirs, by_step, strict=True):
        assert torch.allclose(one, two, atol=1e-5) and torch.allclose(one, three, atol=1e-5)


@pytest.mark.parametrize("name", NETWORKS)
def test_the_gradient_of_a_minibatch_is_that_of_its_sequences_unrolled(name):
    net, (t, n) = network(name), (3, 3)
    observation, begins = shown(t, n), torch.rand(t, n) < 0.3
    action, noise = torch.randint(0, 9, (t, n)), torch.randn(4, t, n)
    state = torch.randn(n, net.memory)
    whole = ppo.Sequences(observation, action, -2 + 0.1 * noise[0], *noise[1:], begins, state)
    some = torch.tensor([2, 0])
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


@pytest.mark.parametrize("name", TRAINED)
def test_acting_and_learning_agree_in_every_rollout(name):
    """Also in the second, which begins amid episodes."""
    trainer = Trainer(replace(CONFIG, network=name))
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


@pytest.mark.parametrize(
    "name",
    ["mlp+lstm", *thorough("mlp+gru", "drc-1-1")],  # whose states are tensors alike
)
def test_a_stopped_training_with_memory_goes_on_to_the_bit(name, tmp_path, monkeypatch):
    config = replace(CONFIG, network=name, validation="anywhere-small")
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


def test_an_agent_asked_along_an_episode_remembers_and_in_a_single_state_does_not(tmp_path):
    loop.train(replace(CONFIG, steps=256), tmp_path, progress=False)
    agent = astray.load_agent(tmp_path)
    agent.mode = "greedy"
    played = list(steps(agent, "maze", PLAYED, [3], batch=1))
    seen = np.concatenate([step.observations for step in played])
    along, alone = agent.outputs(seen, episode=True)[0], agent.outputs(seen)[0]
    assert along.argmax(1).tolist() == [int(step.actions[0]) for step in played]
    assert torch.allclose(along[0], alone[0], atol=1e-6) and not torch.allclose(along, alone)
    assert torch.allclose(alone[-1:], agent.outputs(seen[-1:])[0], atol=1e-6)
    with pytest.raises(ValueError, match="needs an agent without memory"):
        OfLogits(agent, "entropy")


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
    trainer = Trainer(loop.checked(CONFIG, network=Own))
    loop.collect(trainer)
    steps_before = np.concatenate([env.states["time"] for env in trainer.player.envs])
    assert trainer.actor.rollout.after[:, 0].tolist() == (steps_before + 1).tolist()
    assert loop.update(trainer, loop.collect(trainer), 1e-3)["first_kl"] < 1e-9


class Writes(Own):
    """Counts in the state that it is given."""

    def recall(self, observation, state, begins):
        logits, value, _ = super().recall(observation, state, begins)
        return logits, value, state.mul_(~begins[:, None]).add_(1)


def test_a_network_that_writes_to_its_state_learns_as_one_that_does_not():
    """It was said to remember otherwise in learning, since its state changed between steps."""
    plain, writes = (loop.iterate(CONFIG, network=network) for network in (Own, Writes))
    for _ in range(3):
        assert next(writes).metrics == next(plain).metrics


class Wide(Own):
    """Returns its state in another precision."""

    def recall(self, observation, state, begins):
        *said, state = super().recall(observation, state, begins)
        return *said, state.double()


def test_a_network_whose_state_is_float64_is_refused():
    with pytest.raises(ValueError, match="state must be of float32, as it is given; got float64"):
        next(loop.iterate(CONFIG, network=Wide))


class Onward(Own):
    """Does not notice in learning that an episode begins."""

    def unroll(self, observation, state, begins):
        return super().unroll(observation, state, begins & False)


class Keeps(Own):
    """Keeps more of its memory itself."""

    kept = 0.0

    def recall(self, observation, state, begins):
        logits, value, state = super().recall(observation, state, begins)
        self.kept += 1
        return logits * self.kept, value, state


class Drags(Own):
    """Does not notice that an episode begins."""

    def recall(self, observation, state, begins):
        return super().recall(observation, state, begins & False)


class Late(Own):
    """Forgets a step too late."""

    def recall(self, observation, state, begins):
        logits, value, state = super().recall(observation, state, begins & False)
        return logits, value, state * ~begins[:, None]


class Averages(Own):
    """Says how it differs from the others of its batch."""

    def recall(self, observation, state, begins):
        logits, value, state = super().recall(observation, state, begins)
        return logits - logits.mean(0), value, state


class Infects(Own):
    """Forgets all episodes of a batch where one begins."""

    def recall(self, observation, state, begins):
        return super().recall(observation, state, begins | begins.any())


@pytest.mark.parametrize("network", [Onward, Keeps, Drags, Late, Averages, Infects])
def test_a_network_that_learns_from_other_memories_than_it_acts_by_is_refused(network):
    with pytest.raises(ValueError, match="must say the same step by step, in recall, and of"):
        next(loop.iterate(CONFIG, network=network))


@pytest.mark.parametrize("envs", [1, 2])
def test_a_network_that_forgets_nothing_is_noticed_in_few_environments(envs):
    few = replace(CONFIG, num_envs=envs, minibatches=1)
    with pytest.raises(ValueError, match="forget where `begins`"):
        next(loop.iterate(few, network=Drags))


class Flattens(Own):
    """Gives a sequence as one row of steps."""

    def unroll(self, observation, state, begins):
        logits, values, state = super().unroll(observation, state, begins)
        return logits.flatten(0, 1), values.flatten(), state


class Doubles(Own):
    """Gives the logits of long sequences twice."""

    def unroll(self, observation, state, begins):
        logits, values, state = super().unroll(observation, state, begins)
        return logits.repeat(1, 1 + (len(observation) > UNROLLED), 1), values, state


@pytest.mark.parametrize(
    "network, said",
    [(Flattens, "what Flattens says differs by inf"), (Doubles, "also in learning")],
)
def test_a_sequence_of_another_shape_is_refused(network, said):
    with pytest.raises(ValueError, match=said):
        next(loop.iterate(replace(CONFIG, num_steps=2 * UNROLLED), network=network))


class Shares(Own):
    """Gives all episodes one memory."""

    def recall(self, observation, state, begins):
        logits, value, state = super().recall(observation, state, begins)
        return logits, value, state[:1]


class Widens(Own):
    """Returns a memory of another size."""

    def recall(self, observation, state, begins):
        logits, value, state = super().recall(observation, state, begins)
        return logits, value, torch.cat([state, state], 1)


class Forgets(Own):
    """Returns no memory."""

    def recall(self, observation, state, begins):
        return super().recall(observation, state, begins)[:2]


class Empty(Own):
    memory = 0


class Negative(Own):
    memory = -1


@pytest.mark.parametrize("network", [Shares, Widens, Forgets])
def test_a_memory_of_another_shape_is_refused(network):
    with pytest.raises(ValueError, match=r"with memory, its state, \[.*, \(16, 1\)\]; got \["):
        next(loop.iterate(CONFIG, network=network))


@pytest.mark.parametrize("network", [Empty, Negative])
def test_a_memory_without_size_is_refused(network):
    with pytest.raises(
        ValueError, match=r"memory of .* must be an integer from 1 to .*; got (0|-1)"
    ):
        next(loop.iterate(CONFIG, network=network))


@pytest.mark.parametrize(
    "change, said",
    [
        (
            {"minibatches": 32, "num_steps": 32},
            r"16 environments \(whole ones .*\) of 1 processes are not divided by 32",
        ),
        (
            {"network": "mlp+rnn"},
            r"unknown network 'mlp\+rnn'; there are: .*each but drc with \+gru or",
        ),
        ({"network": "mlp+"}, "unknown network"),
        ({"network": "drc+gru"}, "each but drc"),
        ({"network": "drc-3"}, "drc-D-N with its depth and ticks"),
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
