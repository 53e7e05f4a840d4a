"""Two processes that are begun as torchrun does learn what one does with the batch of both."""

import shutil
import socket
import subprocess
import sys

import numpy as np
import pytest
from safetensors.numpy import load_file

from astray.training import checkpoint, parallel
from astray.training.loop import train
from helpers.parallel import CONFIG
from helpers.processes import begin, environment

TRAIN = "import runpy; runpy.run_module('helpers.parallel', run_name='__main__')"


def run(*folders):
    """Train by two processes, begun as torchrun does, in one folder after the other."""
    with socket.socket() as free:
        free.bind(("localhost", 0))
        port = str(free.getsockname()[1])
    told = {"WORLD_SIZE": "2", "MASTER_ADDR": "localhost", "MASTER_PORT": port}
    told |= {"TORCHELASTIC_RUN_ID": "one"}
    both = [
        begin(
            TRAIN, folders[0].parent, *folders, env=environment(RANK=rank, LOCAL_RANK=rank, **told)
        )
        for rank in ("0", "1")
    ]
    codes, _, said = zip(*(one.ended() for one in both), strict=True)
    assert codes == (0, 0), said


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("runs")
    train(CONFIG, folder / "one", progress=False)
    begun_by(folder / "one", folder / "one, then two")
    run(folder / "two", folder / "one, then two")
    return folder / "one", folder / "two"


def begun_by(run, folder):
    """Copy a run without its last checkpoint."""
    shutil.copytree(run, folder)
    shutil.rmtree(checkpoint.latest(folder))


def test_who_writes_is_known_before_they_are_joined(monkeypatch):
    assert parallel.first()
    monkeypatch.setenv("RANK", "1")  # which others than torchrun set, too
    assert parallel.first()
    monkeypatch.setenv("TORCHELASTIC_RUN_ID", "1")
    assert not parallel.first()
    monkeypatch.setenv("RANK", "0")
    assert parallel.first()


def compare(one, two):
    for path in (checkpoint.AGENT, checkpoint.TRAINER):
        a, b = (load_file(checkpoint.latest(folder) / path) for folder in (one, two))
        assert a.keys() == b.keys()
        for name in a:
            np.testing.assert_allclose(a[name], b[name], rtol=1e-3, atol=2e-5, err_msg=name)


def test_two_processes_learn_what_one_does(runs):
    compare(*runs)


@pytest.mark.thorough
def test_two_processes_of_torchrun_learn_what_one_does_twice(runs, tmp_path):
    """The second training met where nobody listened any more, and ended in an error."""
    words = [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node"]
    words += ["2", "-m", "helpers.parallel", str(tmp_path / "two"), str(tmp_path / "again")]
    done = subprocess.run(words, env=environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    compare(runs[0], tmp_path / "two")
    compare(tmp_path / "two", tmp_path / "again")


def test_they_tell_what_one_tells(runs):
    one, two = map(checkpoint.metrics, runs)
    assert [line["steps"] for line in one] == [line["steps"] for line in two]
    for a, b in zip(one, two, strict=True):
        assert a.keys() == b.keys()
        for name in a:
            assert a[name] == pytest.approx(b[name], rel=1e-3, abs=1e-5), name


def test_what_two_began_one_can_end_and_the_reverse(runs, tmp_path):
    one, two = runs
    ended_by_two = one.with_name("one, then two")
    begun_by(two, tmp_path / "two, then one")
    train(CONFIG, tmp_path / "two, then one", progress=False)
    compare(ended_by_two, tmp_path / "two, then one")
    compare(ended_by_two, one)
