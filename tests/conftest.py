"""What several tests are given."""

import gc
import multiprocessing
import os
import signal
import sys
from pathlib import Path

import pytest

# Fixtures import what they need: the process that hands tests to the others needs none of it.


def pytest_collection(session):
    """Import what pytest would import apart, as the parent of the tests within it."""
    if not session.config.pluginmanager.hasplugin("dsession"):  # which hands tests out
        import astray.games  # noqa: F401


def pytest_configure():
    """Garbage is looked for less often: among a million objects that takes half a second.

    `os.fsync` does nothing: workers would wait for the disk, a quarter of a minute in all.
    A process that was begun in the background ignores Ctrl+C, which ends environments that hang.
    Tests of it would wait for ever.
    """
    gc.set_threshold(100_000)
    os.fsync = lambda _: None
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)


def pytest_collection_modifyitems(items):
    """What waits most of its time comes first, so that others are done meanwhile."""
    items.sort(key=lambda item: item.get_closest_marker("waits") is None)


def pytest_collection_finish():
    """Leave what is there by now out of looks for garbage, which take half a second less."""
    gc.freeze()


@pytest.fixture(autouse=True)
def _threads_and_processes_as_before():
    """Leaves torch the threads that it had: with a second one, what follows takes ten times longer.

    Each waits for the other, and keeps a core busy. Processes begin as they did, which torchrl
    changes where it is imported: each of an environment's then took three seconds, not a tenth.
    """
    torch = sys.modules.get("torch")
    before = torch.get_num_threads() if torch else None
    begins = multiprocessing.get_start_method(allow_none=True)
    yield
    if multiprocessing.get_start_method(allow_none=True) != begins:
        multiprocessing.set_start_method(begins, force=True)
    if torch and torch.get_num_threads() != before:
        torch.set_num_threads(before)


@pytest.fixture(scope="session")
def chrome():
    from helpers.browsed import browser

    with browser() as found:
        yield found


@pytest.fixture
def undrawn(monkeypatch):
    """Figures and videos are files of some bytes; to draw them takes as long as all before them."""
    from matplotlib.figure import Figure

    from astray.analysis import video
    from astray.experiments import videos
    from astray.files import write_aside

    monkeypatch.setattr(Figure, "savefig", lambda _, file, **how: file.write(b"<svg></svg>"))
    monkeypatch.setattr(video, "write", lambda _, path, fps: write_aside(path, b"a video"))
    monkeypatch.setattr(videos, "RECORDED", 5)


@pytest.fixture
def reference() -> Path:
    """Recordings of the original program."""
    from helpers.cases import REFERENCE

    return REFERENCE


@pytest.fixture
def coarse(monkeypatch):
    """Figures have few pixels, which takes half the time."""
    style = pytest.importorskip("astray.figures.style")
    monkeypatch.setitem(style.STYLE, "savefig.dpi", 40)


@pytest.fixture
def full_disk():
    """No file can grow beyond some bytes, as on a full disk."""
    resource = pytest.importorskip("resource")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)

    def fill(size=resource.RLIM_INFINITY):
        resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))

    yield fill
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


@pytest.fixture
def astray(monkeypatch, capsys):
    """Runs a command; its standard output, or its error if it fails."""
    from astray import cli

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
