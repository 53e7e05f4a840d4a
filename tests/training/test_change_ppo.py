"""A network or a loss of one's own trains as it is written, and so does an edit of ours."""

import importlib.util
import inspect
import sys
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from torch import nn

from astray import load_agent
from astray.agents import mlp
from astray.agents.actor_critic import ActorCritic
from astray.agents.mlp import MLP
from astray.training import loop, ppo, rollout
from astray.training.config import PRESETS
from astray.training.fast import unedited
from astray.training.trainer import Trainer
from helpers.trainings import PICTURES

CONFIG = replace(
    PRESETS["small"], variant="corner-small", num_envs=16, num_steps=8, minibatches=2, width=16
)
OFF = {"fused_cpu": False, "bfloat16": False}


class Given(MLP):
    """A perceptron that is made of an architecture, as networks of one's own are."""

    def __init__(self, a):
        super().__init__(a.shape, list(a.largest), a.actions, a.width)


class Tanh(Given):
    def __init__(self, a):
        super().__init__(a)
        self.features.relu1 = nn.Tanh()


class TwoHeads(Given):
    """Also says which action was taken, from what both heads see."""

    def __init__(self, a):
        super().__init__(a)
        self.taken = nn.Linear(a.width, a.actions)


def sure(network, batch, config):
    losses = ppo.loss(network, batch, config)
    logits, _ = network(batch.observation)
    return losses | {"loss": losses["loss"] + 0.1 * (logits**2).mean()}


def with_auxiliary(network, batch, config):
    losses = ppo.loss(network, batch, config)
    says = network.taken(network.hidden(batch.observation))
    auxiliary = nn.functional.cross_entropy(says, batch.action)
    return losses | {"loss": losses["loss"] + auxiliary, "auxiliary": auxiliary}


def learned(config, network=None, loss=None):
    """All weights after an iteration, and what was measured."""
    trainer = Trainer(loop.checked(config, network=network, loss=loss))
    metrics = loop.update(trainer, loop.collect(trainer), 1e-2)
    return torch.cat([p.detach().flatten() for p in trainer.network.parameters()]), metrics


@pytest.mark.parametrize(
    "own, names",
    [((Tanh,), "network Tanh"), ((None, sure), "loss .*sure"),
     ((TwoHeads, with_auxiliary), "network TwoHeads")],
    ids=["activation", "term", "head"],
)  # fmt: skip
def test_what_is_given_trains_as_it_is_written(own, names):
    with pytest.warns(UserWarning, match=f"the {names}.* as it is written"):
        given, metrics = learned(CONFIG, *own)
    with pytest.warns(UserWarning, match="as it is written"):
        plain, _ = learned(CONFIG.changed(**OFF), *own)
    assert torch.equal(given, plain)
    ours, usual = learned(CONFIG)
    assert given.shape != ours.shape or (given - ours).abs().max() > 1e-3
    assert metrics.keys() - usual.keys() == ({"auxiliary"} if own[-1] is with_auxiliary else set())


class Remembers(Given):
    """Keeps its memory itself, as long as it is shown as many observations."""

    def __init__(self, a):
        super().__init__(a)
        self.cell, self.state = nn.GRUCell(a.width, a.width), None

    def hidden(self, observation):
        seen = super().hidden(observation)
        if self.state is None or len(self.state) != len(seen):
            self.state = torch.zeros_like(seen)
        self.state = self.cell(seen, self.state.detach())
        return self.state


class Drifts(Given):
    """Says something else with every call, by less than a rollout shows."""

    def __init__(self, a):
        super().__init__(a)
        self.calls = 0

    def hidden(self, observation):
        self.calls += 1
        return super().hidden(observation) * (1 + 1e-5 * self.calls)


class Centres(Given):
    """Says how it differs from the others of its batch: little at first, in a large one."""

    def forward(self, observation):
        logits, value = super().forward(observation)
        return logits - logits.mean(0), value


class Drops(Given):
    """Is another network in learning than in acting, by as much as is usual."""

    def __init__(self, a):
        super().__init__(a)
        self.dropout = nn.Dropout(0.5)

    def hidden(self, observation):
        return self.dropout(super().hidden(observation))


@pytest.mark.parametrize("network", [Remembers, Drifts, Centres])
def test_a_network_that_keeps_its_memory_itself_is_refused(network):
    with (
        pytest.warns(UserWarning, match="as it is written"),
        pytest.raises(ValueError, match="must say the same of an observation whenever"),
    ):
        next(loop.iterate(CONFIG, network=network))


class Masks(Given):
    """Forbids an action by a logit that is no number."""

    def forward(self, observation):
        logits, value = super().forward(observation)
        return logits.index_fill(1, torch.tensor([0]), -torch.inf), value


def test_a_network_whose_logits_are_not_finite_is_refused():
    with pytest.raises(ValueError, match="finite logits: -1e9 for a masked action"):
        next(loop.iterate(CONFIG, network=Masks))


class Normalises(Given):
    """Acts by the means of all minibatches, and learns by those of one."""

    def __init__(self, a):
        super().__init__(a)
        self.norm = nn.BatchNorm1d(a.width)

    def hidden(self, observation):
        return self.norm(super().hidden(observation))


class OfInstances(Given):
    """Acts by running means, and learns by those of an observation; drops half of it."""

    def __init__(self, a):
        super().__init__(a)
        self.norm, self.dropout = nn.InstanceNorm1d(1, track_running_stats=True), nn.Dropout(0.5)

    def hidden(self, observation):
        return self.dropout(self.norm(super().hidden(observation)[:, None])[:, 0])


class Doubles(Given):
    """Says twice as much in learning."""

    def hidden(self, observation):
        return super().hidden(observation) * (1 + self.training)


class DropsAndNormalises(Normalises):
    """Does so under dropout that is no module, which hides it."""

    def hidden(self, observation):
        return nn.functional.dropout(super().hidden(observation), 0.5, self.training)


class NormalisesLater(Normalises):
    """Begins with a factor of 0, as branches of residual networks do."""

    def __init__(self, a):
        super().__init__(a)
        nn.init.zeros_(self.norm.weight)

    def hidden(self, observation):
        return Given.hidden(self, observation) + super().hidden(observation)


class DoublesAndDrops(Doubles):
    """Does so under dropout of pairs, which hides it."""

    def __init__(self, a):
        super().__init__(a)
        self.dropout = nn.Dropout1d(0.5)

    def hidden(self, observation):
        return self.dropout(super().hidden(observation)[:, :, None])[:, :, 0]


class Sharpens(Given):
    """Is surer in acting, beside a little dropout of no module."""

    def hidden(self, observation):
        seen = super().hidden(observation)
        return nn.functional.dropout(seen, 0.01) if self.training else 3 * seen


@pytest.mark.parametrize(
    "network",
    [
        Normalises, OfInstances, Doubles, DropsAndNormalises, NormalisesLater, DoublesAndDrops,
        Sharpens,
    ],
)  # fmt: skip
def test_a_network_that_is_another_in_learning_is_refused(network):
    """In the first minibatch the first one's policy was 1.5 nats from the one that had acted."""
    with (
        pytest.warns(UserWarning, match="as it is written"),
        pytest.raises(ValueError, match="the same in acting and in learning, but for dropout"),
    ):
        next(loop.iterate(CONFIG, network=network))


class Listed(Given):
    """Has a layer in a list, whose weights are in no file, nor does the optimizer know them."""

    def __init__(self, a):
        super().__init__(a)
        self.more = [nn.Linear(a.width, a.width)]

    def hidden(self, observation):
        return self.more[0](super().hidden(observation))


class Unsaved(Given):
    """Multiplies by numbers that no file keeps."""

    def __init__(self, a):
        super().__init__(a)
        self.factors = torch.randn(a.width)

    def hidden(self, observation):
        return super().hidden(observation) * self.factors


class Centred(Given):
    """Learns a mean that no file keeps."""

    def __init__(self, a):
        super().__init__(a)
        self.mean = 0.0

    def hidden(self, observation):
        seen = super().hidden(observation) - self.mean
        if self.training:
            self.mean += 0.01 * float(seen.detach().mean())
        return seen


@pytest.mark.parametrize("network", [Listed, Unsaved, Centred])
def test_a_network_that_its_file_does_not_hold_is_refused(network):
    """It was another one whenever its agent was loaded."""
    with (
        pytest.warns(UserWarning, match="as it is written"),
        pytest.raises(ValueError, match="its agent would be another one once it is loaded"),
    ):
        next(loop.iterate(CONFIG, network=network))


class Reads(Given):
    """Reads numbers of tensors as it is made, as networks with stochastic depth do."""

    def __init__(self, a):
        super().__init__(a)
        self.factor = [x.item() for x in torch.linspace(1, 2, 3)][1]


class Orthogonal(Given):
    """Has weights that are lacking where it is made without memory."""

    def __init__(self, a):
        super().__init__(a)
        nn.utils.parametrizations.orthogonal(self.policy)


@pytest.mark.filterwarnings("ignore:training runs")
@pytest.mark.parametrize("network", [Reads, Orthogonal])
def test_a_network_that_reads_what_it_is_made_of_is_trained_and_loaded(tmp_path, network):
    """The first was said to have too many weights for any memory; the second was not loaded."""
    loop.train(replace(CONFIG, steps=128), tmp_path, network=network, progress=False)
    assert isinstance(load_agent(tmp_path).network, network)


class Large(Given):
    """Tries a filter on an image that is smaller."""

    def __init__(self, a):
        super().__init__(a)
        nn.Conv2d(3, 1, 8)(torch.zeros(1, 3, 4, 4))


def test_a_network_that_cannot_be_made_is_told_with_the_reason():
    """It was said to have too many weights for any memory."""
    with pytest.raises(ValueError, match=r"Large cannot be made for observations of .* 8\)"):
        next(loop.iterate(CONFIG, network=Large))


class Lazy(Given):
    """Has a layer whose size depends on what it sees first."""

    def __init__(self, a):
        super().__init__(a)
        self.policy = nn.LazyLinear(a.actions)


def test_a_network_with_lazy_layers_is_refused_in_words_of_its_own():
    with pytest.raises(ValueError, match=r"Lazy must be made of layers of known sizes, .* lazy"):
        next(loop.iterate(CONFIG, network=Lazy))


class DropsAnyway(Tanh):
    """Has dropout that is no module."""

    def hidden(self, observation):
        return nn.functional.dropout(super().hidden(observation), 0.5, self.training)


class Frozen(Normalises):
    """Keeps the means that it has, in learning, too."""

    def __init__(self, a):
        super().__init__(a)
        self.norm = nn.Sequential(self.norm)

    def train(self, mode=True):
        super().train(mode)
        self.norm[0].eval()
        return self


@pytest.mark.parametrize("network", [Tanh, Drops, DropsAnyway, Frozen])
def test_a_network_without_memory_is_not_refused(network):
    with pytest.warns(UserWarning, match="as it is written"):
        assert next(loop.iterate(CONFIG, network=network)).metrics["update/first_kl"] >= 0


def double_entropy(monkeypatch):
    entropy = ppo.entropy
    monkeypatch.setattr(ppo, "entropy", lambda of_all: 2 * entropy(of_all))


def other_clip(monkeypatch):
    loss = ppo.policy_loss
    monkeypatch.setattr(ppo, "policy_loss", lambda r, a, clip: loss(r, a, clip / 2))


def other_activation(monkeypatch):
    monkeypatch.setattr(nn, "ReLU", nn.Tanh)


def one_head_more(monkeypatch):
    begin = MLP.__init__

    def begin_with_head(self, *arguments, **named):
        begin(self, *arguments, **named)
        self.extra = nn.Linear(1, 1)

    monkeypatch.setattr(MLP, "__init__", begin_with_head)


def dual_clip(monkeypatch):
    """As Ye et al. (2020): only where a probability rose to three times as much, as never yet."""
    loss = ppo.policy_loss

    def bounded(log_ratio, advantage, clip):
        usual = torch.stack([loss(*pair, clip) for pair in zip(log_ratio, advantage, strict=True)])
        return torch.where(advantage < 0, usual.minimum(-3 * advantage), usual).mean()

    monkeypatch.setattr(ppo, "policy_loss", bounded)


def huber(monkeypatch):
    def loss(value, old, target, clip):
        near = old + (value - old).clamp(-clip, clip)
        both = [
            nn.functional.huber_loss(x, target, reduction="none", delta=10) for x in (value, near)
        ]
        return torch.max(*both).mean()

    monkeypatch.setattr(ppo, "value_loss", loss)


def bounded_logits(monkeypatch):
    outputs = ppo.outputs

    def within(network, minibatch):
        logits, value = outputs(network, minibatch)
        return 5 * torch.tanh(logits / 5), value

    monkeypatch.setattr(ppo, "outputs", within)


def bounded_activation(monkeypatch):
    dense = mlp.dense
    bounded = lambda layer: nn.ReLU6() if isinstance(layer, nn.ReLU) else layer  # noqa: E731
    monkeypatch.setattr(mlp, "dense", lambda *sizes: nn.Sequential(*map(bounded, dense(*sizes))))


def faint_penalty(monkeypatch):
    """A thousandth of the loss, which rounding would hide where numbers are large."""
    loss = ppo.value_loss
    monkeypatch.setattr(ppo, "value_loss", lambda v, *its: loss(v, *its) + 1e-6 * (v**2).mean())


@pytest.mark.parametrize(
    "edit",
    [
        double_entropy, other_clip, other_activation, one_head_more, dual_clip, huber,
        bounded_logits, bounded_activation, faint_penalty,
    ],
)  # fmt: skip
def test_an_edit_of_ours_is_seen(edit, monkeypatch):
    edit(monkeypatch)
    with pytest.warns(UserWarning, match="as it is written"):
        edited, _ = learned(CONFIG)
    plain, _ = learned(CONFIG.changed(**OFF))
    assert torch.equal(edited, plain)


def test_an_edit_of_what_follows_the_heads_is_what_trains_also_in_parts(monkeypatch):
    """Parts asked the hidden layer and the heads: agents acted otherwise than they had learned."""
    forward, config = ActorCritic.forward, PICTURES.changed(network="patch", microbatch=8)

    def bounded(network, seen):
        logits, value = forward(network, seen)
        return 5 * torch.tanh(logits / 5), value

    monkeypatch.setattr(ActorCritic, "forward", bounded)
    with pytest.warns(UserWarning, match="the network Convolutions as it is written"):
        found, _ = learned(config)
    with pytest.warns(UserWarning, match="as it is written"):
        plain, _ = learned(config.changed(microbatch=32))
    assert torch.equal(found, plain)


def test_an_edit_that_compares_a_minibatch_is_not_learned_in_parts(monkeypatch):
    """Advantages of each minibatch were normalised in each of its parts."""
    loss, config = ppo.policy_loss, PICTURES.changed(network="patch", microbatch=8)
    edited = lambda ratio, x, clip: loss(ratio, ppo.normalised(x), clip)  # noqa: E731
    monkeypatch.setattr(ppo, "policy_loss", edited)
    with pytest.warns(UserWarning, match="as it is written"):
        found, _ = learned(config)
    with pytest.warns(UserWarning, match="the loss .* as it is written"):
        plain, _ = learned(config.changed(microbatch=32))
    assert torch.equal(found, plain)


def test_an_edit_that_shows_in_learning_alone_is_seen(monkeypatch):
    dense = mlp.dense
    monkeypatch.setattr(mlp, "dense", lambda *sizes: nn.Sequential(dense(*sizes), nn.Dropout(0.5)))
    with pytest.warns(UserWarning, match="the network MLP as it is written"):
        learned(CONFIG)


@pytest.mark.parametrize("name", unedited.WRITTEN)
def test_what_accelerations_stand_for_is_what_is_written(name):
    """It fails at an edit: see that `training.fast` computes the same, and note the digest."""
    module, _, its = name.rpartition(".")
    assert unedited.digest(getattr(importlib.import_module(module), its)) == unedited.WRITTEN[name]


def test_comments_make_no_difference_and_a_constant_does(tmp_path, monkeypatch):
    source, before = Path(ppo.__file__).read_text("utf-8"), "    mean_entropy = entropy(of_all)\n"
    assert source.count(before) == 1
    found = []
    for after in (f"    # Why not?\n{before}", before.replace("= ", "= 2 * ")):
        path = tmp_path / f"edited_{len(found)}.py"
        path.write_text(source.replace(before, after), "utf-8")
        spec = importlib.util.spec_from_file_location(ppo.__name__, path)
        edited = importlib.util.module_from_spec(spec)
        monkeypatch.setitem(sys.modules, ppo.__name__, edited)
        spec.loader.exec_module(edited)
        found.append(unedited.is_unedited(edited.loss))
    assert found == [True, False]


EDITS = {  # of `loop.collect`
    "intrinsic reward": ("player.settle()", "player.settle(); rollout.reward[::2] += 1"),
    "other noise": ("begin(config.num_steps)", "begin(config.num_steps); rollout.noise.mul_(0.5)"),
}


@pytest.mark.parametrize("edit", EDITS)
def test_an_edit_of_the_loop_is_what_trains_by_default(edit, monkeypatch):
    usual, _ = learned(CONFIG)
    before, after = EDITS[edit]
    source = inspect.getsource(loop.collect)
    assert before in source
    names = dict(vars(loop))
    exec(source.replace(before, after, 1), names)
    monkeypatch.setattr(loop, "collect", names["collect"])
    edited, _ = learned(CONFIG)
    assert (edited - usual).abs().max() > 1e-3


def test_another_exploration_is_what_acts_by_default(monkeypatch):
    act = rollout.act

    def always_the_third(*given):
        action, *rest = act(*given)
        return torch.full_like(action, 3), *rest

    monkeypatch.setattr(rollout, "act", always_the_third)
    assert (loop.collect(Trainer(CONFIG)).action == 3).all()


def test_ours_is_computed_by_the_kernels():
    assert Trainer(CONFIG).fast.using.fused_cpu


def test_kernels_that_are_asked_for_are_refused_to_others():
    with pytest.raises(ValueError, match=r"fused_cpu must be off with .* this network and"):
        next(loop.iterate(CONFIG.changed(fused_cpu=True), network=Tanh))


def test_explained_variance_is_a_fraction_of_the_targets():
    target = torch.tensor([0.0, 1.0, 2.0, 3.0])
    assert ppo.explained_variance(target, target) == 1
    assert ppo.explained_variance(torch.zeros(4), target) == pytest.approx(0)
    assert ppo.explained_variance(target, torch.ones(4)) == 0
    assert ppo.explained_variance(torch.randn(777), torch.full((777,), 0.37)) == 0  # but rounding


@pytest.mark.parametrize("what", ["network", "loss", "sampler", "reward"])
def test_what_cannot_be_called_is_refused_before_a_training(what):
    with pytest.raises(ValueError, match="'os:sep' must be a function or a class, not a str"):
        loop.checked(CONFIG.changed(**{what: "os:sep"}))


def test_settings_name_the_loss_that_is_learned_by():
    """They named another one, or the one of lessons, where the usual one was given."""
    assert loop.checked(CONFIG.changed(loss="os:getcwd"), loss=ppo.loss).loss is None
    student = loop.checked(CONFIG.changed(teacher="solver"), loss=ppo.loss)
    assert student.loss == "astray.training.ppo:loss"
