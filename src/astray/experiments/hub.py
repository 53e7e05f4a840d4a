"""Agents on the Hugging Face Hub: a repository is a run folder with a card and digests.

README.md: the card, which is the repository's page. config.json, curve.csv, curve.png,
episode.gif: settings, learning curve, an episode. checkpoints/<steps>/agent.safetensors: the
network. digests.json: the size and SHA-256 of each of these.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import json
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from astray import imports
from astray.agents import policy
from astray.envs.vector import space_of
from astray.experiments.connection import Wary, reached, unreachable, wary
from astray.experiments.keep import keep
from astray.files import read, write_aside
from astray.training import folders
from astray.training.folders import CARD, CONFIG, HUB, ORIGIN, AgentFolder
from astray.validation import brief, of_kind, shown, slug

if TYPE_CHECKING:
    from huggingface_hub import HfApi

DIGESTS = "digests.json"
PAGE = (CONFIG, CARD, "curve.csv", "curve.png", "episode.gif")
AGENT = re.compile(r"checkpoints/(0|[1-9][0-9]{0,17})/agent\.safetensors")
REVISION = re.compile(r"(?!\.)[\w.+@#-]+(/(?!\.)[\w.+@#-]+)*")
REPOSITORY = re.compile(r"(?!\.)[\w.-]+/(?!\.)[\w.-]+")
DIGEST = re.compile(r"[0-9a-f]{64}")
FORMAT = 1  # of digests.json
LARGEST, LARGEST_AGENT = 2**25, 2**31  # bytes of a file, and of one with weights
NEEDED = (CONFIG, CARD)
ANYONES = {CARD, ".gitattributes", "LICENSE"}  # files that a new repository may have
PURSUES = "## What it pursues"  # which every card says


@dataclass(frozen=True)
class Commit:
    """One state of a repository on the Hub."""

    repository: str  # user/name
    revision: str  # the commit
    address: str  # of its page


def push(
    run: str | Path,
    repository: str,
    *,
    shift: str | None = None,
    revision: str | None = None,
    private: bool = False,
    levels: int = 1000,
    endpoint: str | None = None,
) -> Commit:
    """Upload a run's agent or a pretrained one, with its card; return the commit.

    The repository is created if needed. Files of an earlier agent in it are replaced.

    Args:
        shift: Shift with intended goal and proxies; None for the one of its training.
        revision: Branch, created if needed; None for the main branch.
        private: Make a new repository private.
        levels: Number of levels for the card's measurements.
        endpoint: Address of the Hub; None for huggingface_hub's setting.

    Raises:
        ImportError: If huggingface_hub is not installed.
        ValueError: If the agent is not your own, or the repository's name is invalid.
        PermissionError: If the Hub denies it.
        OSError: If the Hub cannot be reached or has no room, or the repository holds other files.
    """
    _check_name(repository, revision)
    api = _api(endpoint)
    from huggingface_hub import get_token

    if get_token() is None:  # told before a minute of measuring for the card
        raise PermissionError(
            f"{repository} cannot be pushed: there is no token; see hf auth login, or HF_TOKEN"
        )
    its = AgentFolder.open(run)
    if (its.path / ORIGIN).exists() or (its.path / HUB).exists():  # imported or pulled
        raise ValueError(
            f"{its.path} was brought from elsewhere; only agents of your own are pushed"
        )
    _check_ours(api, repository, revision)
    with tempfile.TemporaryDirectory(prefix="astray-") as passing:
        folder = _with_card(its, repository, shift, levels, Path(passing))
        write_aside(folder / DIGESTS, json.dumps(_digests(folder), indent=1).encode())
        with reached(repository, revision, "pushed", DIGESTS), wary(pushes=True):
            api.create_repo(repository, private=private, exist_ok=True)
            if revision is not None:
                api.create_branch(repository, branch=revision, exist_ok=True)
            made = api.upload_folder(
                repo_id=repository,
                folder_path=folder,
                revision=revision,
                commit_message=f"An agent of {_slug(repository)}",
                delete_patterns=["checkpoints/*"],
            )
            _check_name(repository, made.oid)  # which is printed
    return Commit(repository, made.oid, f"{api.endpoint}/{repository}")


def pull(
    repository: str,
    *,
    name: str | None = None,
    revision: str | None = None,
    offline: bool = False,
    endpoint: str | None = None,
) -> Path:
    """Download an agent, check it and add it to the imported ones; return its run folder.

    Files are checked against digests.json, and weights against the game's network. Nothing is
    executed.

    Args:
        name: Its new name; None for the repository's.
        revision: Branch, tag or commit; None for the main branch.
        offline: Use only huggingface_hub's cache.
        endpoint: Address of the Hub; None for huggingface_hub's setting.

    Raises:
        ImportError: If huggingface_hub is not installed.
        ValueError: If a file is not as it should be.
        FileNotFoundError: If there is no such repository.
        PermissionError: If the Hub denies it.
        OSError: If the Hub cannot be reached.
    """
    _check_name(repository, revision)
    name = _slug(repository) if name is None else name
    home = folders.home()
    folders.check_new(name)
    api = _api(endpoint)
    with folders.made(home, name) as aside, wary() as answers:
        # The cache has the commit in its paths, and notes by this which one the revision was.
        take = _taker(api, answers, repository, revision, offline)
        digests = take(DIGESTS, folders.LARGEST)
        try:
            commit, promised = digests.parent.name, _promised(digests)
            _check_name(repository, commit)
            take = _taker(api, answers, repository, commit, offline)
            for path, (size, digest) in promised.items():
                here = take(path, LARGEST_AGENT if AGENT.fullmatch(path) else LARGEST)
                write_aside(aside / path, _checked(repository, path, here, size, digest))
        except ValueError:
            _forget(digests)  # the next pull asks for it again
            raise
        _check_agent(repository, aside)
        source = {"repository": repository, "commit": commit, "revision": revision}
        write_aside(aside / HUB, json.dumps(source, indent=1).encode())
    return home / name


def _check_ours(api: HfApi, repository: str, revision: str | None) -> None:
    """Raise OSError if a repository holds files that astray did not write: a push replaces some."""
    from huggingface_hub.errors import RepositoryNotFoundError, RevisionNotFoundError

    there: set[str] = set()
    with reached(repository, revision, "pushed", DIGESTS), wary(pushes=True) as answers:
        with contextlib.suppress(RepositoryNotFoundError, RevisionNotFoundError):  # it is new
            ask = functools.partial(api.list_repo_files, repository, revision=revision)
            there = {*answers.brought(ask)} - ANYONES
        if there and DIGESTS not in there:
            told = f"it holds {shown(min(there))}, which astray did not write"
            raise OSError(f"{told}; push to a repository of its own")


def _api(endpoint: str | None) -> HfApi:
    with imports.extra("hub", "the Hub needs huggingface_hub"):
        from huggingface_hub import HfApi
    return HfApi(endpoint=endpoint)


def _check_name(repository: str, revision: str | None) -> None:
    """Raise ValueError if a repository or revision is invalid: both become paths in the cache."""
    if not isinstance(repository, str) or not REPOSITORY.fullmatch(repository):
        raise ValueError(f"a repository must be USER/NAME, as ada/mouse; got {shown(repository)}")
    given = "main" if revision is None else revision
    if not isinstance(given, str) or not REVISION.fullmatch(given) or ".." in given:
        raise ValueError(
            f"a revision must be a branch, a tag or a commit, as main; got {shown(revision)}"
        )


def _slug(repository: str) -> str:
    return slug(repository.partition("/")[2]) or "agent"


def _with_card(
    its: AgentFolder, repository: str, shift: str | None, levels: int, passing: Path
) -> Path:
    """Copy the agent with a card, whose first lines the Hub reads."""
    name = _slug(repository)
    if _has_card(its):
        if shift is not None:
            raise ValueError(
                f"{its.path} has a card already, which states its shift; leave out --shift"
            )
        folder = passing / name
        for path in _own_files(its):
            (folder / path).parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(its.path / path, folder / path)
    else:
        there = its.weights.parent
        folder = keep(
            there, name, shift=shift, folder=passing, levels=levels, largest=LARGEST_AGENT
        )
    config = folders.read_config(folder)
    card = (folder / CARD).read_text(encoding="utf-8")
    title, _, text = card.replace(f"{_VIDEO}\n", "").partition("\n")
    front = _FRONT.format(game=config.game)
    pulled = _PULLED.format(repository=repository)
    write_aside(folder / CARD, f"{front}\n{title}\n\n{_VIDEO}{pulled}{text}".encode())
    return folder


def _has_card(its: AgentFolder) -> bool:
    """Return whether `keep` wrote the run's card; raise ValueError if somebody else did."""
    path = its.card
    if not path.exists():
        return False
    if PURSUES not in path.read_text(encoding="utf-8"):
        raise ValueError(
            f"{path} does not say {PURSUES!r}: it is not a card; remove it, and one is written"
        )
    return True


# What the Hub finds a model by; then the video first, as it says most.
_FRONT = """---
library_name: astray
pipeline_tag: reinforcement-learning
tags:
- reinforcement-learning
- goal-misgeneralization
- ai-safety
- {game}
---
"""
_VIDEO = "![One level, as in training and in the test](episode.gif)\n"  # as in the card
_PULLED = """
In a clone of astray:

```bash
pip install ".[hub]"
astray pull {repository}
```
"""


def _own_files(its: AgentFolder) -> Iterator[str]:
    """Return the shared files of an agent: page and network."""
    yield from (name for name in PAGE if (its.path / name).is_file())
    yield its.weights.relative_to(its.path).as_posix()


def _digests(folder: Path) -> dict[str, Any]:
    files = {
        path: {"bytes": len(data), "sha256": hashlib.sha256(data).hexdigest()}
        for path in _own_files(AgentFolder.open(folder))
        for data in [read(folder / path, LARGEST_AGENT)]
    }
    return {"format": FORMAT, "files": files}


def _taker(
    api: HfApi, answers: Wary, repository: str, commit: str | None, offline: bool
) -> Callable[[str, int], Path]:
    """Return a function that fetches a file of the repository, up to a size, into the cache."""

    def take(path: str, most: int) -> Path:
        def ask() -> str:
            if not offline:
                _check_size(api, repository, commit, path, most)
            return api.hf_hub_download(repository, path, revision=commit, local_files_only=offline)

        answers.most = most
        with reached(repository, commit, "pulled", DIGESTS):
            return Path(answers.brought(ask))

    return take


def _check_size(api: HfApi, repository: str, commit: str | None, path: str, most: int) -> None:
    """Raise ValueError if a file is too large for astray, before the download."""
    from huggingface_hub import get_hf_file_metadata, hf_hub_url
    from huggingface_hub.errors import OfflineModeIsEnabled

    url = hf_hub_url(repository, path, revision=commit, endpoint=api.endpoint)
    try:
        size = get_hf_file_metadata(url, endpoint=api.endpoint).size
    except (OfflineModeIsEnabled, *unreachable()):
        return  # then the cache has it, or nobody
    if size is None or size > most:
        told = "its size is not stated" if size is None else f"it has {size:,}"
        raise ValueError(f"{repository}: {path} must be of at most {most:,} bytes; {told}")


def _promised(file: Path) -> dict[str, tuple[int, str]]:
    """Return the files of a repository with size and SHA-256 from digests.json."""
    try:
        data = json.loads(read(file, folders.LARGEST))
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise ValueError(f"it must be an object of format {FORMAT}; got {shown(data)}")
        of_kind("files", data.get("files"), dict)
        promised = {p: (one["bytes"], one["sha256"]) for p, one in data["files"].items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise ValueError(f"{DIGESTS} is not as astray writes it: {brief(error)}") from error
    for path, (size, digest) in promised.items():
        known = path in PAGE or AGENT.fullmatch(path)
        if not known or type(size) is not int or not DIGEST.fullmatch(str(digest)):
            raise ValueError(f"{DIGESTS} must name an agent's files; got {shown(path)}")
    if {*NEEDED} - {*promised} or sum(bool(AGENT.fullmatch(path)) for path in promised) != 1:
        raise ValueError(f"{DIGESTS} must name {', '.join(NEEDED)} and one agent.safetensors")
    return promised


def _forget(here: Path) -> None:
    """Remove a file from the cache."""
    from huggingface_hub import constants

    cache = Path(constants.HF_HUB_CACHE).resolve()
    for place in {here, here.resolve()}:
        if place.parent.resolve().is_relative_to(cache):  # a link may lead to any file
            place.unlink(missing_ok=True)


def _checked(repository: str, path: str, here: Path, size: int, digest: str) -> bytes:
    """Return a file's contents; on a mismatch remove it from the cache and raise ValueError."""
    data = read(here, LARGEST_AGENT)
    found = hashlib.sha256(data).hexdigest()
    if len(data) == size and found == digest:
        return data
    _forget(here)
    raise ValueError(
        f"{repository}: {path} is refused: its SHA-256 is {found} of {len(data):,} bytes, not "
        f"{digest} of {size:,} as {DIGESTS} says; it was removed, and nothing is imported"
    )


def _check_agent(repository: str, folder: Path) -> None:
    """Raise ValueError unless the network fits the game of the settings."""
    try:
        its = AgentFolder.open(folder)
        config, path = its.config(), its.weights
        _, architecture = policy.load(path, config.game)
        its.card.read_text(encoding="utf-8")
        game = config.find_game()
        space = space_of(game, config.training_variant(), config.observation)
        largest = () if config.observation == "image" else tuple(space.high.max((1, 2)).tolist())
        seen = {"shape": space.shape, "largest": largest, "actions": len(game.actions)}
        policy.check_known(path, architecture, **config.sizes, **seen)
    except (ValueError, OSError) as error:
        said = brief(str(error).replace(str(folder), repository))
        raise ValueError(f"{repository} holds no agent that can be used: {said}") from error
