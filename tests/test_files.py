"""What is not astray's is never removed, whatever it is called and wherever it is."""

import os
import shutil
import subprocess
import sys
import time
import tracemalloc
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import pytest

from astray.analysis import agency
from astray.cli import agents as verbs
from astray.cli import arguments
from astray.files import (
    LOCK,
    aside_of,
    check_free,
    check_writable,
    files_aside,
    folder_aside,
    hold,
    make_folder,
    read,
    remove_left,
    remove_made,
    write_aside,
)
from astray.kernel import cache, jit
from astray.training import checkpoint
from astray.training.config import PRESETS
from astray.training.loop import train
from helpers.owners import POSIX

NAMES = (checkpoint.AGENT, checkpoint.TRAINER)
TINY = replace(
    PRESETS["small"],
    variant="corner-small",
    num_envs=8,
    num_steps=4,
    minibatches=1,
    width=4,
    steps=32,
    validation_every=1,
)


def home(folder):
    """A folder with what people have in theirs; and what is in it."""
    for path in (".ssh/id", ".2048/notes", ".config.json", ".mouse/agent.safetensors", "run/x"):
        (folder / path).parent.mkdir(parents=True, exist_ok=True)
        (folder / path).write_text(path)
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def test_a_small_file_takes_little_memory_to_read(tmp_path):
    """Python allocates what a read asks for: under a limit, any file was one of 4 GB."""
    (tmp_path / "few").write_bytes(b"bytes")
    tracemalloc.start()
    assert read(tmp_path / "few") == b"bytes" and tracemalloc.get_traced_memory()[1] < 2**20
    tracemalloc.stop()


def test_a_file_is_written_beside_hidden_ones_of_its_name(tmp_path):
    there = home(tmp_path)
    write_aside(tmp_path / "config.json", b"new")
    write_aside(tmp_path / "config.json", b"newer")
    assert (tmp_path / "config.json").read_bytes() == b"newer"
    assert all(path.read_bytes() == data for path, data in there.items())
    assert len(list(tmp_path.iterdir())) == 6  # and nothing is left of it


def test_a_folder_that_was_not_finished_is_removed_alone(tmp_path):
    there = home(tmp_path)
    with pytest.raises(RuntimeError), folder_aside(tmp_path / "ssh") as aside:
        (aside / "file").write_text("half")
        raise RuntimeError
    with folder_aside(tmp_path / "mouse") as aside:
        os.replace(aside, tmp_path / "mouse")
    assert (tmp_path / "mouse").is_dir() and not aside.exists()
    assert all(path.read_bytes() == data for path, data in there.items())


def test_no_folder_is_left_of_what_was_not_written(tmp_path):
    (tmp_path / "there").mkdir()
    for folder in (tmp_path / "new" / "deep", tmp_path / "there" / "deep"):
        check_writable(folder / "told")
        with pytest.raises(RuntimeError), folder_aside(folder / "mouse") as aside:
            assert aside.is_dir()
            raise RuntimeError
    with pytest.raises(OSError), folder_aside(tmp_path / "new" / ("a" * 5000)):
        pass
    assert [path.name for path in tmp_path.rglob("*")] == ["there"]


def test_a_folder_without_room_is_told_by_its_own_name(tmp_path, full_disk):
    (tmp_path / "mine").write_bytes(bytes(99))
    full_disk(10)
    said = pytest.raises(OSError, match=r"large; nothing was written: '[^']*[^.]site.page'$")
    with said, folder_aside(tmp_path / "site") as aside:
        write_aside(aside / "page", bytes(99))
    copies = pytest.raises(OSError, match=r"mine' -> '[^']*[^.]site.page'$")
    with copies, folder_aside(tmp_path / "site") as aside:
        shutil.copyfile(tmp_path / "mine", aside / "page")
    (tmp_path / "mine").unlink()
    with pytest.raises(OSError, match=r"^the hub is closed$"), folder_aside(tmp_path / "site"):
        raise OSError("the hub is closed")
    assert not list(tmp_path.iterdir())


def test_files_of_a_page_come_all_or_none(tmp_path, full_disk):
    folder, sign = tmp_path / "page", b"by astray"
    with files_aside(folder, "page.html", sign) as aside:
        write_aside(aside / "figures" / "one.png", b"one")
        write_aside(aside / "page.html", sign)
    there = {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}
    assert [path.name for path in there] == ["page.html", "one.png"]
    full_disk(10)
    said = pytest.raises(OSError, match=r"large; nothing was written: '[^']*page.figures.two.png'$")
    for empty in (folder, tmp_path / "new" / "page"):
        with said, files_aside(empty, "page.html", sign) as aside:
            write_aside(aside / "page.html", b"small")
            write_aside(aside / "figures" / "two.png", bytes(99))
    full_disk()
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "figures").write_text("of the user's")
    with (
        pytest.raises(OSError, match="figures was not written by astray"),
        files_aside(tmp_path / "mine", "page.html", sign) as aside,
    ):
        write_aside(aside / "figures" / "one.png", b"one")
    assert {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()} == there
    assert sorted(path.name for path in tmp_path.iterdir()) == ["mine", "page"]


def test_what_a_killed_process_left_of_a_page_is_removed_by_the_next(tmp_path):
    killed = """
import os, sys
from pathlib import Path
from astray.files import files_aside, write_aside
with files_aside(Path(sys.argv[1]), "page.html", b"by astray") as aside:
    write_aside(aside / "figures" / "one.png", b"one")
    os.kill(os.getpid(), 9)
"""
    mine = [tmp_path / f".page.html.{name}" for name in ("mine", "0" * 32)]
    for path in mine:
        path.mkdir()
        (path / "thesis.tex").write_text("of the user's")
    subprocess.run([sys.executable, "-c", killed, tmp_path])
    aside_of(tmp_path / "page.html").mkdir()  # of one that was killed before it locked it
    left = {path.name for path in tmp_path.iterdir()}
    assert len(left) == 4
    with files_aside(tmp_path, "page.html", b"by astray") as aside:
        write_aside(aside / "page.html", b"by astray")
        with files_aside(tmp_path, "page.html", b"by astray") as other:
            write_aside(other / "page.html", b"by astray, sooner")
        assert (aside / "page.html").exists()
    assert {path.name for path in tmp_path.iterdir()} == {*(one.name for one in mine), "page.html"}
    assert all((path / "thesis.tex").exists() for path in mine)


@pytest.mark.parametrize("name", ["told.parquet", "[to]ld**.parquet"])
def test_what_a_killed_process_left_of_a_check_is_removed_by_the_next(tmp_path, name):
    killed = """
import os, sys
from pathlib import Path
from astray import files
files.write_aside = lambda path, data: (path.with_name("half").write_bytes(data), os._exit(9))
files.check_writable(Path(sys.argv[1]))
"""
    subprocess.run([sys.executable, "-c", killed, tmp_path / name])
    assert len(list(tmp_path.iterdir())) == 1
    check_writable(tmp_path / name)
    assert not list(tmp_path.iterdir())


def test_a_disk_without_room_for_a_result_is_told_before_the_work(tmp_path, full_disk):
    full_disk(100_000)
    with pytest.raises(OSError, match=r"large; nothing was written: '[^']*new.told'$"):
        check_writable(tmp_path / "new" / "told")
    assert not list(tmp_path.iterdir())


def test_what_killed_processes_left_is_removed_and_nothing_else(tmp_path):
    there = home(tmp_path)
    left = aside_of(tmp_path / "2048")
    left.mkdir()
    for name in (*NAMES, aside_of(left / checkpoint.AGENT).name):
        (left / name).write_text("half")
    with_more = aside_of(tmp_path / "4096")
    with_more.mkdir()
    (with_more / "thesis.tex").write_text("mine")
    linked = aside_of(tmp_path / "1024")
    linked.symlink_to(tmp_path / ".mouse")
    remove_left(tmp_path, NAMES)
    assert not left.exists() and linked.is_symlink()
    assert (with_more / "thesis.tex").exists()
    assert all(path.read_bytes() == data for path, data in there.items())


def test_training_leaves_hidden_folders_alone_also_through_a_link(tmp_path):
    (tmp_path / "home").mkdir()
    there = home(tmp_path / "home")
    (tmp_path / "run").mkdir()
    (tmp_path / "run/checkpoints").symlink_to(tmp_path / "home", target_is_directory=True)
    train(TINY, tmp_path / "run")
    with pytest.raises(ValueError, match="holds a run with other settings"):
        train(replace(TINY, steps=64), tmp_path / "run")
    assert all(path.read_bytes() == data for path, data in there.items())


def test_a_copy_of_a_checkpoint_is_none(tmp_path):
    train(TINY, tmp_path)
    (tmp_path / "checkpoints/32").rename(tmp_path / "checkpoints/32.bak")
    (tmp_path / "checkpoints/\u00b2").mkdir()
    assert checkpoint.steps_saved(tmp_path) == []
    train(TINY, tmp_path)
    assert checkpoint.steps_saved(tmp_path) == [32]
    assert (tmp_path / "checkpoints/32.bak" / checkpoint.AGENT).exists()


def test_old_compiled_code_is_removed_and_nothing_else(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    old, other, strange = (tmp_path / "astray" / n for n in ("0" * 16, "photos", "1" * 16))
    for folder in (old, other, strange):
        (folder / "envs_0").mkdir(parents=True)
        for name in ("used", "compile.lock", "envs_0/loops.nbi", "envs_0/loops.1.nbc"):
            (folder / name).write_text("")
        os.utime(folder / "used", (0, time.time() - 2 * cache.KEPT_FOR))
    (strange / "thesis.tex").write_text("mine")
    (tmp_path / "astray" / ("2" * 16)).symlink_to(other)
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    folder = Path(cache.cache_folder(jit.version_digest()))
    assert folder.name == jit.version_digest() and not old.exists()
    assert (other / "envs_0/loops.nbi").exists() and (strange / "thesis.tex").exists()


@pytest.mark.parametrize("name", ["report.html", "posterior.png"])
@pytest.mark.parametrize("target", ["mine", "nowhere"])
def test_no_file_takes_the_place_of_a_link(tmp_path, name, target):
    (tmp_path / "mine").write_text("mine")
    link = tmp_path / name
    link.symlink_to(tmp_path / target)
    with pytest.raises(OSError, match=f"{name} must be a file to write; it is a link"):
        write_aside(link, b"ours")
    assert link.is_symlink() and (tmp_path / "mine").read_text() == "mine"
    assert len(list(tmp_path.iterdir())) == 2


@POSIX
def test_another_user_s_file_in_a_folder_as_tmp_is_told_before_the_work(tmp_path, monkeypatch):
    (tmp_path / "episode.mp4").write_text("theirs")
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    check_writable(tmp_path / "episode.mp4")
    tmp_path.chmod(0o1777)
    with pytest.raises(PermissionError, match=r"episode\.mp4 is another user's"):
        check_writable(tmp_path / "episode.mp4")
    check_writable(tmp_path / "mine.mp4")


@pytest.mark.parametrize("name", ["episodes.parquet", "posterior.mp4", "posterior.gif"])
def test_all_that_a_verb_writes_is_seen_before_anything_is_played(tmp_path, monkeypatch, name):
    (tmp_path / name).mkdir()
    monkeypatch.setattr(agency, "assess_policy", lambda *a, **k: pytest.fail("it was played"))
    with pytest.raises(OSError, match=rf"{name} (must be a file|was not written by astray)"):
        verbs.agency(arguments.TestedPlayer(Path("maze-corner")), out=tmp_path)


def test_what_astray_did_not_write_is_not_replaced(tmp_path):
    (tmp_path / "report.html").write_text("mine")
    with pytest.raises(
        OSError, match=r"report\.html was not written by astray, which would have plan"
    ):
        check_free(tmp_path, "plan.json", b"ours", ("figures", "report.html"))
    check_free(tmp_path, "plan.json", b"ours", ("figures", "tables"))
    (tmp_path / "plan.json").write_text("my plan")
    with pytest.raises(
        OSError, match=r"plan\.json was not written by astray; it would be replaced"
    ):
        check_free(tmp_path, "plan.json", b"ours", ("figures", "tables"))
    (tmp_path / "plan.json").write_text("it is ours")
    check_free(tmp_path, "plan.json", b"ours", ("figures", "report.html"))


def test_a_link_among_what_is_written_again_is_told_before_the_work(tmp_path):
    (tmp_path / "plan.json").write_text("it is ours")
    (tmp_path / "figures").mkdir()
    (tmp_path / "figures" / "curve.png").symlink_to(tmp_path / "mine.png")
    with pytest.raises(OSError, match=r"curve\.png must be a file to write; it is a link"):
        check_free(tmp_path, "plan.json", b"ours", ("figures", "report.html"))


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="there are no pipes with names")
@pytest.mark.parametrize("make, what", [(os.mkdir, "a folder"), (os.mkfifo, "a pipe")])
def test_a_folder_or_pipe_in_the_place_of_a_file_is_told_before_the_work(make, what, tmp_path):
    (tmp_path / "plan.json").write_text("it is ours")
    (tmp_path / "figures").mkdir()
    names = ("figures", "findings.json")
    check_free(tmp_path, "plan.json", b"ours", names)
    make(tmp_path / "findings.json")
    with pytest.raises(OSError, match=rf"findings\.json must be a file to write; it is {what}"):
        check_free(tmp_path, "plan.json", b"ours", names)


@pytest.mark.parametrize(
    "name, is_ours", [("figures", True), ("computed", True), ("computed", False)]
)
def test_a_file_in_the_place_of_a_folder_is_told_before_the_work(name, is_ours, tmp_path):
    if is_ours:
        (tmp_path / "plan.json").write_text("it is ours")
    names = ("figures", "report.html")
    (tmp_path / "computed").mkdir()
    check_free(tmp_path, "plan.json", b"ours", names, ("computed",))
    (tmp_path / "computed").rmdir()
    (tmp_path / name).write_text("mine")
    with pytest.raises(
        NotADirectoryError, match=f"{name} must be a folder to write to; it is a file"
    ):
        check_free(tmp_path, "plan.json", b"ours", names, ("computed",))


@pytest.mark.parametrize("error", [KeyboardInterrupt, MemoryError, OSError])
def test_nothing_is_left_beside_a_file_that_was_not_written(tmp_path, monkeypatch, error):
    (tmp_path / "a").write_bytes(b"old")

    def fails(_):
        raise error

    monkeypatch.setattr(os, "fsync", fails)
    with pytest.raises(error):
        write_aside(tmp_path / "a", b"new")
    assert [p.name for p in tmp_path.iterdir()] == ["a"] and (tmp_path / "a").read_bytes() == b"old"


def test_a_check_that_made_a_folder_leaves_it_to_another_that_holds_it(tmp_path):
    """A second training would begin in it, and both write to the same files."""
    made = make_folder(tmp_path / "run")
    with hold(tmp_path / "run", "is training in"):
        remove_made(made)
        assert (tmp_path / "run" / LOCK).exists()
        with pytest.raises(TimeoutError), hold(tmp_path / "run", "is training in", wait=False):
            pass
    remove_made(made)
    assert not (tmp_path / "run").exists()


def test_a_folder_that_is_removed_while_it_is_looked_at_is_made_anew(tmp_path, monkeypatch):
    there = os.path.lexists

    def removed(path):
        return there(path) and (path.name != "run" or path.rmdir() is None)

    (run := tmp_path / "run").mkdir()
    monkeypatch.setattr(os.path, "lexists", removed)
    assert make_folder(run) == [run] and run.is_dir()


def test_a_folder_that_is_removed_while_another_waits_for_it_is_made_anew(tmp_path, capsys):
    """The one that waited ended with FileNotFoundError, where the first had made the folder."""

    def held():
        with hold(tmp_path / "run", "is training in"):
            return os.listdir(tmp_path / "run")

    with ThreadPoolExecutor() as pool:
        with hold(tmp_path / "run", "is training in"):
            second = pool.submit(held)
            while "waiting for it" not in capsys.readouterr().err:
                time.sleep(0.01)
        assert second.result() == [LOCK]
    assert not (tmp_path / "run").exists()
