"""Captured activations, in memory, files and folders."""

import errno
import json
import os

import numpy as np
import pytest

from astray import games, load_agent
from astray.acting import initial_states
from astray.analysis.critic import observe
from astray.insight.activations import activations, capture, load_activations
from astray.training import folders
from helpers import killed

MAZE = games.find("maze")
SMALL = MAZE.variant("anywhere-small")
LAYERS = ["features.relu1", "spread"]


@pytest.fixture(scope="module")
def mouse():
    return load_agent(folders.find("maze-corner"))


@pytest.fixture(scope="module")
def states():
    return initial_states("maze", SMALL, range(200_000, 200_150))


@pytest.fixture(scope="module")
def found(mouse, states):
    labels = {"right": MAZE.labels["cheese right"]}
    return capture(mouse, SMALL, states, LAYERS, measures=labels, batch=64)


def test_what_is_captured_is_what_the_layers_give(mouse, states, found):
    expected = activations(mouse, observe(mouse, SMALL, states), LAYERS)
    for name in LAYERS:
        assert (found.values[name] == expected[name]).all()
    assert found.labels["level"].to_list() == list(range(200_000, 200_150))
    assert found.labels.columns == ["level", "step", "right"]


@pytest.mark.parametrize("batch", [1, 4096])
def test_the_batch_changes_nothing(mouse, states, found, batch):
    other = capture(mouse, SMALL, states, LAYERS, batch=batch)
    assert all((other.values[name] == found.values[name]).all() for name in LAYERS)


def test_a_file_and_a_folder_hold_the_same(mouse, states, found, tmp_path):
    found.save(tmp_path / "a.npz")
    labels = {"right": MAZE.labels["cheese right"]}
    killed.left(tmp_path / "b")
    mapped = capture(mouse, SMALL, states, LAYERS, measures=labels, folder=tmp_path / "b", batch=40)
    for other in (load_activations(tmp_path / "a.npz"), load_activations(tmp_path / "b"), mapped):
        assert all((other.values[name] == found.values[name]).all() for name in LAYERS)
        assert other.labels.equals(found.labels)
    assert isinstance(mapped.values["spread"], np.memmap)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.npz", "b"]


def test_a_folder_that_is_there_is_not_touched(mouse, states, tmp_path):
    (tmp_path / "b").mkdir()
    with pytest.raises(ValueError, match="b must be a new folder"):
        capture(mouse, SMALL, states[:2], LAYERS, folder=tmp_path / "b")
    assert not list((tmp_path / "b").iterdir())


def test_a_folder_on_a_full_disk_is_told_and_no_page_is_written(
    mouse, states, tmp_path, monkeypatch
):
    def full(number, start, size):
        assert os.fstat(number).st_size == start + size > 4 * len(states)
        raise OSError(errno.ENOSPC, "no room")

    monkeypatch.setattr(os, "posix_fallocate", full, raising=False)
    monkeypatch.setattr("astray.insight.activations.observe", None)  # which asks the agent
    with pytest.raises(OSError, match=r"no room: '[^']*b.0.npy'"):
        capture(mouse, SMALL, states, LAYERS, folder=tmp_path / "b")
    assert not list(tmp_path.iterdir())


def test_what_holds_no_activations_is_told(mouse, states, tmp_path):
    with pytest.raises(FileNotFoundError, match="there are no activations at"):
        load_activations(tmp_path / "none")
    (tmp_path / "a.npz").write_bytes(b"PK\x03\x04 no archive")
    with pytest.raises(ValueError, match="holds no activations"):
        load_activations(tmp_path / "a.npz")
    for odd, said in (
        ({"x": np.ones(3)}, "unknown type 'float64' of x"),
        ({"label:level": np.array(["a"])}, "its labels are not numbers"),
    ):
        np.savez(tmp_path / "odd.npz", **odd)
        with pytest.raises(ValueError, match=said):
            load_activations(tmp_path / "odd.npz")
    np.savez(tmp_path / "pickled.npz", x=np.array([{}], object))
    with pytest.raises(ValueError, match="holds no activations"):
        load_activations(tmp_path / "pickled.npz")
    capture(mouse, SMALL, states[:2], LAYERS, folder=tmp_path / "c")
    index = json.loads((tmp_path / "c" / "index.json").read_text())
    index["layers"]["spread"] = "../a.npz"
    (tmp_path / "c" / "index.json").write_text(json.dumps(index))
    with pytest.raises(
        ValueError, match=r"unknown file '\.\./a\.npz' of layer 'spread'; there are:"
    ):
        load_activations(tmp_path / "c")


@pytest.mark.parametrize("kind", ["|V0", "|S0", "<U0", "<M8[s]", "<i4"])
def test_arrays_of_other_types_are_not_mapped(mouse, states, kind, tmp_path, monkeypatch):
    capture(mouse, SMALL, states[:2], ["spread"], folder=tmp_path / "c")
    with open(tmp_path / "c" / "0.npy", "wb") as file:
        header = {"descr": kind, "fortran_order": False, "shape": (2,)}
        np.lib.format.write_array_header_1_0(file, header)
        file.write(bytes(100))
    monkeypatch.delattr(np, "load")  # with items of no bytes it divides by zero: SIGFPE
    with pytest.raises(ValueError, match=r"no activations: unknown type .*; there are: float32"):
        load_activations(tmp_path / "c")


@pytest.mark.parametrize("names", [[], "spread", ["nowhere"]])
def test_layers_are_a_list_of_names_that_there_are(mouse, states, names):
    with pytest.raises(ValueError, match=r"layers must be|unknown layer 'nowhere'; there are: spr"):
        capture(mouse, SMALL, states[:2], names)
