"""The catalogue of agents that others published: where they are, and what is known of them.

It is data, in `catalogue.toml`; nothing of others is part of astray. `fetch` downloads an agent
at the user's word, checks its digest and imports it.
"""

from __future__ import annotations

import functools
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from astray.files import hold, read
from astray.published.download import LARGEST, digest_of, download
from astray.published.imported import Known, import_agent, known_as
from astray.training import folders

DOWNLOADS, RESULTS = "downloads", "results"  # in the folder of imported agents


@dataclass(frozen=True)
class Check:
    """What others measured of an agent, to be compared with.

    levels        that they played
    succeeded     in so many
    environments  at once, where what counted were the first episodes to end, which are short
                  ones more often than levels are; 0: every level counted once
    value         of the critic at the beginning of levels, on average; None: not told
    by            a field of states, for which there are shares of their own
    shares        of success, by the value of that field
    """

    variant: str
    levels: int
    succeeded: int
    environments: int = 0
    value: float | None = None
    by: str | None = None
    shares: tuple[tuple[int, float], ...] = ()


@dataclass(frozen=True)
class Published:
    """An agent of the catalogue.

    file     its name, whose ending tells the format; empty where there is no address
    address  of the file; empty: `by_hand` says how to get it
    size     bytes; None: not known
    sha256   of the file; None: it could not be had
    blob     git's id of the file, which pins it where its repository alone is known
    kind     results: no agent, but a table of what one did; see `published.results`
    tried    it has been imported and checked by the makers of the catalogue
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
    """All agents of the catalogue, by name."""
    text = Path(__file__).with_name("catalogue.toml").read_text(encoding="utf-8")
    return {name: read_entry(name, data) for name, data in tomllib.loads(text).items()}


def read_entry(name: str, data: dict[str, Any]) -> Published:
    """An entry of the catalogue."""
    checks = [
        Check(**check | {"shares": tuple((int(k), v) for k, v in check.get("shares", {}).items())})
        for check in data.get("checks", [])
    ]
    own = ("file", "address", "by_hand", "size", "sha256", "blob", "tried", "kind")
    return Published(
        name, known_as(data), checks=tuple(checks), **{key: data[key] for key in own if key in data}
    )


def find(name: str) -> Published:
    """The agent of the catalogue that has this name."""
    if name not in catalogue():
        there = ", ".join(catalogue())
        raise ValueError(f"unknown published agent {name!r}; there are: {there}")
    return catalogue()[name]


def by_digest(sha256: str) -> Published | None:
    """The agent of the catalogue whose file has this digest."""
    return next((one for one in catalogue().values() if one.sha256 == sha256), None)


def fetch(one: Published, *, unchecked: bool = False) -> Path:
    """Download, check and import an agent of the catalogue; its run folder, or a table's file.

    unchecked  also where no digest is known, so that nobody can tell whether it is the right file
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
    home.mkdir(parents=True, exist_ok=True)
    with hold(home, "fetches an agent to"):  # also until it is imported: the file is one for all
        folders.check_new(one.name)
        file = home / DOWNLOADS / one.file
        download(one.address, file, size=one.size, digest=one.digest)
        try:
            return import_agent(file, one.name, one.known, expected=one.sha256)
        finally:
            file.unlink()


def results_file(name: str) -> Path:
    """Return where a table of results is that was fetched.

    Raises ValueError, with the remedy, where it is not there or is not what was published.
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
