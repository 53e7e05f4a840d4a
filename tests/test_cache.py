"""Compiled code is taken from where nobody else may write, and only what is whole."""

import os
import shutil
import tempfile
from pathlib import Path

import numba
import pytest
from filelock import FileLock

from astray.kernel import cache, jit
from astray.kernel.stored import Stored

DIGEST = "0" * 16
POSIX = pytest.mark.skipif(not hasattr(os, "getuid"), reason="files have no owners and modes")
COMPILED = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")


@pytest.fixture(autouse=True)
def _alone(tmp_path, monkeypatch):
    """The cache of a test is in `tmp_path`."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(Stored, "writes", True)
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "code"))


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
    chosen = tmp_path / "chosen"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(chosen))
    assert cache.cache_folder(DIGEST) == str(chosen) and chosen.stat().st_mode & 0o777 == 0o700
    chosen.chmod(0o755)  # others may look
    (chosen / "open").mkdir()
    assert cache.cache_folder(DIGEST) == str(chosen)
    (chosen / "open").chmod(0o777)
    with pytest.warns(UserWarning, match="others may write to .*open"):
        assert cache.cache_folder(DIGEST) != str(chosen)


@POSIX
def test_folders_are_made_for_the_user_alone_and_closed_where_they_were_open(tmp_path):
    (tmp_path / "home" / "astray").mkdir(parents=True)
    (tmp_path / "home" / "astray").chmod(0o777)  # as an umask of 0 left it
    before = os.umask(0)
    try:
        folder = Path(cache.cache_folder(DIGEST))
        compiled = jit.entry(twice)
        compiled(1)
    finally:
        os.umask(before)
    inside = [p for p in (tmp_path / "code").rglob("*") if p.is_dir()]
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


@pytest.mark.parametrize("method", ["iterdir", "is_file"])
def test_a_home_that_cannot_be_listed_or_holds_what_cannot_be_seen_is_used(method, monkeypatch):
    def refused(path):
        raise PermissionError(13, "Permission denied", str(path))

    cache.cache_folder("1" * 16)
    monkeypatch.setattr(Path, method, refused)
    assert cache.cache_folder(DIGEST).endswith(DIGEST)


def twice(x):
    return 2 * x


@COMPILED
@pytest.mark.parametrize("ending", ["nbi", "nbc"])
@pytest.mark.parametrize("size", [0, 1, 31, 32, 40, -1])
def test_files_of_compiled_code_cut_short_are_made_anew(ending, size, tmp_path):
    assert jit.entry(twice)(3) == 6
    (path,) = (tmp_path / "code").rglob(f"*.{ending}")
    path.write_bytes(path.read_bytes()[:size])
    anew, again = jit.entry(twice), jit.entry(twice)
    assert anew(3) == 6 and not anew.stats.cache_hits
    assert again(3) == 6 and again.stats.cache_hits


@COMPILED
def test_files_of_compiled_code_with_other_bytes_are_made_anew(tmp_path):
    jit.entry(twice)(3)
    for path in [p for p in (tmp_path / "code").rglob("*.nb?")]:
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
def test_a_folder_that_is_gone_or_never_was_is_none(tmp_path, monkeypatch):
    before = jit.entry(twice)
    shutil.rmtree(tmp_path / "code")
    (tmp_path / "code").write_text("a file, where the folder was")
    with (
        pytest.warns(UserWarning, match="compiled code is not kept") as said,
        jit.one_at_a_time(),
    ):
        assert (before(3), jit.entry(twice)(3)) == (6, 6)
    assert len(said) == 1
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "none"))
    assert cache.passing_folder() == ""
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    with jit.one_at_a_time():
        assert jit.entry(twice)(3) == 6


@COMPILED
def test_who_was_stopped_while_compiling_holds_nobody_up_for_ever(tmp_path, monkeypatch, caplog):
    monkeypatch.setattr(cache, "SILENT", 0.05)
    monkeypatch.setattr(cache, "PATIENT", 0.05)
    (tmp_path / "code").mkdir(mode=0o700)
    with (
        FileLock(tmp_path / "code" / "compile.lock"),
        jit.one_at_a_time(),
    ):
        assert jit.entry(twice)(3) == 6
    assert [
        record.message.split(":")[0] for record in caplog.records if record.name == "astray"
    ] == [
        f"another process compiles, and holds {tmp_path / 'code' / 'compile.lock'}",
        "it still does after 0.1 seconds, or was stopped",
    ]
    assert not list((tmp_path / "code").rglob("*.nbc"))  # two that write break it
