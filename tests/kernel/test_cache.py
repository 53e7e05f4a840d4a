"""Compiled code is taken from where nobody else may write, and only what is whole."""

import importlib
import json
import os
import shutil
import sys
import tempfile
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import pytest
from filelock import FileLock

import astray
from astray import cli
from astray.envs import compiled
from astray.games import find
from astray.kernel import cache, jit, versions
from astray.kernel.stored import Stored

DIGEST = "0" * 16
POSIX = pytest.mark.skipif(not hasattr(os, "getuid"), reason="files have no owners and modes")
COMPILED = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")


@pytest.fixture(autouse=True)
def _alone(tmp_path, monkeypatch):
    """The cache of a test is in `tmp_path`, and chosen anew."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(Stored, "writes", True)
    jit.code_folder.cache_clear()
    yield
    jit.code_folder.cache_clear()


@pytest.fixture
def code(tmp_path):
    """Where the compiled code of this process is."""
    return tmp_path / "home" / "astray" / jit.version_digest()


def give_away(path, monkeypatch):
    """Make `path` another user's; who cannot give it away becomes another user."""
    me = os.getuid()
    if me == 0:
        os.chown(path, 12345, -1)
    else:
        monkeypatch.setattr(os, "getuid", lambda: me + 1)


def prepared(folder):
    """A folder as this user's cache left it."""
    assert cache.cache_folder(DIGEST) == str(folder.resolve())
    (folder / "envs").mkdir(mode=0o700)
    (folder / "envs" / "loops.1.nbc").write_bytes(b"")
    return folder


@POSIX
@pytest.mark.parametrize("what", [".", "..", "../..", "envs", "envs/loops.1.nbc", "used"])
def test_what_is_another_users_is_not_used(what, tmp_path, monkeypatch):
    folder = prepared(tmp_path / "home" / "astray" / DIGEST)
    give_away(folder / what, monkeypatch)
    with pytest.warns(UserWarning, match="compiled code is not kept: .* is of another user"):
        other = cache.cache_folder(DIGEST)
    assert tmp_path not in Path(other).parents and os.listdir(other) == []


@POSIX
@pytest.mark.parametrize("mode", [0o777, 0o770, 0o702])
@pytest.mark.parametrize("what", [".", "../.."])
def test_where_others_may_write_is_not_used(what, mode, tmp_path):
    folder = prepared(tmp_path / "home" / "astray" / DIGEST)
    (folder / what).resolve().chmod(mode)
    with pytest.warns(UserWarning, match=r"others may write to .*; chmod go-w mends it"):
        other = cache.cache_folder(DIGEST)
    assert tmp_path not in Path(other).parents


@POSIX
def test_a_folder_that_was_chosen_is_no_safer(tmp_path, monkeypatch):
    folder = tmp_path / "chosen" / "astray" / DIGEST
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "chosen"))
    assert cache.cache_folder(DIGEST) == str(folder) and folder.stat().st_mode & 0o777 == 0o700
    folder.chmod(0o755)  # others may look
    (folder / "open").mkdir()
    assert cache.cache_folder(DIGEST) == str(folder)
    (folder / "open").chmod(0o777)
    with pytest.warns(UserWarning, match="others may write to .*open"):
        assert cache.cache_folder(DIGEST) != str(folder)


@POSIX
def test_folders_are_made_for_the_user_alone_and_closed_where_they_were_open(tmp_path, code):
    (tmp_path / "home" / "astray").mkdir(parents=True)
    (tmp_path / "home" / "astray").chmod(0o777)  # as an umask of 0 left it
    before = os.umask(0)
    try:
        folder = Path(cache.cache_folder(DIGEST))
        compiled = jit.entry(twice)
        compiled(1)
    finally:
        os.umask(before)
    inside = [p for p in code.rglob("*") if p.is_dir()]
    assert inside or numba.config.DISABLE_JIT
    for path in (folder, folder.parent, *inside):
        assert path.stat().st_mode & 0o777 == 0o700


def test_a_cache_is_not_taken_from_where_python_was_started(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_CACHE_HOME", "cache")
    monkeypatch.setattr(Path, "home", lambda: tmp_path / "user")
    assert cache.cache_folder(DIGEST) == str(tmp_path / "user" / ".cache" / "astray" / DIGEST)


def no_home():
    raise RuntimeError("Could not determine home directory.")


def test_without_a_home_a_folder_of_the_process_is_used(tmp_path, monkeypatch):
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setattr(Path, "home", no_home)
    with pytest.warns(UserWarning, match="not kept: Could not determine home directory"):
        assert Path(cache.cache_folder(DIGEST)).is_dir()


@pytest.mark.parametrize("method, what", [("iterdir", "."), ("lstat", "1" * 16)])
def test_a_home_that_cannot_be_listed_or_holds_what_cannot_be_seen_is_used(
    method, what, tmp_path, monkeypatch
):
    there, allowed = tmp_path / "home" / "astray" / what, getattr(Path, method)

    def refused(path):
        if path == there:
            raise PermissionError(13, "Permission denied", str(path))
        return allowed(path)

    cache.cache_folder("1" * 16)
    monkeypatch.setattr(Path, method, refused)
    assert cache.cache_folder(DIGEST).endswith(DIGEST)


def twice(x):
    return 2 * x


@COMPILED
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("size", [0, 1, 31, 32, 40, -1])
def test_files_of_compiled_code_cut_short_are_made_anew(ending, size, code):
    assert jit.entry(twice)(3) == 6
    (path,) = code.rglob(f"*.{ending}")
    path.write_bytes(path.read_bytes()[:size])
    anew, again = jit.entry(twice), jit.entry(twice)
    assert anew(3) == 6 and not anew.stats.cache_hits
    assert again(3) == 6 and again.stats.cache_hits


@COMPILED
def test_files_of_compiled_code_with_other_bytes_are_made_anew(code):
    jit.entry(twice)(3)
    for path in [p for p in code.rglob("*.nb?")]:
        data = bytearray(path.read_bytes())
        data[len(data) // 2] ^= 1
        path.write_bytes(data)
        anew = jit.entry(twice)
        assert anew(3) == 6 and not anew.stats.cache_hits


@COMPILED
@pytest.mark.parametrize("error", [28, 30])  # no space left; a file system that is read-only
def test_code_that_cannot_be_written_is_compiled_all_the_same(error, monkeypatch):
    def refused(*_):
        raise OSError(error, os.strerror(error))

    monkeypatch.setattr(os, "replace", refused)
    with pytest.warns(UserWarning, match="compiled code is not kept"):
        assert jit.entry(twice)(3) == 6
    assert jit.entry(twice)(3.0) == 6  # and says so once


@COMPILED
def test_a_folder_that_is_gone_or_never_was_is_none(tmp_path, code, monkeypatch):
    before = jit.entry(twice)
    assert jit.code_folder() == str(code)
    shutil.rmtree(code)
    code.write_text("a file, where the folder was")
    with pytest.warns(UserWarning, match="compiled code is not kept") as said, jit.one_at_a_time():
        assert (before(3), jit.entry(twice)(3)) == (6, 6)
    assert len(said) == 1
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    jit.code_folder.cache_clear()
    with pytest.warns(UserWarning, match="compiled code is not kept"):
        assert jit.code_folder() == ""
    with jit.one_at_a_time():
        assert jit.entry(twice)(3) == 6


@COMPILED
def test_who_was_stopped_while_compiling_holds_nobody_up_for_ever(code, monkeypatch, caplog):
    monkeypatch.setattr(cache, "SILENT", 0.05)
    monkeypatch.setattr(cache, "PATIENT", 0.05)
    jit.code_folder()
    with FileLock(code / "compile.lock"), jit.one_at_a_time():
        assert jit.entry(twice)(3) == 6
    assert [
        record.message.split(":")[0] for record in caplog.records if record.name == "astray"
    ] == [
        f"another process compiles, and holds {code / 'compile.lock'}",
        "it still does after 0.1 seconds, or was stopped",
    ]
    assert not list(code.rglob("*.nbc"))  # two that write break it


@COMPILED
def test_games_compile_at_once_and_one_game_once(monkeypatch):
    monkeypatch.setattr(cache, "SILENT", 5)
    both, inside = threading.Barrier(2, timeout=3), []

    def compiling(game, looks, run):
        inside.append(game.name)
        both.wait()

    monkeypatch.setattr(compiled, "_compile", compiling)
    monkeypatch.setattr(compiled, "_compile_shared", lambda: None)

    def compile_both(*names):
        with ThreadPoolExecutor() as threads:
            found = [threads.submit(compiled._compiled.__wrapped__, find(n), "own") for n in names]
        return [one.exception() for one in found]

    assert compile_both("maze", "keys") == [None, None] and sorted(inside) == ["keys", "maze"]
    monkeypatch.setattr(both, "_timeout", 0.1)
    failed = compile_both("maze", "maze")
    assert [type(error) for error in failed] == [threading.BrokenBarrierError] * 2


@COMPILED
def test_code_of_sources_that_were_edited_since_they_were_imported_is_not_kept(
    code, tmp_path, monkeypatch
):
    constants, module = tmp_path / "constants_here.py", tmp_path / "kernels_here.py"
    constants.write_text("ONE = 1\n")
    module.write_text("import constants_here\n\n\ndef one():\n    return constants_here.ONE\n")
    monkeypatch.syspath_prepend(tmp_path)
    one = importlib.import_module("kernels_here").one
    before = jit.entry(one)
    constants.write_text("ONE = 2\n")
    with pytest.warns(UserWarning, match="compiled code of one is not kept: a source of it was"):
        assert before() == 1
    assert not list(code.rglob("*.nbc"))


def test_other_settings_of_numba_have_another_folder(monkeypatch):
    before = jit.version_digest()
    monkeypatch.setattr(numba.config, "OPT", type(numba.config.OPT)(1))
    assert jit.version_digest() != before


# What is there, and what can go

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


def test_compiling_that_takes_long_is_announced(monkeypatch):
    told, game = threading.Event(), find("maze")
    monkeypatch.setattr(compiled.LOG, "warning", lambda *_: told.set())
    monkeypatch.setattr(compiled, "SILENT", 0.01)
    with compiled._announced(game):
        assert told.wait(30)
    told.clear()
    monkeypatch.setattr(compiled, "SILENT", 30)
    with compiled._announced(game):
        (timer,) = (one for one in threading.enumerate() if isinstance(one, threading.Timer))
    timer.join(10)
    assert not told.is_set() and not timer.is_alive()
