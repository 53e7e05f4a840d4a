"""Trainings whose numbers, networks, losses, environment or folders are not as they must be."""

import contextlib
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from astray.agents.mlp import MLP
from astray.analysis.runs import load_agent
from astray.training import checkpoint, ppo
from astray.training.checks import Diverged
from astray.training.config import PRESETS
from astray.training.loop import improve, train
from astray.training.trainer import Trainer

TINY = replace(
    PRESETS["small"],
    variant="corner-small",
    num_envs=4,
    num_steps=8,
    minibatches=2,
    epochs=1,
    width=8,
    steps=192,
    levels=50,
    checkpoint_every=2,
)


def nan(network, batch, config):
    losses = ppo.loss(network, batch, config)
    grown = losses["entropy"].detach().isnan() | (batch.observation.sum() >= 0)
    return losses | {"loss": torch.where(grown, torch.nan, 1.0) * losses["loss"]}


def test_a_training_that_diverges_stops_and_keeps_its_checkpoints(tmp_path):
    config = replace(TINY, steps=32 * 100, learning_rate=1e37, checkpoint_every=1)
    with pytest.raises(Diverged, match=r"update [0-9]+ of 100.*lower learning_rate .1e\+37"):
        train(config, tmp_path, progress=False)
    for steps in checkpoint.steps_saved(tmp_path):
        load_agent(tmp_path / "checkpoints" / str(steps))
    assert all(np.isfinite(list(row.values())).all() for row in checkpoint.metrics(tmp_path))


@pytest.mark.filterwarnings("ignore:training runs")
def test_a_loss_that_is_no_number_stops_a_training(tmp_path):
    with pytest.raises(Diverged, match="in update 1 of 6, at 32 steps"):
        train(TINY, tmp_path, loss=nan, progress=False)
    assert not checkpoint.steps_saved(tmp_path)


class OneColumn(MLP):
    def __init__(self, a):
        super().__init__(a.shape, list(a.largest), a.actions, a.width)

    def forward(self, x):
        logits, values = super().forward(x)
        return logits, values[:, None]


class Alone(OneColumn):
    def forward(self, x):
        return super().forward(x)[0]


@pytest.mark.filterwarnings("ignore:training runs")
@pytest.mark.parametrize("network", [OneColumn, Alone])
def test_a_network_that_returns_something_else_is_refused(tmp_path, network):
    with pytest.raises(ValueError, match=r"must return logits, .*\[\(4, 15\), \(4,\)\]; got"):
        train(TINY, tmp_path, network=network, progress=False)


class Bare(MLP):
    def __init__(self):
        pass


def chosen_from():
    pass


@pytest.mark.filterwarnings("ignore:training runs")
@pytest.mark.parametrize("own", [{"network": Bare}, {"sampler": chosen_from}])
def test_a_network_or_sampler_that_cannot_be_made_is_told_in_a_sentence(tmp_path, own):
    ((what, _),) = own.items()
    with pytest.raises(ValueError, match=rf"the {what} .* fails: TypeError\("):
        train(TINY, tmp_path / "run", **own, progress=False)
    assert not (tmp_path / "run").exists()


def made_by(architecture):
    return OneColumn(architecture)


def test_a_function_that_no_file_can_name_is_refused_before_the_training(tmp_path):
    """Its agents were refused, after the training."""
    with pytest.raises(ValueError, match="made_by must be a class derived from Module, or one of"):
        train(TINY, tmp_path / "run", network=made_by, progress=False)
    assert not (tmp_path / "run").exists()


class Pools(OneColumn):
    """Returns one value for all observations in acting, some time later."""

    calls, most, acts = 0, 15, True

    def forward(self, x):
        logits, values = super().forward(x)
        self.calls += torch.is_grad_enabled() != self.acts
        return logits, values[:, 0].mean() if self.calls > self.most else values[:, 0]


class PoolsInLearning(Pools):
    most, acts = 3, False  # two are asked before it learns


@pytest.mark.filterwarnings("ignore:training runs")
@pytest.mark.parametrize(
    "network, said",
    [(Pools, r"must return .*; got \[\(4, 15\), \(\)\]"), (PoolsInLearning, "also in learning")],
)
@pytest.mark.parametrize("teacher", [None, "solver"])
def test_a_network_that_returns_something_else_later_is_refused(tmp_path, network, said, teacher):
    """A student learned by values that were broadcast."""
    with pytest.raises(ValueError, match=said):
        train(TINY.changed(teacher=teacher), tmp_path, network=network, progress=False)


def nothing(network, batch, config):
    return None


def constant(network, batch, config):
    return {"loss": torch.zeros(())}


def without_weights(network, batch, config):
    return {"loss": torch.zeros((), requires_grad=True)}


def unnamed(network, batch, config):
    return {"policy": ppo.loss(network, batch, config)["loss"]}


@pytest.mark.filterwarnings("ignore:training runs")
@pytest.mark.parametrize("loss", [nothing, constant, without_weights, unnamed])
def test_a_loss_that_returns_something_else_is_refused(tmp_path, loss):
    with pytest.raises(ValueError, match="a loss must return tensors of one number by name"):
        train(TINY, tmp_path, loss=loss, progress=False)


CALLS = []


def late(network, batch, config):
    CALLS.append(1)
    is_late = len(CALLS) > TINY.epochs * TINY.minibatches
    return None if is_late else ppo.loss(network, batch, config)


def failing(network, batch, config):
    raise KeyError("mine")


@pytest.mark.filterwarnings("ignore:training runs")
@pytest.mark.parametrize(
    "loss, said",
    [(late, "must return tensors .*; got None"), (failing, r"failing fails: KeyError\('mine'\)")],
)
def test_a_loss_that_fails_or_returns_nothing_at_any_time_is_told(tmp_path, loss, said):
    CALLS.clear()
    with pytest.raises(ValueError, match=said):
        train(TINY, tmp_path, loss=loss, progress=False)


@pytest.mark.parametrize("wrong", [{"RANK": "x"}, {"WORLD_SIZE": "many"}, {"MASTER_PORT": "y"}])
def test_what_torchrun_did_not_set_is_told(tmp_path, monkeypatch, wrong):
    good = {
        "TORCHELASTIC_RUN_ID": "1",
        "RANK": "0",
        "WORLD_SIZE": "1",
        "MASTER_ADDR": "127.0.0.1",
        "MASTER_PORT": "1",
    }
    for name, value in (good | wrong).items():
        monkeypatch.setenv(name, value)
    with pytest.raises(ValueError, match="must be as torchrun sets them in the environment"):
        train(TINY, tmp_path, progress=False)


@pytest.fixture
def begun(tmp_path):
    """A run that is to go on from its first checkpoint."""
    folder = tmp_path / "begun"
    with checkpoint.claim(folder, TINY), contextlib.closing(Trainer(TINY)) as trainer:
        for _ in range(TINY.checkpoint_every):
            improve(trainer)
        checkpoint.save(folder, trainer)
    return folder


def test_what_the_user_keeps_in_a_checkpoint_stays(begun):
    notes = begun / "checkpoints" / "64" / "notes.txt"
    notes.write_text("mine")
    train(TINY, begun, progress=False)
    assert notes.read_text() == "mine"


def test_nothing_is_removed_through_a_link(begun, tmp_path):
    elsewhere = tmp_path / "elsewhere"
    shutil.move(begun / "checkpoints" / "64", elsewhere)
    (begun / "checkpoints" / "64").symlink_to(elsewhere)
    train(TINY, begun, progress=False)
    assert sorted(path.name for path in elsewhere.iterdir()) == [
        checkpoint.AGENT,
        checkpoint.TRAINER,
    ]


@pytest.mark.parametrize("name", ["007", "99999999999999999999", "7"])
def test_what_only_looks_like_a_checkpoint_is_none(begun, name):
    (begun / "checkpoints" / name).write_text("mine")
    train(TINY, begun, progress=False)
    assert (begun / "checkpoints" / name).read_text() == "mine"


@pytest.mark.parametrize("target", ["a disk that is not there", "a file"])
def test_checkpoints_that_lead_nowhere_are_not_begun_anew(begun, target):
    shutil.rmtree(begun / "checkpoints")
    (begun.parent / "a file").write_text("mine")
    (begun / "checkpoints").symlink_to(begun.parent / target)
    metrics = begun / "metrics.jsonl"
    metrics.write_text('{"steps": 64}\n')
    with pytest.raises(NotADirectoryError, match="checkpoints must be a folder"):
        train(TINY, begun, progress=False)
    assert metrics.read_text() == '{"steps": 64}\n'


@pytest.mark.skipif(not Path("/proc/sys").is_dir(), reason="root can write to all folders")
def test_checkpoints_on_a_disk_that_is_only_read_are_told_before_the_training(begun):
    shutil.rmtree(begun / "checkpoints")
    (begun / "checkpoints").symlink_to("/proc/sys")
    with pytest.raises(OSError, match="checkpoints"):
        checkpoint.check_all({begun: TINY})


def test_a_file_in_the_place_of_a_checkpoint_is_told_before_the_training(begun):
    (begun / "checkpoints" / f"{TINY.steps}").write_text("mine")
    for begin in (lambda: train(TINY, begun), lambda: checkpoint.check_all({begun: TINY})):
        with pytest.raises(NotADirectoryError, match="checkpoints/192 must be a folder"):
            begin()
    assert (begun / "checkpoints" / f"{TINY.steps}").read_text() == "mine"


def test_a_log_that_leads_nowhere_is_told_before_the_training(begun):
    shutil.rmtree(begun / "tensorboard", ignore_errors=True)
    (begun / "tensorboard").symlink_to(begun / "a disk that is not there")
    for begin in (lambda: train(TINY, begun), lambda: checkpoint.check_all({begun: TINY})):
        with pytest.raises(NotADirectoryError, match="tensorboard must be a folder, or not be"):
            begin()


def test_metrics_that_are_cut_short_or_gone_are_told_before_a_report(begun, caplog):
    train(TINY, begun, progress=False)
    lines = (begun / "metrics.jsonl").read_text().splitlines(keepends=True)
    assert checkpoint.finished(begun, TINY)
    for left in ("".join(lines)[:-9], lines[0], ""):
        (begun / "metrics.jsonl").write_text(left)
        with pytest.raises(ValueError, match=r"ends at step .*the last checkpoint is of step 192"):
            checkpoint.finished(begun, TINY)
    (begun / "metrics.jsonl").unlink()
    assert checkpoint.finished(begun, TINY) and "metrics.jsonl is missing" in caplog.text


def test_a_training_does_not_go_on_behind_a_gap_in_its_metrics(begun):
    (begun / "metrics.jsonl").write_text("")
    with pytest.raises(ValueError, match=r"ends at step 0, and the last checkpoint is of step"):
        train(TINY, begun, progress=False)
    (begun / "metrics.jsonl").unlink()  # on purpose
    train(TINY, begun, progress=False)


def test_a_training_that_is_refused_leaves_nothing(tmp_path):
    huge = replace(TINY, width=10**7)
    with pytest.raises(MemoryError, match="need"):
        train(huge, tmp_path / "run", progress=False)
    assert not list(tmp_path.iterdir())
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "notes.txt").write_text("mine")
    with pytest.raises(MemoryError, match="need"):
        train(huge, tmp_path / "run", progress=False)
    train(TINY, tmp_path / "run", progress=False)  # which it is not held to
    assert (tmp_path / "run" / "notes.txt").read_text() == "mine"
