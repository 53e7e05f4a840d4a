"""What is the user's own where the original's pictures are kept stays as it is."""

import hashlib
import os

import pytest

from astray.art import original

PATHS = ("kenney/a.png", "misc_assets/b.png")


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A checkout with two pictures, in the place of all that the original has."""
    pictures = {}
    for path in PATHS:
        file = tmp_path / "checkout" / path
        file.parent.mkdir(parents=True)
        file.write_bytes(path.encode())
        digest = hashlib.sha256(path.encode()).hexdigest()
        pictures[path] = original.Picture(path, len(path), digest)
    monkeypatch.setattr(original, "PICTURES", pictures)
    monkeypatch.setenv("ASTRAY_ART", str(tmp_path / "art"))
    return tmp_path / "checkout"


def drawn(path):
    path.write_bytes(b"mine")


def linked(path):
    (path.parent / "drawing.png").write_bytes(b"mine")
    path.symlink_to("drawing.png")


def dangling(path):
    path.symlink_to("not-there.png")


def folder(path):
    path.mkdir()


@pytest.mark.parametrize("put", [drawn, linked, dangling, folder])
def test_a_picture_of_the_users_is_not_replaced_and_nothing_is_written(put, checkout, tmp_path):
    if os.name == "nt" and put in (linked, dangling):
        pytest.skip("links need a right on Windows")
    own = tmp_path / "art" / PATHS[1]
    own.parent.mkdir(parents=True)
    put(own)
    with pytest.raises(ValueError, match=r"b\.png is not Procgen's picture; where it is gone"):
        original.take(checkout)
    assert not own.is_file() or own.read_bytes() == b"mine"
    assert not (tmp_path / "art" / PATHS[0]).exists()


def test_a_picture_that_is_there_already_stays_there(checkout, tmp_path):
    assert original.take(checkout) == []
    before = (tmp_path / "art" / PATHS[0]).stat().st_mtime_ns
    assert original.take(checkout) == []
    assert (tmp_path / "art" / PATHS[0]).stat().st_mtime_ns == before
