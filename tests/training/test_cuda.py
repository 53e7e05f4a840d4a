"""What a GPU will do, as far as a processor that pretends to be one tells: `helpers.fake_cuda`."""

import contextlib
import shutil
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch

from astray.training import checkpoint, parallel
from astray.training.fast import acceleration
from astray.training.fast.acceleration import resolve
from astray.training.loop import collect, iterate, train, update
from astray.training.trainer import Trainer
from benchmarks import profile
from benchmarks import train as bench
from helpers.checkpoints import forge
from helpers.fake_cuda import cuda
from helpers.trainings import OFF, PICTURES, PLAIN, digest

GRAPHS = PLAIN.changed(device="cuda", cudagraphs=True, steps=512, checkpoint_every=1)
# Longer than an episode.
LONGER = {"num_steps": 24, "minibatches": 2, "epochs": 2}
ENDING = replace(PLAIN, timeouts="terminate", **LONGER)  # others are valued at once there
ALL = PICTURES.changed(device="cuda", **dict.fromkeys(OFF) | {"compile": False})


def learned(config):
    """All that several iterations with different learning rates came to."""
    trainer, result = Trainer(config), []
    for rate in (2**-9, 2**-10, 2**-10):
        rollout = collect(trainer)
        result += [x.clone() for x in vars(rollout).values()]
        result.append(torch.tensor(list(update(trainer, rollout, rate).values())))
        trainer.steps += config.batch
    return [*result, *trainer.network.parameters()]


@pytest.mark.parametrize(
    ("config", "graphs"),
    [
        pytest.param(ENDING, 2, id="mlp"),
        pytest.param(PICTURES, 2, id="impala", marks=pytest.mark.thorough),
        pytest.param(
            replace(ENDING, steps=3 * ENDING.batch, teacher="solver", taught=0.5), 3, id="student"
        ),
    ],
)
def test_graphs_learn_what_plain_calls_learn(config, graphs, monkeypatch):
    plain = learned(config)
    with cuda(monkeypatch) as pretended:
        replayed = learned(config.changed(device="cuda", cudagraphs=True))
    assert len(pretended.graphs) == graphs
    assert all(torch.equal(a, b) for a, b in zip(plain, replayed, strict=True))


def test_two_groups_wait_for_their_actions_and_images(monkeypatch):
    plain = learned(replace(PLAIN, **LONGER))
    with cuda(monkeypatch):
        late = learned(GRAPHS.changed(**LONGER, groups=2))
    for a, b in zip(plain, late, strict=True):
        torch.testing.assert_close(a, b, atol=1e-4, rtol=1e-3)


def test_only_what_cuda_pinned_is_copied_later(monkeypatch):
    with cuda(monkeypatch) as pretended:
        collect(Trainer(PLAIN))  # what later copies to other memory leave, nobody knows
        assert not pretended.under_way


def test_a_gpu_sees_as_many_at_once_as_ever(monkeypatch):
    with cuda(monkeypatch):
        trainer, seen = Trainer(PLAIN.changed(device="cuda", num_steps=40, groups=2)), set()
        trainer.network.features.register_forward_pre_hook(lambda _, x: seen.add(len(x[0])))
        collect(trainer)
    assert len(trainer.player.recent) and seen == {PLAIN.num_envs // 2}


@pytest.mark.parametrize(
    "config",
    [
        pytest.param(GRAPHS, id="mlp"),
        pytest.param(
            replace(ALL, steps=96, checkpoint_every=1), id="impala", marks=pytest.mark.thorough
        ),
    ],
)
def test_a_resumed_run_is_the_one_that_was_not_stopped(config, tmp_path, monkeypatch):
    with cuda(monkeypatch) as pretended:
        train(config, tmp_path / "whole", progress=False)
        one = pretended.graphs.copy()
        shutil.copytree(tmp_path / "whole", tmp_path / "parts")
        shutil.rmtree(checkpoint.latest(tmp_path / "parts"))
        train(config, tmp_path / "parts", progress=False)
    assert len(pretended.graphs) == 2 * len(one) == 4
    assert digest(tmp_path / "parts") == digest(tmp_path / "whole")


def test_a_training_goes_on_on_another_device_and_with_other_threads(tmp_path, monkeypatch):
    config = PLAIN.changed(device="cuda", steps=3 * PLAIN.batch, threads=2, minibatches=1)
    with cuda(monkeypatch):
        for iteration in iterate(config, tmp_path):
            if iteration.number == 2:
                break
    there = checkpoint.latest(tmp_path) / checkpoint.TRAINER
    states = [f"{player}.generator" for player in iteration.trainer.players()]
    cut = dict.fromkeys(states, np.zeros(16, np.uint8))  # as large as those of a GPU
    forge(there, tensors=cut)
    refused = shutil.copytree(tmp_path, tmp_path / "another")
    with pytest.raises(ValueError, match="other settings: steps is"):
        train(replace(config, device="cpu", steps=5 * PLAIN.batch), refused, progress=False)
    with cuda(monkeypatch), pytest.raises(ValueError, match=r"generator must be torch\.uint8"):
        train(config, refused, progress=False)
    moved = Trainer(replace(config, device="cpu", threads=1))
    checkpoint.restore(tmp_path, moved)
    assert moved.steps == 2 * PLAIN.batch
    begins = {name: Trainer(moved.config).tensors()[name] for name in states}
    random = [moved.tensors()[name] for name in states]
    assert not any(torch.equal(begins[name], x) for name, x in zip(states, random, strict=True))
    train(moved.config, tmp_path, progress=False)
    assert checkpoint.finished(tmp_path, config) and checkpoint.finished(tmp_path, moved.config)


@pytest.mark.parametrize("fails", [False, True])
def test_a_communicator_ends_after_the_graphs_that_use_it(fails, tmp_path, monkeypatch):
    said = []
    monkeypatch.setenv("LOCAL_RANK", "3")
    monkeypatch.setattr(parallel.dist, "is_torchelastic_launched", lambda: True)
    monkeypatch.setattr(parallel, "_store", lambda: (torch.distributed.HashStore(), 0, 1))
    monkeypatch.setattr(torch.cuda, "set_device", lambda gpu: said.append(str(gpu)))

    def note(name, *_, device_id=None, **_options):
        said.append((name, device_id))

    for name in ("init_process_group", "destroy_process_group"):
        monkeypatch.setattr(parallel.dist, name, partial(note, name))
    if fails:
        monkeypatch.setattr(checkpoint, "save", lambda *_: 1 / 0)
    with (
        cuda(monkeypatch) as pretended,
        pytest.raises(ZeroDivisionError) if fails else contextlib.nullcontext(),
    ):
        train(replace(GRAPHS, steps=256), tmp_path, progress=False)
    begun = ["cuda:3", ("init_process_group", torch.device("cuda:3"))]
    assert said == (begun if fails else [*begun, ("destroy_process_group", None)])
    assert [bool(graph.calls) for graph in pretended.graphs] == [True, False]


@pytest.mark.thorough  # `test_benchmarks` runs it on a processor
def test_the_benchmark_runs_on_a_gpu(monkeypatch):
    monkeypatch.setattr(profile, "SIDE", 64)
    small = ALL.changed(num_envs=2, num_steps=4, bfloat16=False)
    monkeypatch.setitem(bench.CONFIGS, "cuda", (small,))
    with cuda(monkeypatch):
        rows = bench.measure(seconds=0, rounds=1, device="cuda")
    assert {row.what for row in rows if isinstance(row, bench.Row)} >= {"astray"}
    taken = [row.milliseconds for row in rows if isinstance(row, profile.Row)]
    assert len(taken) > 9 and np.isfinite(taken).all()


def test_a_gpu_learns_without_a_compiler_and_says_so(monkeypatch):
    config = ALL.changed(compile=None)
    monkeypatch.setattr(acceleration, "find_spec", lambda name: True)
    monkeypatch.setenv("CC", "gcc")
    monkeypatch.setattr(acceleration.Path, "exists", lambda path: path.name == "Python.h")
    assert resolve(config).compile
    monkeypatch.delenv("CC")
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert not resolve(config).compile
    with cuda(monkeypatch), pytest.warns(UserWarning, match="slower without torch.compile"):
        Trainer(config)


def test_a_process_compiles_for_more_agents_than_torch_lets_it(monkeypatch):
    limits, compile = torch._dynamo.config, torch.compile
    monkeypatch.setattr(torch, "compile", lambda f, **x: compile(f, backend="eager", **x))
    monkeypatch.setattr(acceleration, "compiles", lambda name: True)
    monkeypatch.setattr(limits, "recompile_limit", 1)
    for width in (8, 9, 10):
        trainer = Trainer(PLAIN.changed(compile=True, width=width))
        collect(trainer)
