"""The original's pictures are taken from a wheel or a checkout, and nothing else is."""

import contextlib
import hashlib
import io
import os
import struct
import sys
import threading
import zipfile

import numpy as np
import pytest
from PIL import Image

from astray import files
from astray.art import original
from astray.cli import main


@pytest.fixture
def pack(tmp_path, monkeypatch):
    """A pack of three small pictures in place of the original's; where it would be kept."""
    files = {}
    for k, path in enumerate(("kenney/a.png", "misc_assets/b.png", original.FORK_ALONE[0])):
        rgba = np.random.default_rng(k).integers(0, 256, (4 + k, 5, 4)).astype(np.uint8)
        Image.fromarray(rgba).save(tmp_path / "one.png")
        files[path] = (tmp_path / "one.png").read_bytes()
    pictures = {
        path: original.Picture(path, len(data), hashlib.sha256(data).hexdigest())
        for path, data in files.items()
    }
    monkeypatch.setattr(original, "PICTURES", pictures)
    monkeypatch.setenv("ASTRAY_ART", str(tmp_path / "art"))
    return files


def wheel_of(path, files, prefix=original.INSIDE):
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in files.items():
            archive.writestr(prefix + name, data)
    return path


def test_a_wheel_and_a_checkout_are_imported(pack, tmp_path):
    lines = {original.FORK_ALONE[0]}
    wheel = wheel_of(tmp_path / "a.whl", {p: d for p, d in pack.items() if p not in lines})
    assert original.take(wheel) == [*lines] == original.missing()
    for path, data in pack.items():
        file = tmp_path / "fork" / original.INSIDE / path
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_bytes(data)
    assert original.take(tmp_path / "fork") == []
    assert original.take(wheel) == []  # and what only the fork has stays
    assert original.take(tmp_path / "fork" / original.INSIDE) == []


def bomb(pack, path):
    """A picture that unpacks to a hundred times as much as it may."""
    return wheel_of(path, pack | {"kenney/a.png": b"\0" * 20_000_000})


def with_a_member(method):
    """A wheel with all pictures and a file more, of one byte repeated, compressed by `method`."""

    def make(pack, path):
        with zipfile.ZipFile(wheel_of(path, pack), "a", method) as archive:
            archive.writestr("procgen/more.txt", b"\0" * 1_000_000)
        return path

    return make


def by(method):
    """A wheel with all pictures compressed by `method`."""

    def make(pack, path):
        with zipfile.ZipFile(path, "w", method) as archive:
            for name, data in pack.items():
                archive.writestr(original.INSIDE + name, data)
        return path

    return make


def encrypted(pack, path):
    """A wheel whose members say that they are encrypted."""
    data = bytearray(wheel_of(path, pack).read_bytes())
    for sign, flags in ((b"PK\3\4", 6), (b"PK\1\2", 8)):
        at = -1
        while (at := data.find(sign, at + 1)) >= 0:
            data[at + flags] |= 1
    path.write_bytes(data)
    return path


def cut(pack, path):
    data = wheel_of(path, pack).read_bytes()
    path.write_bytes(data[: len(data) // 2])
    return path


def spoilt(pack, path):
    """The first picture's compressed bytes are changed."""
    data = bytearray(wheel_of(path, pack).read_bytes())
    data[100:140] = bytes(40)
    path.write_bytes(data)
    return path


def misplaced(at, value):
    """A wheel whose last record has a number of 32 bits `at` a byte from its beginning."""

    def make(pack, path):
        data = bytearray(wheel_of(path, pack).read_bytes())
        struct.pack_into("<L", data, data.rfind(b"PK\5\6") + at, value)
        path.write_bytes(data)
        return path

    return make


def unnamed(pack, path):
    """A wheel with a name that is no text."""
    data = wheel_of(path, pack | {"\u00e9.png": b"1"}).read_bytes()
    path.write_bytes(data.replace("\u00e9".encode(), b"\xff\xff"))
    return path


def plain(text, path):
    path.write_text(text)
    return path


@pytest.mark.parametrize(
    "make, said",
    [
        (bomb, "its kenney/a.png is another picture"),
        (by(zipfile.ZIP_BZIP2), "its '.*/a.png' is compressed by method 12; files must"),
        (by(zipfile.ZIP_LZMA), "its '.*/a.png' is compressed by method 14; files must"),
        (with_a_member(zipfile.ZIP_LZMA), "its 'procgen/more.txt' is compressed by"),
        (encrypted, "its '.*/a.png' is encrypted"),
        (cut, "is no wheel that can be read"),
        (spoilt, "is no wheel that can be read|is another picture"),
        (misplaced(16, 2**31), "whl is no wheel that can be read"),
        (unnamed, "whl is no wheel that can be read"),
        (lambda pack, path: plain("", path), "is no wheel that can be read"),
        (lambda pack, path: plain("wheel", path), "is no wheel that can be read"),
        (lambda pack, path: wheel_of(path, {}), "it lacks kenney/a.png"),
        (lambda pack, path: wheel_of(path, pack, "procgen/"), "it lacks kenney/a.png"),
        (lambda pack, path: wheel_of(path, pack | {"misc_assets/b.png": b"1"}), "b.png is another"),
        (lambda pack, path: wheel_of(path, pack | {"../../x.png": b"1"}), "is refused: it holds"),
        (lambda pack, path: wheel_of(path, {"/etc/x": b"1"}, ""), "is refused: it holds '/etc/x'"),
        (lambda pack, path: path.parent, "is not a checkout of Procgen"),
    ],
)  # fmt: skip
def test_what_is_not_the_original_is_refused_and_nothing_written(pack, tmp_path, make, said):
    (tmp_path / "in").mkdir()
    with pytest.raises(ValueError, match=said):
        original.take(make(pack, tmp_path / "in" / "a.whl"))
    assert not (tmp_path / "art").exists() and len(original.missing()) == 3


def test_a_wheel_that_is_not_there_and_pip_that_cannot_say_so(pack, tmp_path, monkeypatch):
    with pytest.raises(FileNotFoundError, match="no wheel and no checkout of Procgen at"):
        original.take(tmp_path / "a.whl")
    monkeypatch.setattr(original, "DOWNLOAD", ("download", "--no-index", "procgen==0.10.7"))
    with pytest.raises(
        OSError, match=f"pip could not download Procgen .*; download {original.WHEEL}"
    ):
        original.take()


def test_a_wheel_larger_than_any_of_procgens_is_not_opened(pack, tmp_path, monkeypatch):
    wheel = wheel_of(tmp_path / "a.whl", pack)
    monkeypatch.setattr(original, "LARGEST_WHEEL", wheel.stat().st_size - 1)
    with pytest.raises(ValueError, match=r"must be of at most .* bytes; it has"):
        original.take(wheel)


def test_a_wheel_of_many_more_files_than_procgens_is_not_opened(pack, tmp_path, monkeypatch):
    monkeypatch.setattr(files, "MEMBERS", 2)
    with pytest.raises(ValueError, match="it has 3 files; at most 2 are read"):
        original.take(wheel_of(tmp_path / "a.whl", pack))


def test_a_file_of_twice_procgens_size_is_not_opened(pack, tmp_path):
    """It may hold a million names, which takes minutes and gigabytes to read."""
    with open(tmp_path / "a.whl", "wb") as file:
        file.truncate(70_000_000)
    with pytest.raises(ValueError, match=r"must be of at most .* bytes; it has 70,?000,?000"):
        original.take(tmp_path / "a.whl")


def test_two_imports_at_once_both_succeed(pack, tmp_path, monkeypatch):
    wheel, write, found = wheel_of(tmp_path / "a.whl", pack), original.write_aside, []
    both = threading.Barrier(2)  # each has looked before the other writes, if nobody waits

    def slowly(path, data):
        with contextlib.suppress(threading.BrokenBarrierError):
            both.wait(0.2)
        write(path, data)

    def take():
        try:
            found.append(original.take(wheel))
        except ValueError as error:
            found.append(error)

    monkeypatch.setattr(original, "write_aside", slowly)
    threads = [threading.Thread(target=take) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [[], []] and not original.missing()


def test_pictures_are_premultiplied_and_backgrounds_opaque(pack, tmp_path):
    original.take(wheel_of(tmp_path / "a.whl", pack))
    names = list(pack)
    pixels, places = original.atlas(names, backgrounds=1)
    for k, name in enumerate(names):
        begin, height, width = places[k]
        (tmp_path / "one.png").write_bytes(pack[name])
        rgba = np.array(Image.open(tmp_path / "one.png")).astype(int)
        ours = pixels[begin : begin + height * width].reshape(height, width).astype(np.int64)
        ours = ours[..., None] >> np.array([0, 8, 16, 24]) & 255
        alpha = np.full_like(rgba[..., 3:], 255) if k == 0 else rgba[..., 3:]
        assert np.array_equal(ours[..., 3:], alpha)
        assert np.abs(ours[..., :3] - rgba[..., :3] * alpha / 255).max() <= 0.5 + 1e-9


def test_a_file_larger_than_memory_in_place_of_a_picture_is_not_read(pack, tmp_path):
    wheel = wheel_of(tmp_path / "a.whl", pack)
    original.take(wheel)
    os.truncate(tmp_path / "art/kenney/a.png", 2**40)  # without blocks on the disk
    with pytest.raises(ValueError, match=r"a.png is not Procgen's picture"):
        original.take(wheel)
    with pytest.raises(ValueError, match="is not what was imported; remove it, and: astray art"):
        original.atlas(list(pack))


def test_what_was_decoded_is_kept_and_made_anew_where_it_is_broken(pack, tmp_path):
    original.take(wheel_of(tmp_path / "a.whl", pack))
    pixels, _ = original.atlas(list(pack))
    (kept,) = (tmp_path / "art").glob("decoded-*.npy")
    for broken in (b"", kept.read_bytes()[:150], b"x" * 500):
        whole = pixels.copy()
        del pixels
        kept.unlink()
        kept.write_bytes(broken)
        pixels, _ = original.atlas(list(pack))
        assert np.array_equal(pixels, whole)
    kept.unlink()
    (tmp_path / "art/kenney/a.png").write_bytes(b"other")
    with pytest.raises(ValueError, match="is not what was imported; remove it, and: astray art"):
        original.atlas(list(pack))


def test_a_decoded_picture_that_was_changed_is_not_shown(pack, tmp_path):
    original.take(wheel_of(tmp_path / "a.whl", pack))
    pixels, _ = original.atlas(list(pack))
    whole = pixels.copy()
    del pixels
    (kept,) = (tmp_path / "art").glob("decoded-*.npy")
    changed = bytearray(kept.read_bytes())
    changed[-original.SUM - 4] ^= 1  # of the last pixel; the size stays
    kept.write_bytes(changed)
    assert np.array_equal(original.atlas(list(pack))[0], whole)


def test_sizes_of_decoded_pictures_are_seen_whoever_signed_them(pack, tmp_path):
    original.take(wheel_of(tmp_path / "a.whl", pack))
    pixels, _ = original.atlas(list(pack))
    whole = pixels.copy()
    del pixels
    (kept,) = (tmp_path / "art").glob("decoded-*.npy")
    sizes = np.zeros(2 * len(pack), np.uint32)
    data = io.BytesIO()
    np.save(data, sizes)
    kept.write_bytes(data.getvalue() + hashlib.sha256(data.getvalue()).digest())
    assert np.array_equal(original.atlas(list(pack))[0], whole)


def test_without_the_pictures_one_sentence_says_how_to_get_them(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("ASTRAY_ART", str(tmp_path / "none"))
    with pytest.raises(FileNotFoundError, match="to get them: astray art import"):
        original.atlas(list(original.PICTURES)[:3])
    monkeypatch.setattr(sys, "argv", ["astray", "art"])
    main()
    said = capsys.readouterr().out
    assert "0 of 140" in said and "astray art import" in said and not (tmp_path / "none").exists()
