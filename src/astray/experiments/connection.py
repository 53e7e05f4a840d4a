"""Connection to the Hub, with checked answers and readable errors.

huggingface_hub builds paths in its cache from a server's commit and ETag. If these contained a
path, it would write elsewhere or link to a file of the user's.
"""

import contextlib
import json
import logging
import re
import sys
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from http import HTTPStatus
from typing import Any, TypeVar

from astray.published import download
from astray.published.download import LEAST, MOST_DIGITS, in_time
from astray.validation import brief, shown

COMMIT = re.compile(r"[0-9a-f]{40,64}")
ONE = threading.Lock()  # as the process has one factory of clients
T = TypeVar("T")
ETAG = re.compile(r'(W/)?"?[0-9A-Za-z_-]{8,128}"?')  # the Hub's are digests
RESET = re.compile(r"(?:^|;\s*t\s*=\s*)(\d+)")  # seconds in Retry-After and RateLimit
LARGEST = 2**25  # bytes of all answers to a push


@dataclass
class Wary:
    """Limits on answers of the Hub, and how much of them has arrived.

    Attributes:
        most: Largest size of the next file in bytes.
        arrived: Bytes of all files so far; an answer itself counts as `LEAST`.
        stopped: Whether all further answers are refused.
    """

    most: int = 0
    arrived: int = 0
    stopped: bool = False

    def brought(self, ask: Callable[[], T]) -> T:
        """Return the result of `ask`; raise OSError if the Hub sends too few bytes meanwhile."""
        return in_time(ask, self.stop, lambda: self.arrived)

    def stop(self) -> None:
        """Refuse every answer from now on, also one that is being read."""
        self.stopped = True

    def come(self, count: int) -> None:
        """Count bytes that have come; raise ValueError after `stop`."""
        if self.stopped:
            raise ValueError("this answer is no longer waited for")
        self.arrived += count

    def ask(self, request: Any) -> None:
        """Request answers uncompressed, as few bytes could unpack to any size, and in time."""
        self.come(0)
        request.headers["Accept-Encoding"] = "identity"
        limits = dict.fromkeys(("connect", "read", "write", "pool"), download.WAIT)
        request.extensions["timeout"] = limits | {
            name: most for name, most in request.extensions["timeout"].items() if most is not None
        }

    def see(self, answer: Any) -> None:
        """Raise ValueError if an answer contains a path, is compressed, or is too large.

        OSError is raised if it asks to wait for long.
        """
        headers, asked = answer.headers, answer.request.method
        _check_wait(answer)
        self.come(LEAST)
        _check_name("commit", headers.get("X-Repo-Commit"), COMMIT)
        if asked == "HEAD":
            _check_name("ETag", headers.get("X-Linked-Etag") or headers.get("ETag"), ETAG)
        # Its bytes come by another library, which nobody watches; without this they come by HTTP.
        headers.pop("X-Xet-Hash", None)
        if not answer.is_success:  # nobody needs what comes with it, which may not end
            answer.stream.close()
            answer.stream = http().ByteStream(b"")
        elif asked == "GET":
            size = headers.get("Content-Length")
            _check_plain(answer)
            if not size or not size.isdecimal() or int(size) > self.most:
                raise ValueError(
                    f"the Hub's answer must be of at most {self.most:,} bytes; it says "
                    f"{shown(size)}"
                )
            answer.stream = _counted(answer.stream, self.come, int(size))

    def pace(self, answer: Any) -> None:
        """Raise ValueError if answers to a push are too large, OSError if one comes too slowly.

        All together are limited, as a list of files can have pages without end.
        """
        _check_wait(answer)
        _check_plain(answer)
        self.come(LEAST)
        begun, before = time.monotonic(), self.arrived

        def come(count: int) -> None:
            self.come(count)
            if self.arrived > LARGEST:
                raise ValueError(f"the Hub's answers have more than {LARGEST:,} bytes")
            if time.monotonic() - begun > download.WAIT * (1 + (self.arrived - before) // LEAST):
                raise OSError(f"fewer than {LEAST:,} bytes came in {download.WAIT:g} seconds")

        come(0)
        answer.stream = _counted(answer.stream, come, sys.maxsize)


def _check_wait(answer: Any) -> None:
    """Raise OSError if the library would wait for long before it asks again."""
    told = [answer.headers.get("Retry-After", "")]
    if answer.status_code == HTTPStatus.TOO_MANY_REQUESTS:  # else it tells how many are left
        told.append(answer.headers.get("RateLimit", ""))
    for seconds in (one for text in told for one in RESET.findall(text.strip())):
        if not answer.is_success and (len(seconds) > MOST_DIGITS or int(seconds) > download.WAIT):
            raise OSError(f"the Hub says {answer.status_code}: wait {brief(seconds)} seconds")


def _check_plain(answer: Any) -> None:
    """Raise ValueError if an answer is compressed."""
    encoding = answer.headers.get("Content-Encoding")
    if encoding not in (None, "identity"):
        raise ValueError(f"the Hub's answer is compressed by {shown(encoding)}, unasked")


def _counted(stream: Any, come: Callable[[int], None], most: int) -> Any:
    """Return the stream, with a call of `come` for the bytes in each part; raise after `most`."""

    class Counted(http().SyncByteStream):  # pyrefly: ignore
        def __iter__(self) -> Iterator[bytes]:
            length = 0
            for part in stream:
                come(len(part))
                if (length := length + len(part)) > most:  # chunks may never end
                    raise ValueError(f"the Hub's answer has more than the {most:,} bytes it says")
                yield part

        def close(self) -> None:
            stream.close()

    return Counted()


def _check_name(what: str, given: str | None, known: re.Pattern[str]) -> None:
    if given is not None and not known.fullmatch(given):
        raise ValueError(
            f"the Hub's answer has a path, or nothing of the Hub, as its {what}: {shown(given)}"
        )


@contextlib.contextmanager
def wary(pushes: bool = False) -> Iterator[Wary]:
    """Check every answer, to a push its size and pace, while other threads wait for their turn."""
    from huggingface_hub import constants, set_client_factory
    from huggingface_hub.utils import _http

    seen = Wary()

    def make() -> Any:
        client = made()
        hooks = {"request": [seen.ask], "response": [seen.pace if pushes else seen.see]}
        client.event_hooks = {n: [*own, *hooks.get(n, ())] for n, own in client.event_hooks.items()}
        return client

    with ONE:
        made = _http._GLOBAL_CLIENT_FACTORY  # of the user's, with their proxies and certificates
        set_client_factory(make)
        # For telemetry it would keep what any Hub sends, and fail for a day where that is odd.
        # Xet's bytes go by another library, which nobody watches, and which waits for minutes.
        unwanted = "HF_HUB_DISABLE_TELEMETRY", "HF_HUB_DISABLE_XET"
        before = {name: getattr(constants, name) for name in unwanted}
        vars(constants).update(dict.fromkeys(unwanted, True))
        try:
            yield seen
        finally:
            vars(constants).update(before)
            set_client_factory(made)


def unreachable() -> tuple[type[Exception], ...]:
    """Return the exceptions of huggingface_hub for missing or broken answers."""
    return (http().RequestError, http().InvalidURL, ConnectionError)


def http() -> Any:
    """Return the HTTP library that huggingface_hub uses."""
    try:
        import httpx2 as http  # pyrefly: ignore
    except ImportError:
        import httpx as http  # pyrefly: ignore
    return http


@contextlib.contextmanager
def reached(repository: str, revision: str | None, what: str, lacking: str) -> Iterator[None]:
    """Translate failures to FileNotFoundError, PermissionError, OSError or ValueError."""
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
        *_, said = (line for line in brief(error).splitlines() if "more information" not in line)
        message = f"{of} cannot be {what}: the Hub says {status}: {said}"
        if status in (401, 403):
            raise PermissionError(f"{message}; see hf auth login, or HF_TOKEN") from error
        raise OSError(message) from error
    except (errors.OfflineModeIsEnabled, *unreachable()) as error:
        onward = "; the same command goes on with what has arrived" * (what == "pulled")
        raise OSError(
            f"{of} cannot be {what}: the connection failed ({brief(error)}){onward}"
        ) from error
    except (LookupError, TypeError, AttributeError, json.JSONDecodeError, RecursionError) as error:
        # of the library, which trusts it
        raise ValueError(f"{of} cannot be {what}: no Hub answers so: {error!r}") from error
    except (OSError, ValueError) as error:
        said = brief(error).partition("\n")[0]  # then the library's advice
        kind = ValueError if isinstance(error, ValueError) else OSError
        raise kind(f"{of} cannot be {what}: {said}") from error
    finally:
        library.setLevel(before)


@contextlib.contextmanager
def _uncovered() -> Iterator[None]:
    """Raise the Hub's error that huggingface_hub wrapped in a RuntimeError."""
    try:
        yield
    except RuntimeError as error:
        if isinstance(error.__cause__, (OSError, ValueError, *unreachable())):
            raise error.__cause__ from error
        raise
