"""Files of other users."""

import os

import pytest

POSIX = pytest.mark.skipif(not hasattr(os, "getuid"), reason="files have no owners and modes")


def give_away(path, monkeypatch):
    """Make `path` another user's; who cannot give it away becomes another user."""
    me = os.getuid()
    if me == 0:
        os.chown(path, 12345, -1)
    else:
        monkeypatch.setattr(os, "getuid", lambda: me + 1)
