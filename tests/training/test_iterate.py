"""The training as a generator: what is looked at on the way changes nothing that is learned."""

import contextlib
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

import astray
from astray.analysis.adapters import from_trainer
from astray.insight.probes import untrained
from astray.training import checkpoint
from astray.training.loop import train
from helpers.processes import environment
from helpers.thorough import thorough
from helpers.trainings import OFF, TINY, digest, train_to_first_checkpoint

LEVELS = range(200_000, 200_010)
VARIANT = TINY.variant_for(TINY.validation)


def looked_at(iteration):
    """All that a curious caller may do between two iterations."""
    torch.rand(3)
    np.random.rand(3)  # noqa: NPY002
    torch.set_num_threads(2)
    iteration.trainer.network(iteration.trainer.player.images[:4])
    astray.evaluate(from_trainer(iteration.trainer), "maze", VARIANT, LEVELS)


def test_a_run_that_was_looked_at_has_the_weights_of_one_that_was_not(tmp_path):
    train(TINY, tmp_path / "plain", progress=False)
    numbers = []
    for iteration in astray.iterate(TINY, tmp_path / "seen"):
        numbers.append((iteration.number, iteration.steps))
        looked_at(iteration)
    assert numbers == [(k, 256 * k) for k in range(1, 5)]
    assert digest(tmp_path / "seen") == digest(tmp_path / "plain")
    assert checkpoint.metrics(tmp_path / "seen") == checkpoint.metrics(tmp_path / "plain")


@pytest.fixture
def doubles():
    """A program whose default is float64 on another device, and that computes no gradients."""
    torch.set_default_dtype(torch.float64)
    with torch.no_grad(), torch.device("meta"):
        yield
    torch.set_default_dtype(torch.float32)


@pytest.mark.usefixtures("doubles")
def test_in_a_program_with_other_defaults_agents_are_trained_and_loaded_the_same(tmp_path):
    """In float64 neither was possible, and without gradients the loss was blamed."""
    next(astray.iterate(TINY, tmp_path / "doubles"))  # stopped, it writes a checkpoint
    train(TINY, tmp_path / "doubles", progress=False)
    agent = astray.load_agent(tmp_path / "doubles")
    untrained(agent, 0).outputs(np.zeros((1, *agent.space.shape), np.uint8))
    assert torch.get_default_dtype() == torch.float64 and not torch.is_grad_enabled()
    played = astray.evaluate(agent, "maze", VARIANT, LEVELS)
    torch.set_default_dtype(torch.float32)
    with torch.device("cpu"):
        train(TINY, tmp_path / "plain", progress=False)
    assert digest(tmp_path / "doubles") == digest(tmp_path / "plain")
    assert played.equals(
        astray.evaluate(astray.load_agent(tmp_path / "plain"), "maze", VARIANT, LEVELS)
    )


def test_without_a_folder_it_learns_the_same_and_writes_nothing(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for iteration in astray.iterate(TINY):
        last = {name: x.clone() for name, x in iteration.trainer.network.state_dict().items()}
    assert list(tmp_path.iterdir()) == []
    train(TINY, tmp_path / "run", progress=False)
    kept = astray.load_agent(tmp_path / "run").network.state_dict()
    assert all(torch.equal(last[name], x) for name, x in kept.items())


def test_who_leaves_the_loop_goes_on_from_there(tmp_path):
    for iteration in astray.iterate(TINY, tmp_path / "run"):
        if iteration.number == 3:  # no checkpoint would be due here
            break
    assert checkpoint.steps_saved(tmp_path / "run") == [512, 768]
    assert [i.number for i in astray.iterate(TINY, tmp_path / "run")] == [4]
    train(TINY, tmp_path / "plain", progress=False)
    assert digest(tmp_path / "run") == digest(tmp_path / "plain")


KEPT = """
import sys
import astray
from helpers.trainings import TINY

def look(iterations):
    for iteration in iterations:
        if iteration.number == 3:
            raise KeyError("mine") if sys.argv[2:] else SystemExit(0)

iterations = astray.iterate(TINY, sys.argv[1])
look(iterations)
"""


@pytest.mark.parametrize("error", [["error"], *thorough([])])
def test_a_program_that_still_holds_the_loop_when_it_ends_has_a_checkpoint_too(tmp_path, error):
    """Python ended the generator after torch was half gone: it aborted, and nothing was saved."""
    command = [sys.executable, "-c", KEPT, str(tmp_path / "run"), *error]
    ended = subprocess.run(command, env=environment(), capture_output=True, text=True)
    assert ended.returncode == len(error), ended.stderr
    assert not error or ended.stderr.endswith("KeyError: 'mine'\n")
    assert checkpoint.steps_saved(tmp_path / "run") == [512, 768]


def test_the_run_folder_is_free_again_once_the_loop_is_left(tmp_path):
    for _ in astray.iterate(TINY, tmp_path):
        break
    with checkpoint.claim(tmp_path, TINY):
        pass


def test_metrics_are_those_that_are_written(tmp_path):
    seen = [{"steps": i.steps, **i.metrics} for i in astray.iterate(TINY, tmp_path)]
    assert seen == checkpoint.metrics(tmp_path)
    assert {"training/return", "validation/return", "update/entropy"} <= seen[-1].keys()


def test_torchs_settings_are_the_callers_own_between_iterations():
    before = torch.get_num_threads()
    for _ in astray.iterate(replace(TINY, threads=2, num_steps=2, steps=64)):
        assert torch.get_num_threads() == before
        assert sys.float_info.min / 2 > 0


def test_a_training_goes_on_with_other_acceleration(tmp_path, monkeypatch):
    plain = TINY.changed(**OFF)
    whole = astray.train(plain, tmp_path / "whole", progress=False)
    train_to_first_checkpoint(plain, tmp_path / "parts", monkeypatch)
    other = TINY.changed(fused_cpu=False, groups=2)
    parts = astray.train(other, tmp_path / "parts", progress=False)
    kept = (load_file(path / checkpoint.AGENT) for path in (whole, parts))
    for one, two in zip(*(weights.values() for weights in kept), strict=True):
        assert torch.allclose(one, two, atol=1e-3)


def test_wrong_settings_are_told_before_anything_is_written(tmp_path):
    for config, message in ((3, "config must be a Config"), (TINY, "is not the settings of a run")):
        (tmp_path / "config.json").write_text("[]")
        with pytest.raises(ValueError, match=message):
            next(astray.iterate(config, tmp_path))
    assert [path.name for path in tmp_path.iterdir() if path.name != ".lock"] == ["config.json"]


@pytest.mark.parametrize("mode", ["sampled", "greedy"])
def test_a_trainers_policy_plays_as_its_checkpoint_does(tmp_path, mode):
    for iteration in astray.iterate(TINY, tmp_path):
        live = from_trainer(iteration.trainer, mode)
        played = astray.evaluate(live, "maze", VARIANT, LEVELS)
    last = astray.evaluate(astray.load_agent(tmp_path, mode), "maze", VARIANT, LEVELS)
    assert played.drop("policy").equals(last.drop("policy"))


PAGE = Path(__file__).parents[2] / "docs" / "training.md"


def examples():
    """The blocks of the page on training that iterate."""
    blocks = PAGE.read_text(encoding="utf-8").split("```python\n")[1:]
    return [block.split("```")[0] for block in blocks if "astray.iterate" in block]


@pytest.mark.skipif(not PAGE.exists(), reason="the documentation is not beside the tests")
@pytest.mark.parametrize("code", examples())
def test_what_the_page_shows_runs(code, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = {"config": replace(TINY, steps=512, knobs={})}
    with contextlib.redirect_stdout(None):
        exec(code, names)
    assert checkpoint.steps_saved(tmp_path / "runs" / "mouse")
