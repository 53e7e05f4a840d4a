"""Run folders that are shared, closed or on a full disk."""

import os
import shutil
import subprocess
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from astray.analysis import runs
from astray.analysis.policies import Random, Walk
from astray.analysis.runs import open_run
from astray.analysis.tables import write_table
from astray.experiments.audit import audit
from astray.experiments.compare import compare
from astray.experiments.run import reproduce
from astray.files import write_aside
from astray.training import checkpoint, folders
from astray.training.loop import train
from astray.training.settings import SEEDS
from helpers.killed import CONFIG, contents
from helpers.owners import POSIX
from helpers.processes import begin


def test_two_processes_cannot_train_in_one_folder(tmp_path):
    program = (
        "from helpers.killed import CONFIG\nimport pathlib\nfrom astray.training.loop "
        f"import train\ntrain(CONFIG, pathlib.Path({str(tmp_path)!r}), progress=False)"
    )
    with checkpoint.claim(tmp_path, CONFIG):  # which this process trains in
        code, _, err = begin(program, tmp_path).ended()
    assert code == 1 and "another process is training in" in err
    assert not checkpoint.steps_saved(tmp_path)


@pytest.mark.parametrize("nowhere", ["", 5, b"run", "a\0b", []])
@pytest.mark.parametrize(
    "use",
    [
        lambda path: train(CONFIG, path),
        runs.load_agent,
        lambda path: write_table(pl.DataFrame({"a": 1}), path),
        lambda path: reproduce("maze-corner", "smoke", path),
        lambda path: audit("maze-corner", out=path, levels=1),
        lambda path: compare([Walk("goal"), Random()], "maze", "corner", range(1), path),
    ],
)
def test_what_is_no_path_is_refused_and_not_the_current_folder(use, nowhere, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ValueError, match="must be the path of a file or folder; got"):
        use(nowhere)
    assert not os.listdir(tmp_path)


def test_a_training_needs_a_folder():
    with pytest.raises(ValueError, match="folder must be the path of a file or folder; got None"):
        train(CONFIG, None)


def test_a_full_disk_leaves_the_run_as_it_was_and_it_goes_on_when_there_is_room(
    tmp_path, full_disk, monkeypatch
):
    saved = checkpoint.save

    def save(folder, trainer):
        if trainer.steps == 4 * 256:
            full_disk(80_000)  # room for the agent, not for the trainer
        saved(folder, trainer)

    monkeypatch.setattr(checkpoint, "save", save)
    config = replace(CONFIG, num_steps=16, steps=8 * 256)
    with pytest.raises(OSError, match=r"nothing was written: '.*trainer\.safetensors'"):
        train(config, tmp_path, progress=False)
    full_disk()
    assert checkpoint.steps_saved(tmp_path) == [512]
    assert not [p for p in tmp_path.rglob(".*") if p.name != ".lock"]
    monkeypatch.setattr(checkpoint, "save", saved)
    train(config, tmp_path, progress=False)
    train(config, tmp_path.parent / "whole", progress=False)
    assert contents(tmp_path) == contents(tmp_path.parent / "whole")


def test_a_file_that_cannot_be_replaced_is_still_there(tmp_path, full_disk):
    path = tmp_path / "file"
    write_aside(path, b"old")
    full_disk(10)
    with pytest.raises(OSError, match="what was there is still there"):
        write_aside(path, b"new" * 100)
    assert path.read_bytes() == b"old" and list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("name", ["episodes.parquet", "episodes.csv"])
def test_a_table_for_which_there_is_no_room_leaves_nothing(name, tmp_path, full_disk):
    table = pl.DataFrame({"level": np.random.default_rng(0).integers(10**9, size=5000)})
    full_disk(8192)
    with pytest.raises(OSError, match="nothing was written"):
        write_table(table, tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("settings", [{"validation": "corner"}, {"width": 10**7}])
def test_a_training_that_is_refused_leaves_no_folder(tmp_path, settings):
    config = CONFIG.changed(**settings)
    with pytest.raises((ValueError, MemoryError)):
        train(config, tmp_path / "runs" / "seed-0", progress=False)
    assert not list(tmp_path.iterdir())


def test_a_folder_that_cannot_be_written_is_explained(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(OSError, match="no run can be kept in"):
        train(CONFIG, tmp_path / "file", progress=False)
    if os.name != "nt":
        locked = tmp_path / "locked"
        locked.mkdir(mode=0o555)
        with as_nobody(), pytest.raises(OSError, match="no run can be kept in"):
            train(CONFIG, locked / "run", progress=False)


@POSIX
def test_checkpoints_that_may_not_be_looked_at_are_not_called_none():
    with tempfile.TemporaryDirectory() as run:  # pytest's are closed to others
        os.chmod(run, 0o755)
        Path(run, "checkpoints").mkdir(mode=0)
        with as_nobody(), pytest.raises(PermissionError):
            folders.latest(Path(run))


class as_nobody:
    """Without root's right to write everywhere."""

    def __enter__(self):
        self.root = os.geteuid() == 0
        if self.root:
            os.seteuid(65534)

    def __exit__(self, *error):
        if self.root:
            os.seteuid(0)


def test_the_largest_seed_trains_and_a_larger_one_is_refused_at_once(tmp_path):
    config = replace(CONFIG, seed=SEEDS - 1, steps=CONFIG.num_envs * CONFIG.num_steps)
    train(config, tmp_path / "run", progress=False)
    assert checkpoint.steps_saved(tmp_path / "run")
    with pytest.raises(ValueError, match=f"seed must be .* {SEEDS - 1}.*; got {SEEDS}"):
        replace(CONFIG, seed=SEEDS)


def test_a_checkpoint_that_its_training_removes_meanwhile_is_not_missed(tmp_path, monkeypatch):
    one = replace(CONFIG, seed=3, steps=CONFIG.num_envs * CONFIG.num_steps)
    run = tmp_path / "run"
    train(one, run, progress=False)
    last = checkpoint.latest(run)
    found = iter([last.with_name("7"), last])  # 7 is removed between the look and the opening
    monkeypatch.setattr(folders, "latest", lambda folder: next(found, last))
    assert open_run(run)[0].path.parent == last
    with pytest.raises(FileNotFoundError):
        open_run(last.with_name("7"))  # which somebody asked for


def test_an_agent_whose_file_is_gone_is_told_from_others_all_the_same(tmp_path, monkeypatch):
    one = replace(CONFIG, seed=3, steps=CONFIG.num_envs * CONFIG.num_steps)
    train(one, tmp_path / "run", progress=False)
    opened = runs.open_run(tmp_path / "run")
    opened[0].path.unlink()
    monkeypatch.setattr(runs, "open_run", lambda *_: opened)
    with pytest.raises(ValueError, match="are the same agent"):
        runs.evaluate_runs([tmp_path / "run", tmp_path / "again"], np.arange(2))


def test_a_home_folder_of_another_user_has_no_agents(tmp_path, monkeypatch):
    def closed(*_):
        raise PermissionError("closed")

    monkeypatch.setenv("ASTRAY_AGENTS", str(tmp_path))
    shut = {folders.home()}
    real = Path.glob
    monkeypatch.setattr(
        Path, "glob", lambda path, *how: (closed if path in shut else real)(path, *how)
    )
    assert folders.imported() == [] and "maze-corner" in folders.names()
    assert folders.AgentFolder.open("maze-corner").weights.is_file()


def test_who_has_no_home_folder_has_the_agents_that_come_with_astray(monkeypatch):
    def homeless(*_):
        raise RuntimeError("could not determine the home directory")

    monkeypatch.delenv("ASTRAY_AGENTS", raising=False)
    monkeypatch.setattr(folders.platformdirs, "user_data_path", homeless)
    assert folders.imported() == [] and "maze-corner" in folders.names()
    assert folders.AgentFolder.open("maze-corner").weights.is_file()
    with pytest.raises(RuntimeError, match="home"):
        folders.check_new("mine")


@pytest.mark.parametrize("name", ["random", "solver"])
def test_an_agent_has_no_name_of_a_policy_or_a_teacher(name, tmp_path):
    """Verbs then took the policy; a verdict took the agent's own episodes for the policy's."""
    with pytest.raises(ValueError, match=f"must be no policy's or teacher's; got '{name}'"):
        folders.check_new(name, tmp_path)


def test_a_file_that_shrinks_does_not_kill_who_has_read_it(tmp_path):
    shutil.copytree(folders.find("maze-corner"), tmp_path / "mouse")
    weights = folders.AgentFolder.open(tmp_path / "mouse").weights
    program = (
        f"import os\nfrom pathlib import Path\nfrom astray.agents import policy\n"
        f"tensors, _ = policy.read_tensors(Path({str(weights)!r}), 'maze')\n"
        f"os.truncate({str(weights)!r}, 9)\n"
        "print(sum(float(one.sum()) for one in tensors.values()) != 0)"
    )
    code, out, err = begin(program, tmp_path).ended()
    assert code == 0 and "True" in out, err


def test_what_a_killed_keep_left_is_removed_by_the_next_of_its_name(tmp_path):
    killed = """
import os, sys
from pathlib import Path
from astray.training.folders import made
with made(Path(sys.argv[1]), "mouse") as aside:
    (aside / "checkpoints").mkdir()
    (aside / "config.json").write_text("{}")
    os.kill(os.getpid(), 9)
"""
    subprocess.run([sys.executable, "-c", killed, tmp_path])
    assert len([*tmp_path.glob(".mouse.*")]) == 1
    with folders.made(tmp_path, "mouse") as aside:
        (aside / "config.json").write_text("{}")
        with folders.made(tmp_path, "mouse") as other:
            (other / "config.json").write_text("sooner")
        assert (aside / "config.json").exists()
        with pytest.raises(ValueError, match="there is an agent 'mouse' already"):
            folders.check_new("mouse", tmp_path)
        os.replace(tmp_path / "mouse", tmp_path / "mouse-2")
    assert sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")) == [
        "mouse", "mouse-2", "mouse-2/config.json", "mouse/config.json"
    ]  # fmt: skip
