"""A connection to the Hub: its answers are checked, and its errors are said in a sentence.

huggingface_hub makes paths in its cache of a commit and an ETag that a server names. A path in
their place would have it write elsewhere, or make a link to a file of the user's.
"""

from __future__ import annotations

import contextlib
import logging
import re
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from astray.bounds import brief, shown

COMMIT = re.compile(r"[0-9a-f]{40,64}")
ETAG = re.compile(r'(W/)?"?[0-9A-Za-z_-]{8,128}"?')  # the Hub's are digests


@dataclass
class Wary:
    """What an answer of the Hub may be.

    most  bytes of the next file
    """

    most: int = 0

    def ask(self, request: Any) -> None:
        """Ask for files as they are: a few compressed bytes may unpack to any number."""
        request.headers["Accept-Encoding"] = "identity"

    def see(self, answer: Any) -> None:
        """ValueError where an answer names a path, is compressed, or is larger than it may be."""
        headers, asked = answer.headers, answer.request.method
        commit, etag = headers.get("X-Repo-Commit"), headers.get("X-Linked-Etag")
        _check_name("commit", commit, COMMIT)
        if asked == "HEAD":
            _check_name("ETag", etag or headers.get("ETag"), ETAG)
        # Its bytes come by another library, which nobody watches; without this they come by HTTP.
        headers.pop("X-Xet-Hash", None)
        if not answer.is_success:  # nobody needs what comes with it, which may not end
            answer.stream.close()
            answer.stream = http().ByteStream(b"")
        elif asked == "GET":
            encoding, size = headers.get("Content-Encoding"), headers.get("Content-Length")
            if encoding not in (None, "identity"):
                raise ValueError(f"the Hub's answer is compressed by {shown(encoding)}, unasked")
            if not size or not size.isdecimal() or int(size) > self.most:
                raise ValueError(
                    f"the Hub's answer must be of at most {self.most:,} bytes; it says "
                    f"{shown(size)}"
                )


def _check_name(what: str, given: str | None, known: re.Pattern[str]) -> None:
    if given is not None and not known.fullmatch(given):
        raise ValueError(
            f"the Hub's answer has a path, or nothing of the Hub, as its {what}: {shown(given)}"
        )


@contextlib.contextmanager
def wary() -> Iterator[Wary]:
    """Check every answer before huggingface_hub uses it."""
    from huggingface_hub import set_client_factory
    from huggingface_hub.utils import _http

    seen = Wary()
    made = _http._GLOBAL_CLIENT_FACTORY  # of the user's, with their proxies and certificates

    def make() -> Any:
        client = made()
        hooks = client.event_hooks
        client.event_hooks = {
            "request": [*hooks["request"], seen.ask],
            "response": [*hooks["response"], seen.see],
        }
        return client

    set_client_factory(make)
    try:
        yield seen
    finally:
        set_client_factory(made)


def unreachable() -> tuple[type[Exception], ...]:
    """Return what huggingface_hub's connections raise if nobody answers, or an answer is none."""
    return (http().RequestError, http().InvalidURL, ConnectionError)


def http() -> Any:
    """The library of connections that huggingface_hub uses."""
    try:
        import httpx2 as http  # pyright: ignore[reportMissingImports]
    except ImportError:
        import httpx as http  # pyright: ignore[reportMissingImports]
    return http


@contextlib.contextmanager
def reached(repository: str, revision: str | None, what: str, lacking: str) -> Iterator[None]:
    """Say in a sentence why something of a repository could not be pushed or pulled."""
    from huggingface_hub import errors

    of = f"{repository} at {revision}" if revision else repository
    library = logging.getLogger("huggingface_hub")  # tells of every attempt to reach the Hub
    before = library.level
    library.setLevel(logging.ERROR)
    try:
        with _uncovered():
            yield
    except (errors.RevisionNotFoundError, errors.RemoteEntryNotFoundError) as error:
        lacks = "such revision" if isinstance(error, errors.RevisionNotFoundError) else lacking
        raise FileNotFoundError(f"{of} cannot be {what}: it has no {lacks}") from error
    except errors.LocalEntryNotFoundError as error:
        raise OSError(
            f"{of} cannot be {what}: the Hub cannot be reached, and the cache does not have all of "
            f"it ({brief(error.__cause__ or error)})"
        ) from error
    except errors.RepositoryNotFoundError as error:
        raise FileNotFoundError(
            f"{of} cannot be {what}: there is none, or it is private; with the token of somebody "
            "who may see it: hf auth login, or HF_TOKEN"
        ) from error
    except errors.HfHubHTTPError as error:
        status = error.response.status_code
        message = f"{of} cannot be {what}: the Hub says {status}: {brief(error).splitlines()[-1]}"
        if status in (401, 403):
            raise PermissionError(f"{message}; see hf auth login, or HF_TOKEN") from error
        raise OSError(message) from error
    except (errors.OfflineModeIsEnabled, *unreachable()) as error:
        raise OSError(
            f"{of} cannot be {what}: the connection failed ({brief(error)}); the same command "
            "goes on with what has arrived"
        ) from error
    finally:
        library.setLevel(before)


@contextlib.contextmanager
def _uncovered() -> Iterator[None]:
    """Raise what the Hub said where huggingface_hub raises RuntimeError because of it."""
    try:
        yield
    except RuntimeError as error:
        if isinstance(error.__cause__, (OSError, ValueError, *unreachable())):
            raise error.__cause__ from error
        raise
