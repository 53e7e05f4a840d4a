"""A Hub that names paths where digests are expected reaches no file of the user's."""

import json
import shutil
import threading
import time

import pytest

from astray.published import download
from astray.training import folders
from helpers.hub_server import WRITER, running
from helpers.thorough import thorough

huggingface_hub = pytest.importorskip("huggingface_hub")

from astray.experiments import hub as ours  # noqa: E402

pytestmark = pytest.mark.filterwarnings("ignore:Use 'content=<...>':DeprecationWarning")

MINE = "of the user\n"


@pytest.fixture
def hub(monkeypatch, tmp_path):
    """A hub with an agent on it; `mine` beside the cache is a file of the user's."""
    from huggingface_hub import constants

    monkeypatch.setenv("HF_TOKEN", WRITER)
    monkeypatch.setenv("ASTRAY_AGENTS", str(tmp_path / "agents"))
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(constants, "HF_HUB_DOWNLOAD_TIMEOUT", 5)
    monkeypatch.setattr("time.sleep", lambda _: None)  # of the library's, between its tries
    (tmp_path / "mine").write_text(MINE)
    with running() as server:
        monkeypatch.setattr(ours, "_api", lambda _: huggingface_hub.HfApi(endpoint=server.address))
        ours.push(folders.find("maze-corner"), "ada/mouse")
        yield server


def outside(tmp_path):
    """What is in `tmp_path`, but not in the cache."""
    return sorted(path.name for path in tmp_path.iterdir() if path.name != "cache")


def paths(tmp_path):
    """What a server can name in the place of a digest."""
    mine = str(tmp_path / "mine")
    return [
        mine, f"../../../{tmp_path.name}/mine", "../../../mine", "../" * 9 + mine[1:], "..", "../x",
        mine.replace("/", "\\"), "a/../../b", f"W/{mine}", "a" * 300, "C:evil", "nul",
    ]  # fmt: skip


@pytest.mark.parametrize("header", ["ETag", "X-Linked-Etag", "X-Repo-Commit"])
@pytest.mark.parametrize("honest", [0, 3, *thorough(1, 2)], ids="after {} answers".format)
def test_a_path_in_the_place_of_a_digest_is_refused(hub, tmp_path, header, honest):
    """Also where the first answers were those of a Hub, and astray has looked at them."""
    for path in paths(tmp_path)[:: 1 if honest < 3 else 4]:
        hub.said = [{}] * honest + [{header: path}] * 9
        with pytest.raises(ValueError, match="has a path, or nothing of the Hub, as its"):
            ours.pull("ada/mouse")
        assert (tmp_path / "mine").read_text() == MINE and hub.said != []
        assert outside(tmp_path) in (["agents", "mine"], ["mine"])
        shutil.rmtree(tmp_path / "cache", ignore_errors=True)


def test_a_file_that_is_not_there_is_noted_in_the_cache_alone(hub, tmp_path):
    hub.repositories["ada/mouse"].commit("main", {})
    hub.missing = {"X-Repo-Commit": str(tmp_path / "noted")}
    with pytest.raises(ValueError, match="as its commit"):
        ours.pull("ada/mouse")
    assert not (tmp_path / "noted").exists()


def test_a_link_in_the_cache_to_a_file_of_the_users_is_not_followed(hub, tmp_path):
    """As an older version left it, which believed the server."""
    ours.pull("ada/mouse", name="first")
    (entry,) = (tmp_path / "cache").rglob("README.md")
    entry.unlink()
    entry.symlink_to(tmp_path / "mine")
    with pytest.raises(ValueError, match=r"README\.md is refused: its SHA-256"):
        ours.pull("ada/mouse", name="second")
    assert (tmp_path / "mine").read_text() == MINE and not entry.is_symlink()
    assert ours.pull("ada/mouse", name="third").is_dir()


@pytest.mark.parametrize("repository", ["../x", "./x", "ada/..", "ada/.x", "/x", "ada/a/b", 3])
def test_a_repository_that_may_be_a_path_is_refused_before_anything_is_asked(hub, repository):
    hub.requests.clear()
    for ask in (
        lambda: ours.pull(repository),
        lambda: ours.push(folders.find("maze-corner"), repository),
    ):
        with pytest.raises(ValueError, match="a repository must be USER/NAME"):
            ask()
    assert hub.requests == []


@pytest.mark.parametrize(
    "revision", ["/etc/x", "../../x", "a/../b", "", "a//b", "C:\\x", "a\n", ".", "./x", "a/.b", 3]
)
def test_a_revision_that_may_be_a_path_is_refused_before_anything_is_asked(hub, revision):
    hub.requests.clear()
    for ask in (
        lambda: ours.pull("ada/mouse", revision=revision),
        lambda: ours.push(folders.find("maze-corner"), "ada/mouse", revision=revision),
    ):
        with pytest.raises(ValueError, match="a revision must be a branch, a tag or a commit"):
            ask()
    assert hub.requests == []


@pytest.mark.parametrize(
    "headers, said",
    [
        ({"Content-Encoding": "gzip"}, "is compressed by 'gzip', unasked"),
        (
            {"Content-Length": str(2**40)},
            r"must be of at most [\d,]+ bytes; it says '1099511627776'",
        ),
    ],
)
def test_what_is_sent_is_no_more_than_was_said(hub, tmp_path, headers, said):
    hub.sent = headers
    with pytest.raises(ValueError, match=said):
        ours.pull("ada/mouse")
    assert outside(tmp_path) in (["agents", "mine"], ["mine"])


def test_an_answer_in_chunks_ends_after_the_bytes_that_it_says(hub):
    hub.sent = {"Content-Length": "5", "Transfer-Encoding": "chunked"}
    hub.changed = {"digests.json": b"a\r\n0123456789\r\n" * 9 + b"0\r\n\r\n"}
    with pytest.raises(ValueError, match="has more than the 5 bytes it says"):
        ours.pull("ada/mouse")


@pytest.mark.parametrize(
    "wrong, given, said",
    [
        ("sent", {"Content-Length": "5"}, "cannot be pulled: .* should be of size [0-9]+ but has"),
        ("said", [{"X-Linked-Size": "7"}] * 9, "cannot be pulled: .* should be of size 7 but has"),
        (
            "missing",
            {"X-Error-Code": "GatedRepo"},
            "cannot be pulled: the Hub says 404: .*resolve/main/digests",
        ),
    ],
)
def test_a_refusal_is_one_line_without_the_advice_of_the_library(hub, wrong, given, said):
    setattr(hub, wrong, given)
    if wrong == "missing":
        hub.repositories["ada/mouse"].commit("main", {})
    with pytest.raises(OSError, match=f"^ada/mouse {said}") as told:
        ours.pull("ada/mouse")
    assert len(str(told.value).splitlines()) == 1 and "information" not in str(told.value)


@pytest.mark.parametrize("said", [{}, [], None, {"url": 3}])
def test_a_push_to_what_is_no_hub_says_so(hub, monkeypatch, said):
    monkeypatch.setattr("helpers.hub_server.Handler.create", lambda self, _: self.answer(200, said))
    with pytest.raises(ValueError, match=r"^ada/new cannot be pushed: no Hub answers so"):
        ours.push(folders.find("maze-corner"), "ada/new")


def test_a_hub_that_sends_a_byte_now_and_then_is_not_waited_for(hub, tmp_path, monkeypatch):
    monkeypatch.setattr(download, "WAIT", 0.5)
    hub.drips = 1, 0.01
    with pytest.raises(OSError, match=r"fewer than 10,000 bytes came in 0\.5 seconds"):
        ours.pull("ada/mouse")
    assert outside(tmp_path) in (["agents", "mine"], ["mine"]) and not folders.imported()


@pytest.mark.parametrize("part", ["/repos/create", "/preupload/", "/commit/"])
def test_a_hub_that_answers_a_push_with_a_byte_now_and_then_is_not_waited_for(
    hub, monkeypatch, part
):
    monkeypatch.setattr(download, "WAIT", 1.0)
    hub.drips, hub.dripping = (1, 0.1), part
    with pytest.raises(OSError, match=r"ada/new cannot be pushed: fewer than 10,000 bytes came"):
        ours.push(folders.find("maze-corner"), "ada/new")


def test_a_slow_hub_that_sends_enough_is_waited_for(hub, monkeypatch):
    """Its 582,584 bytes take 1.5 s; a busy machine may stop for most of the limit between two."""
    monkeypatch.setattr(download, "WAIT", 1.2)
    hub.drips, begun = (40_000, 0.1), time.monotonic()
    assert ours.pull("ada/mouse").is_dir() and time.monotonic() - begun > download.WAIT


def test_what_the_user_set_up_of_connections_is_used_and_comes_back(hub, tmp_path):
    from huggingface_hub import get_session, set_client_factory
    from huggingface_hub.utils._http import default_client_factory

    made = []

    def make():
        made.append(default_client_factory())
        return made[-1]

    set_client_factory(make)
    try:
        ours.pull("ada/mouse")
        assert made, "the user's proxies and certificates are used"
        assert get_session() is made[-1] and not get_session().event_hooks["response"]
    finally:
        set_client_factory(default_client_factory)


def test_the_cache_cannot_lead_out_of_a_folder_that_is_made(hub, tmp_path):
    ours.pull("ada/mouse", name="first")
    (refs,) = (tmp_path / "cache").rglob("refs/main")
    refs.write_text("..")
    with pytest.raises((ValueError, OSError)):
        ours.pull("ada/mouse", name="second", offline=True)
    source = json.loads((tmp_path / "agents" / "first" / "hub.json").read_text())
    assert source["repository"] == "ada/mouse"


@pytest.mark.parametrize(
    "to", ["http://127.0.0.1/\x7f", "http://127.0.0.1:99999/", "http://[::1/", f"//{'a' * 64}/"]
)
def test_an_agent_that_has_moved_to_no_address_is_not_reached(hub, tmp_path, to):
    hub.said = [{"Location": to}] * 9
    with pytest.raises((OSError, ValueError), match="ada/mouse cannot be pulled: "):
        ours.pull("ada/mouse")
    with pytest.raises(ValueError, match="an agent's name must be of a-z"):
        ours.pull("ada/mouse", name=3)
    assert (tmp_path / "mine").read_text() == MINE


def at_once(server, kind, *answers):
    """Let a hub answer with a status, headers and a body each; the last one again and again."""

    def say(handler):
        server.requests.append(handler.path)
        status, headers, body = answers[min(len(server.requests), len(answers)) - 1]
        handler.body()
        handler.answer(status, body, **headers)

    server.requests.clear()
    return [(f"helpers.hub_server.Handler.do_{method}", say) for method in kind]


@pytest.mark.parametrize("ask", [lambda: ours.pull("ada/mouse"), lambda: push("ada/mouse")])
@pytest.mark.parametrize(
    "headers", [{"Retry-After": "1000000000"}, {"Retry-After": "9" * 400},
                {"RateLimit": '"api";r=0;t=299'}]
)  # fmt: skip
def test_a_hub_that_asks_to_wait_for_years_is_not_waited_for(hub, monkeypatch, ask, headers):
    slept = []
    monkeypatch.setattr("time.sleep", slept.append)
    for name, say in at_once(hub, ["GET", "HEAD"], (429, headers, b"")):
        monkeypatch.setattr(name, say)
    with pytest.raises(OSError, match=r"ada/mouse cannot be pu.*ed: the Hub says 429: wait [192]"):
        ask()
    assert not slept


def push(repository):
    return ours.push(folders.find("maze-corner"), repository)


@pytest.mark.parametrize(
    "method, said", [("GET", "no answer came in 1 seconds"), ("POST", "timed")]
)
def test_a_hub_that_answers_a_push_with_silence_is_not_waited_for(hub, monkeypatch, method, said):
    monkeypatch.setattr(download, "WAIT", 1.0)
    over = threading.Event()

    def be_silent(handler):
        handler.close_connection = over.wait(60)

    monkeypatch.setattr(f"helpers.hub_server.Handler.do_{method}", be_silent)
    begun = time.monotonic()
    with pytest.raises(OSError, match=rf"^ada/new cannot be pushed: .*{said}"):
        push("ada/new")
    assert time.monotonic() - begun < 60
    over.set()
    for thread in threading.enumerate():  # which closes its socket as it ends
        if thread.name.endswith("(run)"):
            thread.join(20)


@pytest.mark.parametrize(
    "headers, body, said",
    [
        ({}, b" " * 2**26, "answers have more than 33,554,432 bytes"),
        ({"Link": '<{}/x>; rel="next"'}, b"[]" + b" " * 2**20, "have more than 33,554,432 bytes"),
        ({"Content-Encoding": "gzip"}, b"[]", "is compressed by 'gzip', unasked"),
        ({}, b"<html>", "no Hub answers so: JSONDecodeError"),
        ({}, b"[" * 100_000, "no Hub answers so: RecursionError"),
    ],
)
def test_answers_to_a_push_are_limited(hub, monkeypatch, headers, body, said):
    headers = {name: text.format(hub.address) for name, text in headers.items()}
    for name, say in at_once(hub, ["GET"], (200, headers, body)):
        monkeypatch.setattr(name, say)
    with pytest.raises(ValueError, match=f"^ada/mouse cannot be pushed: .*{said}"):
        push("ada/mouse")


@pytest.mark.parametrize("ask", [lambda: ours.pull("ada/mouse"), lambda: push("ada/mouse")])
def test_what_a_hub_says_of_other_programs_is_not_kept(hub, monkeypatch, tmp_path, ask):
    """A list in the place of an object let each later request fail for a day, to any Hub."""
    from huggingface_hub import constants
    from huggingface_hub.utils import _detect_agent

    there = tmp_path / "cache" / "harnesses"
    there.parent.mkdir()
    there.write_text("[1]")
    monkeypatch.setattr(constants, "AGENT_HARNESSES_PATH", str(there))
    monkeypatch.setattr(_detect_agent, "_registry", None)
    ask()
    assert not any("harnesses" in asked for asked in hub.requests)
    assert not constants.HF_HUB_DISABLE_TELEMETRY


@pytest.mark.parametrize("ask", [lambda: ours.pull("ada/mouse"), lambda: push("ada/new")])
def test_no_other_library_speaks_with_the_hub(hub, monkeypatch, ask):
    """Xet's, which nobody watches: a silent Hub held it for ever, and it told of its errors."""
    monkeypatch.setattr("huggingface_hub.constants.HF_HUB_DISABLE_XET", False)
    hub.requests.clear()
    ask()
    assert hub.requests and not any("xet" in asked for asked in hub.requests)
    assert not huggingface_hub.constants.HF_HUB_DISABLE_XET


def test_a_commit_that_is_no_name_is_not_printed(hub, monkeypatch):
    """As what a terminal takes for a command."""
    told = {"commitUrl": f"{hub.address}/ada/mouse", "commitOid": "\x1b[2J"}
    monkeypatch.setattr("helpers.hub_server.Handler.commit", lambda it, *_: it.answer(200, told))
    with pytest.raises(ValueError, match=r"a revision must be .*; got '\\x1b\[2J'"):
        push("ada/mouse")
