"""The folder of compiled code in tests of its cache."""

import pytest

from astray.kernel import jit
from astray.kernel.stored import Stored


@pytest.fixture
def alone(tmp_path, monkeypatch):
    """The cache of a test is in `tmp_path`, and chosen anew."""
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    monkeypatch.setattr(Stored, "writes", True)
    jit.code_folder.cache_clear()
    yield
    jit.code_folder.cache_clear()


@pytest.fixture
def code(tmp_path):
    """The folder of this process's compiled code."""
    return tmp_path / "home" / "astray" / jit.version_digest()
