"""Trainings on a Ray cluster, of which a process and a node are killed."""

import importlib.util
import json
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import pytest

from astray import world
from astray.experiments import cluster, run
from astray.experiments.workers import train_all
from astray.training import checkpoint
from astray.training.loop import train
from helpers.killed import CONFIG
from helpers.processes import environment
from helpers.rooms import WORLD
from helpers.trainings import TINY, digest, train_to_first_checkpoint

RAY = importlib.util.find_spec("ray") is not None


@pytest.mark.skipif(not RAY or sys.platform != "linux", reason="needs ray, and /proc")
@pytest.mark.thorough
def test_a_process_and_a_node_that_die_lose_nothing(tmp_path):
    words = [sys.executable, "-m", "helpers.on_ray", str(tmp_path)]
    done = subprocess.run(words, env=environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout.splitlines()[-1])
    assert all(0 < told[what]["saved"] < told[what]["done"] for what in ("process", "node"))


def test_a_node_goes_on_with_what_another_began(tmp_path, monkeypatch):
    train(TINY, tmp_path / "whole", progress=False)
    folder = tmp_path / "run"
    train_to_first_checkpoint(TINY, folder, monkeypatch)
    assert not checkpoint.finished(folder, TINY)
    cluster.train_on_node(TINY, folder, None, {})
    assert digest(folder) == digest(tmp_path / "whole")


def test_how_many_train_at_once_is_not_asked_of_a_cluster(tmp_path):
    with pytest.raises(ValueError, match="a cluster says how many agents are trained at once"):
        run.reproduce("maze-corner", "smoke", tmp_path, workers=2, on="ray")
    assert not list(tmp_path.iterdir())


def test_a_node_that_does_not_see_the_run_folder_says_so(tmp_path):
    with pytest.raises(ValueError, match="is not seen by every node"):
        cluster.train_on_node(CONFIG, tmp_path / "elsewhere", None, {})


def test_a_node_knows_the_world_of_a_training(tmp_path, monkeypatch):
    config = replace(TINY, game=WORLD, variant="end", knobs={}, validation=None, steps=256)
    monkeypatch.setattr(world, "_registered", {})  # as in a new process
    cluster.train_on_node(config, tmp_path, None, {}, WORLD)
    assert checkpoint.finished(tmp_path, config)


class Fails(Exception):
    """An error as Ray has it: its text is the node's traceback."""


@pytest.mark.parametrize(
    "cause, told",
    [
        (ValueError("a loss must be finite"), "^a loss must be finite"),
        (Fails(), "^a node of the cluster fails: ModuleNotFoundError: No module named 'mine'$"),
    ],
)
def test_an_error_on_a_node_is_told_in_a_sentence(cause, told, monkeypatch):
    library = SimpleNamespace(
        init=lambda **_: None, shutdown=lambda: None, exceptions=SimpleNamespace(RayError=Fails)
    )
    monkeypatch.setitem(sys.modules, "ray", library)
    error = Fails("ray::train_on_node()\nModuleNotFoundError: No module named 'mine'\n")
    monkeypatch.setattr(error, "cause", cause, raising=False)
    with pytest.raises((ValueError, RuntimeError), match=told), cluster.on_ray():
        raise error


def test_a_successor_waits_for_the_process_before_it(tmp_path, monkeypatch):
    waits = []
    monkeypatch.setattr(cluster, "PATIENCE", 0.2)
    monkeypatch.setattr(cluster.time, "sleep", waits.append)
    with checkpoint.claim(tmp_path, CONFIG), pytest.raises(checkpoint.Claimed):
        cluster.train_on_node(CONFIG, tmp_path, None, {})
    assert waits and set(waits) == {cluster.PAUSE}


@pytest.mark.skipif(RAY, reason="ray is installed")
def test_it_is_told_what_a_cluster_needs(tmp_path):
    with pytest.raises(ImportError, match=r'pip install ".\[cluster\]"'):
        train_all({tmp_path: CONFIG}, on="ray")
