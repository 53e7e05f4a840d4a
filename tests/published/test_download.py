"""Downloads are whole and the right file, or not there; an interrupted one goes on."""

import contextlib
import errno
import hashlib
import io
import itertools
import queue
import socket
import subprocess
import sys
import threading
import urllib.request
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from unittest.mock import Mock

import numpy as np
import pytest

from astray.files import LOCK, aside_of
from astray.published import catalogue
from astray.published import download as downloads
from astray.published.download import download
from astray.published.imported import Known
from helpers.file_server import serving
from helpers.processes import environment

DATA = np.random.default_rng(0).bytes(50_000)


@pytest.fixture
def serve():
    with serving() as start:
        yield start


def digest(data):
    return hashlib.sha256(data).hexdigest()


HELLO = b"hello\n"  # whose blob id `git hash-object` gives
BLOB = "ce013625030ba8dba906f756967f9e9ca394464a"


def test_a_file_can_be_pinned_by_the_id_that_git_gives_it(serve, tmp_path):
    download(serve(HELLO).address, tmp_path / "a", size=None, digest=BLOB)
    assert (tmp_path / "a").read_bytes() == HELLO
    with pytest.raises(ValueError, match=f"its git blob id is [0-9a-f]{{40}}, not {BLOB}"):
        download(serve(HELLO + b"!").address, tmp_path / "b", size=None, digest=BLOB)
    assert not (tmp_path / "b").exists()


def test_what_a_killed_download_left_beside_its_place_is_removed(serve, tmp_path):
    """It is as large as the file, and each kill could leave one more."""
    aside_of(tmp_path / "a").write_bytes(HELLO)
    aside_of(tmp_path / "other").write_bytes(HELLO)
    download(serve(HELLO).address, tmp_path / "a", size=None, digest=BLOB)
    assert len(left(tmp_path)) == 2 and (tmp_path / "a").exists()


def test_what_was_whole_when_it_was_stopped_is_taken_and_what_is_more_is_removed(serve, tmp_path):
    address, part = serve(HELLO).address, tmp_path / "a.part"
    part.write_bytes(HELLO)
    download(address, tmp_path / "a", size=None, digest=BLOB)
    assert left(tmp_path) == ["a"]
    part.write_bytes(HELLO + b"more")
    (tmp_path / "a").unlink()
    with pytest.raises(ValueError, match="is not the file that was published"):
        download(address, tmp_path / "a", size=None, digest=BLOB)
    assert not left(tmp_path)


def left(folder):
    """The names of the files in a folder, without that of its lock."""
    return [path.name for path in folder.iterdir() if path.name != LOCK]


def downloads_at_once(server, to, count):
    """What so many processes at once said that download one file, and how they ended."""
    code = (
        "import pathlib; from astray.published.download import download\n"
        f"download({server.address!r}, pathlib.Path({str(to)!r}), "
        f"size={len(DATA)}, digest={digest(DATA)!r})"
    )
    begun = [
        subprocess.Popen([sys.executable, "-c", code], env=environment(), stderr=subprocess.PIPE)
        for _ in range(count)
    ]
    return [(one.communicate()[1].decode(), one.returncode) for one in begun]


def test_downloads_of_one_file_at_once_all_succeed(serve, tmp_path):
    server, to = serve(DATA, pause=0.1), tmp_path / "agent.jd"
    said = downloads_at_once(server, to, 2)
    assert [code for _, code in said] == [0, 0], said
    assert to.read_bytes() == DATA and left(tmp_path) == ["agent.jd"]
    assert server.asked == [None]  # the other found it there, and saw that it is the one


def test_what_is_checked_is_put_in_place_whatever_is_written_meanwhile(
    serve, tmp_path, monkeypatch
):
    to, put = tmp_path / "agent.jd", downloads.write_aside
    monkeypatch.setattr(
        downloads,
        "write_aside",
        lambda *given: ((tmp_path / "agent.jd.part").write_bytes(b"more"), put(*given)),
    )
    download(serve(DATA).address, to, size=len(DATA), digest=digest(DATA))
    assert to.read_bytes() == DATA


class Full(io.FileIO):
    def write(self, data):
        super().write(data[:9])
        raise OSError(errno.ENOSPC, "No space left on device")


@pytest.mark.parametrize("full", [Full, Mock(side_effect=OSError(errno.ENOSPC, "no inode"))])
def test_a_download_that_the_disk_has_no_room_for_leaves_nothing(
    full, serve, tmp_path, monkeypatch
):
    monkeypatch.setattr(downloads, "open", full, raising=False)
    to = tmp_path / "agents" / "agent.jd"
    with pytest.raises(
        OSError, match=r"No space left on device; nothing was written: .*agent\.jd'"
    ):
        download(serve(DATA).address, to, size=len(DATA), digest=digest(DATA))
    assert not to.parent.exists()


def test_a_table_that_was_changed_is_not_read(tmp_path, monkeypatch):
    monkeypatch.setenv("ASTRAY_AGENTS", str(tmp_path))
    one = catalogue.Published("a-table", Known(), sha256=digest(b"seed\n"), kind="results")
    monkeypatch.setattr(catalogue, "find", lambda _: one)
    path = tmp_path / catalogue.RESULTS / "a-table.csv"
    path.parent.mkdir()
    path.write_bytes(b"seed\n")
    assert catalogue.results_file("a-table") == path
    path.write_bytes(b"seeds\n")
    with pytest.raises(ValueError, match=r"is not the table that was published: .* bring it again"):
        catalogue.results_file("a-table")


def test_an_agent_fetched_twice_at_once_is_there_once(serve, tmp_path, monkeypatch):
    monkeypatch.setenv("ASTRAY_AGENTS", str(tmp_path))
    server, said = serve(DATA, pause=0.02), []
    one = catalogue.Published(
        "an-agent", Known(), "agent.jd", server.address, size=len(DATA), sha256=digest(DATA)
    )

    def imported(file, name, known, expected):
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.json").write_text("{}")
        return tmp_path / name

    def fetch():
        try:
            said.append(catalogue.fetch(one))
        except (ValueError, OSError) as error:
            said.append(str(error))

    monkeypatch.setattr(catalogue, "import_agent", imported)
    threads = [threading.Thread(target=fetch) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    there = tmp_path / "an-agent"
    assert said == [there, f"there is an agent 'an-agent' already, in {there}"]


@pytest.mark.parametrize("ranges", [True, False], ids=["with ranges", "without"])
def test_an_interrupted_download_goes_on_where_it_stopped(serve, tmp_path, ranges):
    server, to = serve(DATA, stops=1000, ranges=ranges), tmp_path / "agent.jd"
    known = dict(size=len(DATA), digest=digest(DATA))
    with pytest.raises(OSError, match=r"1,000 of [\d,]+ bytes are there, and the same command"):
        download(server.address, to, **known)
    assert not to.exists() and (tmp_path / "agent.jd.part").stat().st_size == 1000
    server.stops = 0
    download(server.address, to, **known)
    assert to.read_bytes() == DATA and not (tmp_path / "agent.jd.part").exists()
    assert server.asked == [None, "bytes=1000-"]


@pytest.mark.parametrize("link", [False, True])
def test_a_download_replaces_nothing(serve, tmp_path, link):
    to, mine = tmp_path / "agent.jd", tmp_path / "mine"
    mine.write_text("mine")
    to.symlink_to(mine) if link else to.write_text("mine")
    with pytest.raises(OSError, match="is there already, and stays"):
        download(serve(DATA).address, to, size=None, digest=None)
    assert to.read_text() == mine.read_text() == "mine" and to.is_symlink() == link


def test_what_is_left_of_another_file_is_found_out(serve, tmp_path):
    part = tmp_path / "agent.jd.part"
    part.write_bytes(bytes(1000))
    server, known = serve(DATA), dict(size=len(DATA), digest=digest(DATA))
    with pytest.raises(ValueError, match="it was removed"):
        download(server.address, tmp_path / "agent.jd", **known)
    download(server.address, tmp_path / "agent.jd", **known)
    assert (tmp_path / "agent.jd").read_bytes() == DATA


def test_a_server_that_sends_a_byte_now_and_then_is_not_waited_for(serve, tmp_path, monkeypatch):
    clock = itertools.count(0, 2 * downloads.WAIT)  # so long takes every piece
    monkeypatch.setattr(downloads.time, "monotonic", lambda: next(clock))
    server, known = serve(bytes(500)), dict(size=1000, digest="00" * 32)
    with pytest.raises(OSError, match=r"fewer than 10,000 bytes came in 30 .*; 500 of"):
        download(server.address, tmp_path / "a", **known)
    assert left(tmp_path) == ["a.part"]


def test_a_server_that_never_comes_to_its_answer_is_not_waited_for(tmp_path, monkeypatch):
    monkeypatch.setattr(downloads, "WAIT", 0.5)
    made, asking = urllib.request.build_opener, queue.SimpleQueue()

    def noted(*given):
        asking.put(threading.current_thread())
        return made(*given)

    class Undecided(BaseHTTPRequestHandler):
        def do_GET(self):
            with contextlib.suppress(OSError):
                for _ in range(10**7):
                    self.wfile.write(b"HTTP/1.1 100 Continue\r\n\r\n")

    monkeypatch.setattr(urllib.request, "build_opener", noted)
    with ThreadingHTTPServer(("127.0.0.1", 0), Undecided) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/a"
        with pytest.raises(OSError, match=r"no answer came in 0\.5 seconds"):
            download(address, tmp_path / "a", size=1000, digest="00" * 32)
        (thread := asking.get(timeout=10)).join(10)
        assert not thread.is_alive()  # nobody listens any more
        server.shutdown()
    assert not left(tmp_path)


@pytest.mark.parametrize("place", [(urllib.request, "build_opener"), (socket, "create_connection")])
def test_a_request_that_was_given_up_before_it_was_made_is_not_made(
    serve, tmp_path, monkeypatch, place
):
    monkeypatch.setattr(downloads, "WAIT", 0.1)
    made, given_up, asking = getattr(*place), threading.Event(), queue.SimpleQueue()

    def late(*given):
        asking.put(threading.current_thread())
        given_up.wait(10)
        return made(*given)

    monkeypatch.setattr(*place, late)
    server = serve(DATA)
    with pytest.raises(OSError, match=r"no answer came in 0\.1 seconds"):
        download(server.address, tmp_path / "a", size=len(DATA), digest=digest(DATA))
    given_up.set()
    (thread := asking.get(timeout=10)).join(10)
    assert not thread.is_alive() and server.asked == []


def test_a_file_without_a_digest_is_not_shorter_than_it_is_to_be(serve, tmp_path):
    with pytest.raises(OSError, match="ended after 6 of 7 bytes"):
        download(serve(HELLO).address, tmp_path / "a", size=7, digest=None)
    assert not (tmp_path / "a").exists()


def test_no_more_is_taken_than_was_published(serve, tmp_path):
    server = serve(bytes(3_000_000))
    with pytest.raises(ValueError, match="is not the file that was published"):
        download(server.address, tmp_path / "a", size=1000, digest="00" * 32)
    assert not left(tmp_path)


@pytest.mark.parametrize(
    "address", ["http://example.org/a.jd", "ftp://example.org/a.jd", "file:///etc/passwd"]
)
def test_addresses_that_others_can_tamper_with_are_refused(tmp_path, address):
    with pytest.raises(ValueError, match=f"must be https; got {address}"):
        download(address, tmp_path / "a", size=None, digest=None)


@pytest.mark.parametrize("to", ["http://[::1/x", "https://a..b/", "http://127.0.0.1:99999/"])
def test_a_server_that_sends_on_to_no_address_is_named(tmp_path, to):
    class Moved(BaseHTTPRequestHandler):
        def do_GET(self):
            self.send_response(302)
            self.send_header("Location", to)
            self.end_headers()

    with ThreadingHTTPServer(("127.0.0.1", 0), Moved) as server:
        threading.Thread(target=server.handle_request, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/agent.jd"
        with pytest.raises(OSError, match=f"{address} could not be downloaded"):
            download(address, tmp_path / "agent.jd", size=None, digest=digest(DATA))


def test_a_server_that_is_not_there_is_named(tmp_path):
    with pytest.raises(OSError, match=r"127.0.0.1:9/a.jd could not be downloaded .*; 0 bytes"):
        download("http://127.0.0.1:9/a.jd", tmp_path / "a", size=None, digest="00")
