"""Agents pushed to and pulled from a hub on the loopback, also where things go wrong."""

import hashlib
import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest

import astray
from astray.files import write_aside
from astray.training import folders
from astray.training.loop import train
from helpers.hub_server import READER, WRITER, Repository, running
from helpers.trainings import TINY

huggingface_hub = pytest.importorskip("huggingface_hub")

from astray.experiments import connection  # noqa: E402
from astray.experiments import hub as ours  # noqa: E402

# huggingface_hub's own way of uploading bytes, which its HTTP library is about to change.
pytestmark = pytest.mark.filterwarnings("ignore:Use 'content=<...>':DeprecationWarning")

WEIGHTS = "checkpoints/5505024/agent.safetensors"


@pytest.fixture
def server(monkeypatch, tmp_path):
    """A hub, whose writer we are; what is downloaded and imported goes to `tmp_path`."""
    from huggingface_hub import constants

    monkeypatch.setenv("HF_TOKEN", WRITER)
    monkeypatch.setenv("ASTRAY_AGENTS", str(tmp_path / "agents"))
    monkeypatch.setattr(constants, "HF_HUB_CACHE", str(tmp_path / "cache"))
    monkeypatch.setattr(constants, "HF_HUB_DOWNLOAD_TIMEOUT", 5)
    with running() as hub:
        at(hub.address, monkeypatch)
        yield hub


def at(address, monkeypatch):
    """Let everything be asked of a hub at `address`."""
    monkeypatch.setattr(ours, "_api", lambda _: huggingface_hub.HfApi(endpoint=address))


@pytest.fixture
def pushed(server):
    """The hub with a pretrained agent on it."""
    ours.push(folders.find("maze-corner"), "ada/mouse")
    return server


def files(server, revision="main"):
    repository = server.repositories["ada/mouse"]
    return repository.commits[repository.at(revision)]


def nothing_is_left(tmp_path):
    return not (tmp_path / "agents").exists() or not list((tmp_path / "agents").iterdir())


def test_what_is_pulled_is_the_agent_that_was_pushed(pushed, tmp_path):
    run = ours.pull("ada/mouse")
    assert run == tmp_path / "agents" / "mouse" and "mouse" in folders.imported()
    assert (run / WEIGHTS).read_bytes() == (folders.find("maze-corner") / WEIGHTS).read_bytes()
    source = json.loads((run / "hub.json").read_text())
    assert (
        source["repository"] == "ada/mouse"
        and source["commit"] in pushed.repositories["ada/mouse"].commits
    )
    levels = range(10**6, 10**6 + 20)
    ours_plays, theirs = (
        astray.evaluate(astray.load_agent(name), "maze", "anywhere-small", levels)
        for name in ("mouse", "maze-corner")
    )
    assert ours_plays.equals(theirs)


@pytest.mark.usefixtures("undrawn")
def test_a_run_is_pushed_with_a_card_that_tells_what_it_pursues(server, tmp_path):
    config = TINY.__class__(**vars(TINY) | {"knobs": {"time_limit": 30}})
    train(config, tmp_path / "run", progress=False)
    commit = ours.push(tmp_path / "run", "ada/mouse", levels=30)
    assert commit.address == f"{server.address}/ada/mouse"
    card = files(server)["README.md"].decode()
    front, text = card.removeprefix("---\n").split("---\n", 1)
    assert "library_name: astray" in front and "- maze" in front
    assert text.index("# mouse") < text.index("episode.gif") < text.index("| `anywhere-small` |")
    assert text.count("episode.gif") == 1
    assert "curve.png" in text and "astray pull ada/mouse" in text
    promised = json.loads(files(server)["digests.json"])["files"]
    assert promised.keys() == files(server).keys() - {"digests.json"}
    for path, one in promised.items():
        assert one["sha256"] == hashlib.sha256(files(server)[path]).hexdigest()


def test_what_somebody_else_wrote_is_no_card(server, tmp_path):
    shutil.copytree(folders.find("maze-corner"), tmp_path / "run")
    (tmp_path / "run" / "README.md").write_text("# Notes of mine\n")
    with pytest.raises(ValueError, match=r"README\.md does not say '## What it pursues'"):
        ours.push(tmp_path / "run", "ada/mouse")
    assert not server.repositories


def test_a_second_push_replaces_the_first_agent(pushed, tmp_path):
    other = tmp_path / "other"
    shutil.copytree(folders.find("maze-corner"), other)
    (other / "checkpoints" / "5505024").rename(other / "checkpoints" / "77")
    ours.push(other, "ada/mouse")
    weights = [path for path in files(pushed) if path.endswith("safetensors")]
    assert weights == ["checkpoints/77/agent.safetensors"]


def test_a_repository_with_files_of_others_is_not_pushed_to(server):
    others = {"README.md": b"# A robot", ".gitattributes": b"", "checkpoints/9/model.pt": b"mine"}
    repository = server.repositories["ada/robot"] = Repository(False)
    commit = repository.commit("main", others)
    with pytest.raises(OSError, match=r"holds 'checkpoints/9/model\.pt', which astray did not"):
        ours.push("maze-corner", "ada/robot")
    assert repository.branches == {"main": commit} and repository.commits[commit] == others
    del others["checkpoints/9/model.pt"]  # as a repository that was made on the Hub's page
    repository.commit("main", others)
    ours.push("maze-corner", "ada/robot")
    assert "digests.json" in repository.commits[repository.branches["main"]]


def test_revisions_are_pushed_and_pulled(pushed):
    first = pushed.repositories["ada/mouse"].branches["main"]
    ours.push(folders.find("many-chests"), "ada/mouse", revision="thief")
    assert astray.load_agent(ours.pull("ada/mouse", revision="thief", name="a")).game == "keys"
    assert astray.load_agent(ours.pull("ada/mouse", name="b")).game == "maze"
    assert astray.load_agent(ours.pull("ada/mouse", revision=first, name="c")).game == "maze"
    with pytest.raises(FileNotFoundError, match="ada/mouse at v9 cannot be pulled: it has no such"):
        ours.pull("ada/mouse", revision="v9", name="d")


def test_private_repositories_need_a_token(server, monkeypatch):
    ours.push(folders.find("maze-corner"), "ada/mouse", private=True)
    assert server.repositories["ada/mouse"].private
    monkeypatch.setenv("HF_TOKEN", READER)
    ours.pull("ada/mouse", name="seen")
    monkeypatch.setenv("HF_TOKEN", "hf_nobody")
    with pytest.raises(FileNotFoundError, match=r"there is none, or it is private; .* HF_TOKEN"):
        ours.pull("ada/mouse", name="unseen")


def test_without_a_token_nothing_is_measured_for_what_is_pushed(server, monkeypatch, tmp_path):
    from huggingface_hub import constants

    monkeypatch.delenv("HF_TOKEN")
    monkeypatch.setattr(constants, "HF_TOKEN_PATH", str(tmp_path / "no token"))
    monkeypatch.setattr(ours, "_with_card", lambda *_: pytest.fail("it measures"))
    with pytest.raises(PermissionError, match="there is no token; see hf auth login, or HF_TOKEN"):
        ours.push(folders.find("maze-corner"), "ada/mouse")
    assert not server.requests


def test_without_permission_nothing_is_pushed(server, monkeypatch):
    monkeypatch.setenv("HF_TOKEN", READER)
    with pytest.raises(PermissionError, match="cannot be pushed: the Hub says 403"):
        ours.push(folders.find("maze-corner"), "ada/mouse")
    assert not server.repositories


def test_a_hub_without_room_says_so(server):
    server.no_room = True
    with pytest.raises(OSError, match="the Hub says 507"):
        ours.push(folders.find("maze-corner"), "ada/mouse")
    assert files(server) == {}


def test_pulls_in_threads_leave_the_clients_of_the_user(pushed):
    from huggingface_hub.utils import _http

    before = _http._GLOBAL_CLIENT_FACTORY
    with ThreadPoolExecutor(4) as threads:
        pulled = [*threads.map(lambda k: ours.pull("ada/mouse", name=f"mouse-{k}"), range(12))]
    assert [path.name for path in pulled] == [f"mouse-{k}" for k in range(12)]
    assert _http._GLOBAL_CLIENT_FACTORY is before


def test_an_interrupted_download_goes_on_where_it_was(pushed, monkeypatch):
    monkeypatch.setattr("time.sleep", lambda _: None)  # of the library's, between its tries
    size = len(files(pushed)[WEIGHTS])
    pushed.cut[WEIGHTS] = [size // 2] + [0] * 20
    with pytest.raises(OSError, match=r"the connection failed .* the same command goes on"):
        ours.pull("ada/mouse")
    pushed.cut.clear()
    assert (ours.pull("ada/mouse") / WEIGHTS).stat().st_size == size


def test_a_file_whose_size_nobody_tells_is_not_taken(pushed, tmp_path, monkeypatch):
    told = huggingface_hub.get_hf_file_metadata

    def silent(*given, **named):
        return replace(told(*given, **named), size=None)

    monkeypatch.setattr(huggingface_hub, "get_hf_file_metadata", silent)
    with pytest.raises(ValueError, match=r"must be of at most .*; its size is not stated"):
        ours.pull("ada/mouse")
    assert nothing_is_left(tmp_path)


def test_an_answer_that_cannot_be_unpacked_is_told(pushed, tmp_path, monkeypatch):
    class Api(huggingface_hub.HfApi):
        def hf_hub_download(self, *given, **named):
            raise connection.http().DecodingError("incorrect header check")

    monkeypatch.setattr(ours, "_api", lambda _: Api(endpoint=pushed.address))
    with pytest.raises(OSError, match=r"the connection failed .incorrect header check"):
        ours.pull("ada/mouse")
    assert nothing_is_left(tmp_path)


def one_byte_changed(data):
    return data[:-1] + bytes([data[-1] ^ 1])


@pytest.mark.parametrize("path", [WEIGHTS, "config.json", "README.md", "episode.gif"])
def test_a_file_with_another_digest_is_refused_and_forgotten(pushed, tmp_path, path):
    pushed.changed[path] = one_byte_changed(files(pushed)[path])
    with pytest.raises(ValueError, match=f"{path} is refused: its SHA-256 is .*, not .* as digest"):
        ours.pull("ada/mouse")
    assert nothing_is_left(tmp_path)
    pushed.changed.clear()
    ours.pull("ada/mouse")  # the cache is not supported the wrong one


@pytest.mark.parametrize("was, wrong", [(b"{", b"["), (b'"sha256": "', b'"sha255": "')])
def test_damaged_digests_are_refused_and_forgotten(pushed, tmp_path, was, wrong):
    right = files(pushed)["digests.json"]
    pushed.changed["digests.json"] = right.replace(was, wrong)
    assert len(right) == len(pushed.changed["digests.json"]) and was in right
    with pytest.raises(ValueError, match=r"digests\.json is not as astray writes it"):
        ours.pull("ada/mouse")
    assert nothing_is_left(tmp_path)
    pushed.changed.clear()
    ours.pull("ada/mouse")


def rewritten(server, changes):
    """The repository with files changed, and digests.json to fit."""
    there = files(server) | changes
    digests = {
        "format": 1,
        "files": {
            path: {"bytes": len(x), "sha256": hashlib.sha256(x).hexdigest()}
            for path, x in there.items()
            if path != "digests.json"
        },
    }
    there["digests.json"] = changes.get("digests.json", json.dumps(digests).encode())
    server.repositories["ada/mouse"].commit("main", there)


def other_largest(weights):
    """An agent that takes the fourth plane to have one more value."""
    size = int.from_bytes(weights[:8], "little")
    header = weights[8 : 8 + size].replace(b"1, 1, 6, 6]", b"1, 1, 6, 7]")
    assert header != weights[8 : 8 + size]
    return weights[:8] + header + weights[8 + size :]


def settings(server, **changes):
    data = json.loads(files(server)["config.json"])
    data["config"] |= changes
    data["config"].pop("training_variant")
    return json.dumps(data).encode()


@pytest.mark.parametrize(
    "changes, message",
    [
        (lambda s: {WEIGHTS: files(s)[WEIGHTS][:1000]}, "holds no agent that can be used"),
        (lambda s: {WEIGHTS: b"\x80\x04cos\nsystem\n"}, "holds no agent that can be used"),
        (lambda s: {"config.json": b"[]"}, "is not the settings of a run"),
        (lambda s: {"config.json": b"[" * 9}, r"used: ada/mouse.config.json is .*: it is not JSON"),
        (lambda s: {"README.md": b"# A mouse, \xff"}, "can be used: 'utf-8' codec can't decode"),
        (lambda s: {"config.json": settings(s, game="coinrun", variant="coin-end",
                                            validation=None)},
         "of the game 'maze', not of 'coinrun'"),
        (lambda s: {"config.json": settings(s, variant="corner", validation=None)},
         r"it has shape \(4, 7, 7\), where the settings say \(4, 25, 25\)"),
        (lambda s: {"config.json": settings(s, width=200)},
         r"used: ada/mouse.checkpoints.*: it has width [0-9]+, where the settings say 200"),
        (lambda s: {WEIGHTS: other_largest(files(s)[WEIGHTS])},
         r"it has largest \(1, 1, 6, 7\), where the settings say \(1, 1, 6, 6\)"),
        (lambda s: {"config.json": settings(s, network="os:system")},
         "it has name mlp, where the settings say os:system"),
        (lambda s: {"evil.py": b"import os"}, "must name an agent's files; got 'evil.py'"),
        (lambda s: {"../escape": b""}, "must name an agent's files; got '../escape'"),
        (lambda s: {"digests.json": b"{"}, "digests.json is not as astray writes it"),
        (lambda s: {"digests.json": b'{"format": 2}'}, "must be an object of format 1"),
        (lambda s: {"digests.json": b'{"format": 1, "files": {}}'}, "must name config.json"),
    ],
)  # fmt: skip
def test_what_is_no_agent_is_refused(pushed, tmp_path, changes, message):
    rewritten(pushed, changes(pushed))
    with pytest.raises(ValueError, match=message):
        ours.pull("ada/mouse")
    assert nothing_is_left(tmp_path)


def test_only_promised_files_are_asked_for(pushed):
    pushed.repositories["ada/mouse"].commit("main", files(pushed) | {"evil.bin": b"x"})
    pushed.requests.clear()
    ours.pull("ada/mouse")
    assert not [request for request in pushed.requests if "evil" in request]


def test_a_file_too_large_to_be_ours_is_not_downloaded(pushed):
    """A list of files of 32 MB, which is read as it has come, would take 0.8 GB."""
    large = files(pushed) | {ours.DIGESTS: bytes(2**20 + 1)}
    pushed.repositories["ada/mouse"].commit("main", large)
    pushed.requests.clear()
    with pytest.raises(ValueError, match="json must be of at most 1,048,576 bytes; it has 1,048,5"):
        ours.pull("ada/mouse")
    assert not [r for r in pushed.requests if r.startswith("GET") and "resolve" in r]


def test_a_full_disk_leaves_nothing(pushed, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(ours, "write_aside", full)
    with pytest.raises(OSError, match="No space left on device"):
        ours.pull("ada/mouse")
    assert nothing_is_left(tmp_path)


def test_without_a_network_the_cache_is_enough(pushed, monkeypatch, tmp_path, caplog):
    ours.pull("ada/mouse", name="first")
    commit = pushed.repositories["ada/mouse"].branches["main"]
    pushed.requests.clear()
    assert ours.pull("ada/mouse", name="second", offline=True).is_dir()
    assert ours.pull("ada/mouse", name="third", revision=commit, offline=True).is_dir()
    assert pushed.requests == []
    at("http://127.0.0.1:9", monkeypatch)  # where nobody listens
    monkeypatch.setattr("time.sleep", lambda _: None)
    assert ours.pull("ada/mouse", name="fourth").is_dir()
    with pytest.raises(OSError, match="cannot be reached, and the cache does not have all of it"):
        ours.pull("ada/other")
    assert "Retrying" not in caplog.text  # in six lines, before the one that is owed
    with pytest.raises(OSError, match="cannot be reached, and the cache does not have all of it"):
        ours.pull("ada/other", offline=True)


def test_a_name_that_is_taken_is_told_before_anything_is_asked(pushed):
    ours.pull("ada/mouse")
    pushed.requests.clear()
    with pytest.raises(ValueError, match=r"there is an agent 'mouse' already, in .*mouse"):
        ours.pull("ada/mouse")
    with pytest.raises(ValueError, match="an agent's name must be of a-z"):
        ours.pull("ada/mouse", name="../x")
    with pytest.raises(ValueError, match=r"an agent's name must be of a-z, .* at most 100"):
        ours.pull(f"ada/{'mouse' * 60}")
    with pytest.raises(ValueError, match="a repository must be USER/NAME"):
        ours.pull("mouse")
    assert pushed.requests == []


def test_a_file_of_another_size_is_told_its_size(pushed):
    told = json.loads(files(pushed)["digests.json"])
    told["files"]["config.json"]["bytes"] += 1
    rewritten(pushed, {"digests.json": json.dumps(told).encode()})
    size = len(files(pushed)["config.json"])
    with pytest.raises(ValueError, match=rf"of {size:,} bytes, not .* of {size + 1:,} as digests"):
        ours.pull("ada/mouse")


def test_agents_of_others_are_not_pushed(pushed, tmp_path):
    run = ours.pull("ada/mouse")
    with pytest.raises(ValueError, match="was brought from elsewhere"):
        ours.push(run, "eve/mouse")
    shutil.copytree(folders.find("maze-corner"), tmp_path / "theirs")
    write_aside(tmp_path / "theirs" / "origin.json", b"{}")
    with pytest.raises(ValueError, match="was brought from elsewhere"):
        ours.push(tmp_path / "theirs", "eve/mouse")


def test_verbs_push_and_pull(server, astray):
    said = astray("push", "maze-corner", "ada/mouse")
    assert said.startswith(f"{server.address}/ada/mouse at ")
    assert astray("pull", "ada/mouse", "--as", "mine").strip().endswith("mine")
    assert '"mine"' in astray("list", "--json")
    assert "cannot be pulled: there is none" in astray("pull", "ada/nothing", fails=True)
