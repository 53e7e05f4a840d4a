"""Verified downloads that can be resumed.

Two processes that download the same file take turns, and only verified bytes are put in place.
"""

import contextlib
import errno
import hashlib
import http.client
import os
import socket
import threading
import time
import urllib.request
from collections.abc import Callable
from concurrent.futures import Future, wait
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from astray.files import check_own, hold, read, remove_left, write_aside
from astray.validation import shown

CHUNK = 1 << 16  # bytes
WAIT = 30.0  # seconds without a byte, after which it is interrupted
LEAST = 10_000  # bytes in that time; with fewer it is, too
LOOPBACK = ("127.0.0.1", "::1", "localhost")
BLOB = 40  # hexadecimal digits of git's blob id; a SHA-256 has 64
MOST_DIGITS = 20  # of a length that a server tells
LARGEST = 512_000_000  # bytes, of a file whose size is not known
T = TypeVar("T")


def download(address: str, to: Path, *, size: int | None, digest: str | None) -> None:
    """Download a file to `to` and verify its size and digest.

    Partial data are kept in `to`.part and resumed by a later call. Without a digest the download
    starts anew, because the parts could belong to different files. If another process downloads to
    this folder, wait for it, and keep the file if it is the right one.

    Args:
        digest: SHA-256 (64 hexadecimal digits) or git's blob id (40); None if unknown.

    Raises:
        OSError: If the download is interrupted, or `to` is something else, which stays.
        ValueError: If another file arrives, which is removed.
    """
    _check_address(address)
    with hold(to.parent, "downloads to"):
        remove_left(to.parent, (to.name,))
        if os.path.lexists(to):
            if digest and not to.is_symlink() and digest_of(read(to, LARGEST), digest) == digest:
                return
            raise OSError(f"{to} is there already, and stays as it is; to download it, remove that")
        part = to.with_name(to.name + ".part")
        check_own(part)
        if digest is None:
            part.unlink(missing_ok=True)
        try:
            _fetch(address, part, size or LARGEST)
        except (OSError, ValueError, http.client.HTTPException) as error:  # also of addresses
            if getattr(error, "errno", None) in (errno.ENOSPC, errno.EDQUOT):
                part.unlink(missing_ok=True)  # else it would hold all the room that there is
                told = f"{os.strerror(errno.ENOSPC)}; nothing was written"
                raise OSError(errno.ENOSPC, told, str(to)) from error
            arrived = part.stat().st_size if part.exists() else 0
            of = f" of {size:,}" if size else ""
            raise OSError(
                f"{address} could not be downloaded ({shown(str(error))}); {arrived:,}{of} bytes "
                "are there, and the same command goes on from them"
            ) from error
        data = _checked(address, part, size, digest)
        part.unlink()  # before, as a disk may have room for one of them
        write_aside(to, data)


def digest_of(data: bytes, like: str) -> str:
    """Return the digest of a file's bytes, of the same kind as the digest `like`.

    Git's blob id is the SHA-1 of the file after a header. It pins files that could not be
    downloaded here; one who can forge a SHA-1 could forge such a file.
    """
    if len(like) == BLOB:
        return hashlib.sha1(b"blob %d\0" % len(data) + data, usedforsecurity=False).hexdigest()
    return hashlib.sha256(data).hexdigest()


def _fetch(address: str, part: Path, most: int) -> None:
    """Append the missing bytes of the file at `address` to `part`."""
    begun = part.stat().st_size if part.exists() else 0
    if begun >= most:
        return
    request = urllib.request.Request(address, headers={"Accept-Encoding": "identity"})
    if begun:
        request.add_header("Range", f"bytes={begun}-")
    with _answer(request) as answer:
        _check_address(answer.geturl())  # where it was sent on to
        if answer.status == http.client.REQUESTED_RANGE_NOT_SATISFIABLE:
            return  # the part is whole
        goes_on = answer.status == http.client.PARTIAL_CONTENT
        if goes_on and not (answer.headers["Content-Range"] or "").startswith(f"bytes {begun}-"):
            raise OSError(f"it answers with another part, {answer.headers['Content-Range']}")
        begun = begun if goes_on else 0
        left = most - begun
        since, before = time.monotonic(), left
        with open(part, "ab" if goes_on else "wb") as file:
            while left and (data := answer.read1(min(CHUNK, left))):
                file.write(data)
                left -= len(data)
                if left and time.monotonic() - since > WAIT:
                    if before - left < LEAST:  # a byte now and then would go on for years
                        raise OSError(f"fewer than {LEAST:,} bytes came in {WAIT:g} seconds")
                    since, before = time.monotonic(), left
        length = answer.headers["Content-Length"] or "0"
        promised = begun + (int(length) if length.isdecimal() and len(length) < MOST_DIGITS else 0)
        if left and promised > most - left:
            raise OSError(f"the connection ended {promised - most + left:,} bytes early")


def _answer(request: urllib.request.Request) -> http.client.HTTPResponse:
    """Return the head of the server's answer, with a time limit for all of it.

    It runs in its own thread: a server can send `100 Continue` for ever, and http.client listens.
    """
    opened: list[http.client.HTTPConnection] = []
    given_up = threading.Event()

    def keep(kind: type[http.client.HTTPConnection]) -> Callable[..., http.client.HTTPConnection]:
        class Kept(kind):  # pyrefly: ignore
            def connect(self) -> None:
                opened.append(self)
                super().connect()
                if given_up.is_set():  # while it connected, so that `stop` had nothing to shut down
                    raise OSError("this answer is no longer waited for")

        return Kept

    class Plain(urllib.request.HTTPHandler):
        def http_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
            return self.do_open(keep(http.client.HTTPConnection), req)

    class Secure(urllib.request.HTTPSHandler):
        def https_open(self, req: urllib.request.Request) -> http.client.HTTPResponse:
            return self.do_open(keep(http.client.HTTPSConnection), req)

    class Onward(urllib.request.HTTPRedirectHandler):
        def http_error_302(self, req: Any, fp: Any, code: Any, msg: Any, headers: Any) -> Any:
            with fp:  # which would stay open where it sends on to no address
                return super().http_error_302(req, fp, code, msg, headers)

        def http_error_416(self, req: Any, fp: Any, *_: Any) -> Any:
            return fp if req.has_header("Range") else None  # None: it is raised

        http_error_301 = http_error_303 = http_error_307 = http_error_308 = http_error_302

    def ask() -> http.client.HTTPResponse:
        return urllib.request.build_opener(Plain, Secure, Onward).open(request, timeout=WAIT)

    def stop() -> None:
        given_up.set()
        for connection in opened:  # else the thread would listen on
            if connection.sock:
                with contextlib.suppress(OSError):
                    connection.sock.shutdown(socket.SHUT_RDWR)

    return in_time(ask, stop)


def in_time(ask: Callable[[], T], stop: Callable[[], None], arrived: Callable[[], int] = int) -> T:
    """Return the result of `ask`, which runs in a thread, as long as enough bytes arrive.

    Args:
        ask: Function that asks a server.
        stop: Function that ends the request, called if it is given up.
        arrived: Function that returns the number of bytes received so far.

    Raises:
        OSError: If fewer than `LEAST` bytes arrive in `WAIT` seconds.
    """
    came: Future[T] = Future()

    def run() -> None:
        try:
            came.set_result(ask())
        except BaseException as error:
            came.set_exception(error)

    threading.Thread(target=run, daemon=True).start()
    try:
        while not came.done():
            before = arrived()
            wait([came], WAIT)
            if not came.done() and (more := arrived() - before) < LEAST:
                what = f"fewer than {LEAST:,} bytes" if more else "no answer"
                raise OSError(f"{what} came in {WAIT:g} seconds")
        return came.result()
    finally:
        if not came.done():  # also after an interrupt
            stop()


def _checked(address: str, part: Path, size: int | None, digest: str | None) -> bytes:
    """Return the downloaded bytes if their size and digest are right."""
    data = read(part, LARGEST)
    if size is not None and len(data) < size:
        raise OSError(
            f"{address} ended after {len(data):,} of {size:,} bytes; the same command tries again"
        )
    if digest is not None and (found := digest_of(data, digest)) != digest:
        part.unlink()
        kind = "git blob id" if len(digest) == BLOB else "SHA-256"
        raise ValueError(
            f"{address} is not the file that was published: its {kind} is {found}, not {digest}; "
            "it was removed, and nothing is imported"
        )
    return data


def _check_address(address: str) -> None:
    """Raise ValueError if the address is not protected from changes on the way."""
    parts = urlsplit(address)
    if parts.scheme != "https" and not (parts.scheme == "http" and parts.hostname in LOOPBACK):
        raise ValueError(f"an address must be https; got {address}")
