"""Every setting of speed leaves learning as it is: groups, bfloat16, layouts, compilation, graphs.

What needs a GPU is tested where there is one.
"""

import functools
import shutil
from dataclasses import replace

import numpy as np
import pytest
import torch

from astray.agents.policy import usable
from astray.training.config import PRESETS
from astray.training.fast.acceleration import agreement, resolve
from astray.training.fast.graphs import restore
from astray.training.loop import collect, train, update
from astray.training.trainer import Trainer
from helpers.thorough import thorough
from helpers.trainings import OFF, PICTURES, PLAIN, TINY, digest, train_to_first_checkpoint

FEWEST = PICTURES.changed(num_envs=2, num_steps=2, epochs=1, steps=12)  # of three iterations
ON_GPU = pytest.mark.skipif(not usable("cuda"), reason="there is no CUDA device")


def iteration(config):
    """A trainer, the rollout it played, and what its weights became."""
    trainer = Trainer(config)
    rollout = collect(trainer)
    metrics = update(trainer, rollout, 1e-3)
    weights = torch.cat([p.detach().flatten().cpu() for p in trainer.network.parameters()])
    return trainer, rollout, weights, metrics


def test_what_suits_a_cpu():
    suits = resolve(TINY)
    assert suits.fused_cpu and not (suits.channels_last or suits.compile or suits.cudagraphs)
    assert suits.groups == 1
    assert not any(vars(resolve(PRESETS["paper"].changed(**OFF)))[name] for name in list(OFF)[:5])


def test_what_suits_a_gpu():
    suits = resolve(replace(PRESETS["paper"], device="cuda"))
    assert suits.bfloat16 and suits.channels_last and suits.cudagraphs and suits.groups == 2
    assert not suits.fused_cpu
    assert resolve(replace(PRESETS["paper"], device="cuda", teacher="solver")).cudagraphs
    off = resolve(PRESETS["paper"].changed(**OFF, device="cuda"))
    assert not (off.bfloat16 or off.channels_last or off.compile or off.cudagraphs)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"cudagraphs": True}, "cudagraphs must be off with device='cpu'"),
        ({"channels_last": True}, "channels_last must be off with .* network='mlp'"),
        ({"groups": 3}, "16 environments are not divided into 3 groups"),
        ({"groups": 0}, "groups must be from 1 to 2147483647; got 0"),
        ({"cudagraphs": 1}, "cudagraphs must be of type bool; got 1"),
    ],
)
def test_what_is_not_there_is_explained(change, message):
    with pytest.raises(ValueError, match=message):
        Trainer(PLAIN.changed(**change))


def test_without_a_compiler_nothing_is_compiled(monkeypatch):
    monkeypatch.setattr(shutil, "which", lambda name: None)
    assert not resolve(PLAIN).compile
    with pytest.raises(ValueError, match="compile must be off"):
        resolve(PLAIN.changed(compile=True))


def test_groups_play_what_all_play_together():
    one, two = (iteration(PLAIN.changed(groups=count, num_steps=40)) for count in (1, 4))
    for a, b in zip(vars(one[1]).values(), vars(two[1]).values(), strict=True):
        torch.testing.assert_close(a, b, atol=1e-5, rtol=1e-4)
    assert torch.equal(one[1].action, two[1].action)
    assert one[0].player.recent == two[0].player.recent and one[0].player.recent
    torch.testing.assert_close(one[2], two[2], atol=1e-4, rtol=1e-3)


def test_acting_and_learning_round_alike_without_speed():
    assert abs(iteration(PLAIN)[3]["first_kl"]) < 1e-6


def test_the_next_rollout_overwrites_the_last():
    trainer = Trainer(replace(TINY, validation=None))
    first = collect(trainer)
    kept = first.action.clone()
    assert collect(trainer).action.data_ptr() == first.action.data_ptr()
    assert not torch.equal(first.action, kept)


@pytest.mark.parametrize("change", [{"bfloat16": True}, {"channels_last": True}], ids=str)
def test_impalas_gradient_is_near_the_plain_one(change):
    trainer = Trainer(PICTURES.changed(num_steps=2, **change))
    samples, g = collect(trainer).flat(), torch.Generator().manual_seed(0)
    noise = torch.randn(2, len(samples), generator=g)
    samples = replace(samples, advantage=noise[0], target=noise[1])  # as if much had happened
    cosine, ratio = agreement(trainer.fast, trainer.network, samples, trainer.config).values()
    exact = "channels_last" in change
    assert cosine > (0.999999 if exact else 0.99) and abs(ratio - 1) < (1e-4 if exact else 0.03)
    assert exact or cosine < 0.999999, "it is rounded"


@pytest.mark.skipif(not shutil.which("g++"), reason="there is no C++ compiler")
@pytest.mark.parametrize("backend", ["eager", *thorough("aot_eager")])
def test_the_compiled_loss_is_the_plain_one(backend, monkeypatch):
    # What torch.compile makes of Python, and of gradients, too; machine code takes a minute or two.
    monkeypatch.setattr(torch, "compile", functools.partial(torch.compile, backend=backend))
    monkeypatch.setattr(torch._dynamo.config, "fail_on_recompile_limit_hit", True)
    whole = PLAIN.changed(minibatches=1)  # each number of samples is compiled anew
    plain, compiled = (iteration(whole.changed(compile=on)) for on in (False, True))
    assert torch.equal(plain[1].action, compiled[1].action)
    torch.testing.assert_close(plain[2], compiled[2], atol=1e-4, rtol=1e-3)
    trainer, rollout = compiled[:2]
    cosine, ratio = agreement(
        trainer.fast, trainer.network, rollout.flat(), trainer.config
    ).values()
    assert cosine > 0.9999 and ratio == pytest.approx(1, abs=1e-3)


@pytest.mark.parametrize(
    "config",
    [
        TINY.changed(groups=2, bfloat16=True),
        *thorough(FEWEST.changed(channels_last=True, bfloat16=True)),
    ],
    ids=["groups, bfloat16", "bfloat16, channels last"],
)
def test_a_resumed_run_is_the_one_that_was_not_stopped(config, tmp_path, monkeypatch):
    config = replace(config, checkpoint_every=2)
    train(config, tmp_path / "whole", progress=False)
    train_to_first_checkpoint(config, tmp_path / "parts", monkeypatch)
    train(config, tmp_path / "parts", progress=False)
    assert digest(tmp_path / "parts") == digest(tmp_path / "whole")


def test_what_a_warm_up_learned_is_undone():
    trainer = Trainer(PLAIN)
    before = {id(x): x.detach().clone() for x in trainer.learned()}
    update(trainer, collect(trainer), 1e-3)
    changed = [x.clone() for x in trainer.learned()]
    restore(trainer.learned(), before)
    for weight in trainer.network.parameters():
        assert torch.equal(weight, before[id(weight)])
    moments = trainer.learned()[len(before) :]
    assert moments and not any(x.any() for x in moments)
    assert all(x.any() for x in changed[len(before) :])


@ON_GPU
@pytest.mark.filterwarnings("ignore:.*torch.jit:DeprecationWarning")
@pytest.mark.parametrize(
    "change", [{"cudagraphs": True}, {"compile": True}, {"groups": 2}], ids=str
)
def test_an_iteration_on_a_gpu_is_the_plain_one(change):
    config = replace(PICTURES, device="cuda", num_envs=32)
    plain, fast = iteration(config), iteration(config.changed(**change))
    assert (plain[1].action == fast[1].action).float().mean() > 0.99
    # Adam's first step has the size of the rate, and the sign of gradients that are nearly 0.
    apart = (plain[2] - fast[2]).abs() > 1e-3
    assert apart.float().mean() < 1e-4


@ON_GPU
@pytest.mark.filterwarnings("ignore:learning is slower", "ignore:.*torch.jit:DeprecationWarning")
def test_all_of_it_together_learns_on_a_gpu():
    trainer = Trainer(PICTURES.changed(device="cuda", num_envs=32, **dict.fromkeys(OFF)))
    for _ in range(3):
        metrics = update(trainer, collect(trainer), 1e-3)
    assert np.isfinite(list(metrics.values())).all() and metrics["first_kl"] < 1e-2
    samples = collect(trainer).flat().at(torch.arange(64, device="cuda"))
    cosine, ratio = agreement(trainer.fast, trainer.network, samples, trainer.config).values()
    assert cosine > 0.99 and ratio == pytest.approx(1, abs=0.05)
