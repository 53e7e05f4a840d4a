"""The catalogue of published agents: addresses and known facts.

It is data, in `catalogue.toml`, and contains nothing of the agents. `fetch` downloads an agent on
request, checks its digest and imports it.
"""

import functools
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from astray.files import hold, read
from astray.published.download import LARGEST, digest_of, download
from astray.published.imported import Known, import_agent, known_as
from astray.training import folders
from astray.validation import one_of

DOWNLOADS, RESULTS = "downloads", "results"  # in the folder of imported agents


@dataclass(frozen=True)
class Check:
    """Published measurements of an agent, for comparison.

    Attributes:
        levels: Number of levels played.
        succeeded: Number of successes.
        environments: Number of parallel environments if the first episodes to end were counted,
            which favours short ones; 0 if every level counted once.
        value: Mean of the critic at the beginning of levels; None if unknown.
        by: Field of states that groups the rates below.
        rates: Success rates by the value of that field.
    """

    variant: str
    levels: int
    succeeded: int
    environments: int = 0
    value: float | None = None
    by: str | None = None
    rates: tuple[tuple[int, float], ...] = ()


@dataclass(frozen=True)
class Published:
    """An agent of the catalogue.

    Attributes:
        file: Name of the file, whose ending is the format; empty without an address.
        address: Address of the file; if empty, `by_hand` says how to get it.
        size: Bytes; None if unknown.
        sha256: Digest of the file; None if it could not be obtained.
        blob: Git's id of the file, for files known only from their repository.
        kind: "results" is a table of an agent's episodes instead; see `published.results`.
        tried: Whether the makers of the catalogue imported and checked it.
    """

    name: str
    known: Known
    file: str = ""
    address: str = ""
    by_hand: str = ""
    size: int | None = None
    sha256: str | None = None
    blob: str | None = None
    tried: bool = False
    kind: Literal["agent", "results"] = "agent"
    checks: tuple[Check, ...] = ()

    @property
    def digest(self) -> str | None:
        """The digest that the file must have: see `download.digest_of`."""
        return self.sha256 or self.blob


@functools.cache
def catalogue() -> dict[str, Published]:
    """Return all agents of the catalogue, by name."""
    text = Path(__file__).with_name("catalogue.toml").read_text(encoding="utf-8")
    return {name: read_entry(name, data) for name, data in tomllib.loads(text).items()}


def read_entry(name: str, data: dict[str, Any]) -> Published:
    """Parse an entry of the catalogue."""
    checks = [
        Check(**check | {"rates": tuple((int(k), v) for k, v in check.get("rates", {}).items())})
        for check in data.get("checks", [])
    ]
    own = ("file", "address", "by_hand", "size", "sha256", "blob", "tried", "kind")
    return Published(
        name, known_as(data), checks=tuple(checks), **{key: data[key] for key in own if key in data}
    )


def find(name: str) -> Published:
    """Return the catalogue's agent of this name; raise ValueError if there is none."""
    one_of("published agent", name, catalogue())
    return catalogue()[name]


def by_digest(sha256: str) -> Published | None:
    """Return the catalogue's agent whose file has this digest, or None."""
    return next((one for one in catalogue().values() if one.sha256 == sha256), None)


def fetch(one: Published, *, unchecked: bool = False) -> Path:
    """Download, check and import an agent; return its run folder, or the file of a table.

    Args:
        unchecked: Accept entries without a digest, for which the file cannot be verified.

    Raises:
        ValueError: If there is no address or digest, or the file is refused.
    """
    if not one.address:
        raise ValueError(f"{one.name} cannot be fetched: {one.by_hand}")
    if one.digest is None and not unchecked:
        raise ValueError(
            f"no digest of {one.name} is known, so what comes cannot be checked; to take it as it "
            f"is: astray agents fetch {one.name} --unchecked"
        )
    home = folders.home()
    if one.kind == "results":
        to = home / RESULTS / f"{one.name}.csv"
        download(one.address, to, size=one.size, digest=one.digest)
        return to
    with hold(home, "fetches an agent to"):  # also until it is imported: the file is one for all
        folders.check_new(one.name)
        file = home / DOWNLOADS / one.file
        download(one.address, file, size=one.size, digest=one.digest)
        try:
            return import_agent(file, one.name, one.known, expected=one.sha256)
        finally:
            file.unlink()


def results_file(name: str) -> Path:
    """Return the file of a fetched table of results.

    Raises:
        ValueError: If it was not fetched or differs from the published one; with the remedy.
    """
    one = find(name)
    path = folders.home() / RESULTS / f"{one.name}.csv"
    if not path.is_file():
        raise ValueError(f"the table {name} is not here; to bring it: astray agents fetch {name}")
    if one.digest and digest_of(read(path, LARGEST), one.digest) != one.digest:
        raise ValueError(
            f"{path} is not the table that was published: its digest is another; remove it, and "
            f"bring it again: astray agents fetch {name}"
        )
    return path
