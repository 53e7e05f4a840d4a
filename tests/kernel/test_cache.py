"""Compiled code is taken from where nobody else may write, and only what is whole."""

import importlib
import os
import shutil
import tempfile
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numba
import pytest
from filelock import FileLock

from astray import imports
from astray.envs import compiled
from astray.games import find
from astray.kernel import cache, jit
from astray.kernel.stored import _Files
from helpers.owners import POSIX, give_away

pytestmark = pytest.mark.usefixtures("alone")
DIGEST = "0" * 16
COMPILED = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")


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
def test_a_file_that_another_process_renames_while_it_is_looked_at_is_no_danger(
    tmp_path, monkeypatch
):
    folder = prepared(tmp_path / "home" / "astray" / DIGEST)
    begun, looked = folder / "envs" / "loops.1.nbc.tmp.0", Path.lstat
    begun.write_bytes(b"")

    def renamed(path):
        if path == begun and begun.exists():
            begun.rename(folder / "envs" / "loops.1.nbc")
        return looked(path)

    monkeypatch.setattr(Path, "lstat", renamed)
    assert cache.cache_folder(DIGEST) == str(folder.resolve()) and not begun.exists()


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
def test_two_processes_that_write_code_for_other_types_at_once_keep_it_apart(code, monkeypatch):
    late = []
    with monkeypatch.context() as patch:  # both read the index before either writes it
        patch.setattr(_Files, "_load_index", lambda self: {})
        patch.setattr(_Files, "_save_data", lambda *what: late.append(what))
        assert (jit.entry(twice)(3), jit.entry(twice)(3.5)) == (6, 7)
    for what in reversed(late):
        _Files._save_data(*what)
    assert (jit.entry(twice)(3.5), jit.entry(twice)(3)) == (7, 6)


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
    with pytest.warns(UserWarning, match="compiled code is not kept") as said:
        assert (before(3), jit.entry(twice)(3)) == (6, 6)
    assert len(said) == 1
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    jit.code_folder.cache_clear()
    with pytest.warns(UserWarning, match="compiled code is not kept"):
        assert jit.code_folder() == ""
    assert jit.entry(twice)(3) == 6


@COMPILED
def test_who_was_stopped_while_compiling_holds_nobody_up_for_ever(code, monkeypatch, caplog):
    monkeypatch.setattr(cache, "SILENT", 0.05)
    monkeypatch.setattr(cache, "PATIENT", 0.05)
    jit.code_folder()
    with FileLock(code / "compile.lock"):  # of each function by itself
        assert jit.entry(twice)(3) == 6
        assert jit.entry(twice)(3.0) == 6  # who keeps nothing waits for nobody
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

    def compile_both(*names):
        with ThreadPoolExecutor() as threads:
            asked = [(find(n), "own", compiled.loop_of(find(n))) for n in names]
            found = [threads.submit(compiled._compiled.__wrapped__, *one) for one in asked]
        return [one.exception() for one in found]

    assert compile_both("maze", "keys") == [None, None] and sorted(inside) == ["keys", "maze"]
    monkeypatch.setattr(both, "_timeout", 0.1)
    failed = compile_both("maze", "maze")
    assert [type(error.__cause__) for error in failed] == [threading.BrokenBarrierError] * 2


@COMPILED
def test_code_of_sources_that_were_edited_since_they_were_imported_is_kept_as_theirs(
    code, tmp_path, monkeypatch
):
    constants, module = tmp_path / "constants_here.py", tmp_path / "kernels_here.py"
    constants.write_text("ONE = 1\n")
    module.write_text("import constants_here\n\n\ndef one():\n    return constants_here.ONE\n")
    monkeypatch.syspath_prepend(tmp_path)
    found = importlib.import_module("kernels_here")
    before = jit.entry(found.one)
    constants.write_text("ONE = 2  # later\n")
    assert before() == jit.entry(found.one)() == 1
    assert len(list(code.rglob("*.nbc"))) == 1
    importlib.invalidate_caches()
    importlib.reload(importlib.import_module("constants_here"))
    assert jit.entry(found.one)() == 2
    assert len(list(code.rglob("*.nbc"))) == 2


def test_other_settings_of_numba_have_another_folder(monkeypatch):
    before = jit.version_digest()
    monkeypatch.setattr(numba.config, "OPT", type(numba.config.OPT)(1))
    assert jit.version_digest() != before


def test_what_takes_long_is_announced(monkeypatch):
    told = threading.Event()
    monkeypatch.setattr(imports.LOG, "warning", lambda *_: told.set())
    with imports.announced(0.01, "compiling"):
        assert told.wait(30)
    told.clear()
    with imports.announced(30, "compiling"):
        (timer,) = (one for one in threading.enumerate() if isinstance(one, threading.Timer))
    timer.join(10)
    assert not told.is_set() and not timer.is_alive()
