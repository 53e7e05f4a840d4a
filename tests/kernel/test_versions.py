"""Compiled code of other versions and of functions before their edit is found, and can go."""

import json
import os
import sys
import time

import numba
import pytest
from filelock import FileLock

import astray
from astray import cli
from astray.kernel import cache, jit, versions
from helpers.owners import POSIX, give_away

pytestmark = pytest.mark.usefixtures("alone")
OLD = "1" * 16


def a_version(home, digest=OLD, used=0.0):
    """A folder of compiled code as a process of another version left it."""
    folder = home / digest
    (folder / "envs_0").mkdir(parents=True)
    for name in (
        "compile.lock",
        "compile-maze.lock",
        "envs_0/loops.run-9.py311.nbi",
        "envs_0/loops.run-9.py311.1.nbc",
        "envs_0/loops.run-9.py311.2.nbc.tmp.0123456789abcdef",
    ):
        (folder / name).write_bytes(b"123")
    (folder / "used").write_text("astray 0.0.1, numba 0.61.0\n")
    os.utime(folder / "used", (used, used))
    return folder


def test_versions_are_told_last_used_first(tmp_path, code):
    cache.cache_folder(jit.version_digest())
    a_version(code.parent)
    this, old = versions.versions(code.parent)
    assert this.folder == code and this.files == 1
    assert this.about == f"astray {astray.__version__}, numba {numba.__version__}"
    assert (old.about, old.used, old.files) == ("astray 0.0.1, numba 0.61.0", 0, 6)
    assert old.size == 5 * 3 + len("astray 0.0.1, numba 0.61.0\n")
    assert versions.versions(tmp_path / "none") == []


def test_another_version_is_removed_whole(tmp_path):
    folder = a_version(tmp_path)
    assert versions.remove(folder) and not folder.exists()


@pytest.mark.parametrize("name", ["thesis.tex", "envs_0/notes.nbi.bak", "mine/x.nb", "envs_0/used"])
def test_what_is_not_code_is_not_removed(name, tmp_path):
    folder = a_version(tmp_path)
    (folder / name).parent.mkdir(exist_ok=True)
    (folder / name).write_text("mine")
    assert not versions.remove(folder)
    assert (folder / name).read_text() == "mine" and not (folder / "envs_0").joinpath(
        "1.nbc"
    ).exists()
    assert [p for p in folder.rglob("*") if p.is_file()] == [folder / name]


def test_nothing_is_removed_through_links(tmp_path):
    other = a_version(tmp_path / "other")
    (tmp_path / OLD).symlink_to(other)
    inside = a_version(tmp_path, "2" * 16)
    (inside / "more").symlink_to(other)
    (inside / "envs_0" / "x.nbi").symlink_to(other / "used")
    before = sorted(other.rglob("*"))
    assert not versions.remove(tmp_path / OLD) and not versions.remove(inside)
    assert sorted(other.rglob("*")) == before and (inside / "more").is_symlink()


@pytest.mark.parametrize("digest", ["photos", "1" * 15, "1" * 17, "G" * 16])
def test_a_folder_by_another_name_is_not_ours(digest, tmp_path):
    assert not versions.remove(a_version(tmp_path, digest)) and not versions.versions(tmp_path)


@POSIX
@pytest.mark.parametrize("what", [".", "used"])
def test_another_users_folder_is_not_ours(what, tmp_path, monkeypatch):
    folder = a_version(tmp_path)
    assert versions.is_ours(folder)
    give_away(folder / what, monkeypatch)
    assert not versions.is_ours(folder)


def test_a_folder_without_its_mark_is_not_ours(tmp_path):
    folder = a_version(tmp_path)
    (folder / "used").unlink()
    assert not versions.remove(folder) and len(list(folder.rglob("*.nb*"))) == 3


@pytest.mark.parametrize("lock", ["compile.lock", "compile-maze.lock", "compile-mine_0123.lock"])
def test_a_version_that_a_process_compiles_into_stays(lock, tmp_path):
    folder = a_version(tmp_path)
    with FileLock(folder / lock):
        assert not versions.remove(folder)
    assert len(list(folder.rglob("*.nb*"))) == 3


def digested(folder):
    """The files of three functions, of which one was edited: those before the edit."""
    for day, label in enumerate(("mine_" + "a" * 16, "mine_" + "b" * 16, "yours_" + "a" * 16)):
        for ending in ("nbi", "1.nbc"):
            path = folder / "envs_0" / f"loops.run_{label}-9.py312.{ending}"
            path.write_bytes(b"")
            os.utime(path, (day, day))
    return [f"loops.run_mine_{'a' * 16}-9.py312.{end}" for end in ("1.nbc", "nbi")]


def test_code_of_functions_before_their_edit_is_outdated(tmp_path):
    folder = a_version(tmp_path)
    old = digested(folder)
    assert sorted(path.name for path in versions.outdated(folder)) == old


def test_outdated_code_goes_after_a_month(code):
    cache.cache_folder(code.name)
    (code / "envs_0").mkdir()
    old = digested(code)
    cache.cache_folder(code.name)
    left = {path.name for path in code.rglob("*.nb?")}
    assert len(left) == 4 and not left & set(old)


def test_the_verb_shows_and_prunes(code, monkeypatch, capsys):
    def said(*words):
        monkeypatch.setattr(sys, "argv", ["astray", "cache", *words])
        cli.main()
        return capsys.readouterr().out

    assert json.loads(said("--json"))["versions"] == [] and not code.parent.exists()
    cache.cache_folder(jit.version_digest())
    old = a_version(code.parent, used=time.time() - 3600)
    shown = said()
    assert str(code.parent) in shown and "this one" in shown and "numba 0.61.0" in shown
    size = versions.versions(code.parent)[1].size
    pruned = json.loads(said("--prune", "--json"))
    assert pruned["removed"] == size and not old.exists() and (code / "used").exists()
    assert [one["this"] for one in pruned["versions"]] == [True]
