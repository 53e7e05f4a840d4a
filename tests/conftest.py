"""What several tests are given."""

import sys
from pathlib import Path

import pytest

from astray import cli
from helpers.browsed import browser
from helpers.cases import REFERENCE


def pytest_collection_modifyitems(items):
    """What waits most of its time comes first, so that others are done meanwhile."""
    items.sort(key=lambda item: item.get_closest_marker("waits") is None)


@pytest.fixture(scope="session")
def chrome():
    with browser() as found:
        yield found


@pytest.fixture
def reference() -> Path:
    """Recordings of the original program."""
    return REFERENCE


@pytest.fixture
def astray(monkeypatch, capsys):
    """Runs a command; its standard output, or its error if it fails."""

    def run(*words, fails=False):
        monkeypatch.setattr(sys, "argv", ["astray", *map(str, words)])
        if fails:
            with pytest.raises(SystemExit) as exit_:
                cli.main()
            assert exit_.value.code == 2
            return capsys.readouterr().err
        cli.main()
        return capsys.readouterr().out

    return run
