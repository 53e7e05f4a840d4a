"""The lab's server: the page's files and one WebSocket, for this machine alone.

It listens on the loopback interface. The page's address contains a random token. Requests from
pages of other sites, or through rebound names, are refused by Origin and Host. A
Content-Security-Policy restricts what the page may load and run.
"""

import asyncio
import importlib
import json
import logging
import secrets
import time
import webbrowser
from collections.abc import Iterator
from contextlib import suppress
from typing import Any

from astray import imports
from astray.lab import constants
from astray.lab.messages import LARGEST, number_of, read
from astray.lab.session import Lab, Session
from astray.lab.worlds import PAGE

LOOPBACK = "127.0.0.1"
TYPES = {".html": "text/html", ".css": "text/css", ".js": "text/javascript"}
MOST_PAGES = 16  # at a time
A_SECOND, AT_ONCE = 120, 240  # messages of a page that are read: in the long run, and suddenly
WAITING = 64  # messages of a page that wait; of more, the oldest are given up
LEAVE = 1.0  # seconds that open pages have when the server ends


class Bucket:
    """Bucket of `most` tokens, refilled with `rate` a second, that limits a rate."""

    def __init__(self, rate: float, most: float):
        self.rate, self.most, self.left, self.seen = rate, most, most, time.monotonic()

    def wait(self) -> float:
        """Take one token; return the seconds until it is available."""
        now = time.monotonic()
        self.left = min(self.most, self.left + (now - self.seen) * self.rate) - 1
        self.seen = now
        return max(0.0, -self.left / self.rate)


def files() -> dict[str, tuple[bytes, str]]:
    """Read everything that is served: path -> bytes and type."""
    found = {
        path.relative_to(PAGE).as_posix(): (path.read_bytes(), TYPES[path.suffix])
        for path in sorted(PAGE.rglob("*"))
        if path.suffix in TYPES
    }
    return found | {constants.PATH: (constants.module(), TYPES[".js"])}


def make_app(lab: Lab, token: str, port: int) -> Any:
    """Return the ASGI application.

    Args:
        token: First part of all addresses.
        port: Its port, which Host and Origin must name.

    Raises:
        ImportError: If starlette and uvicorn are not installed.
    """
    _check_installed()
    logging.getLogger("uvicorn.error").addFilter(_in_one_line)
    from starlette.applications import Starlette
    from starlette.responses import Response
    from starlette.routing import Route, WebSocketRoute

    served = files()
    hosts = {f"{name}:{port}" for name in (LOOPBACK, "localhost")}
    origins = {f"http://{host}" for host in hosts}
    sockets = " ".join(sorted(f"ws://{host}" for host in hosts))
    policy = (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data: blob:; "
        f"connect-src 'self' {sockets}; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    pages: set[Any] = set()

    async def file(request: Any) -> Any:
        path = request.path_params["path"] or "index.html"
        known = secrets.compare_digest(request.path_params["token"].encode(), token.encode())
        if request.headers.get("host") not in hosts or not known or path not in served:
            return Response("there is nothing here", 404, {"Content-Security-Policy": policy})
        data, kind = served[path]
        kept = "no-store" if kind == TYPES[".html"] else "private, max-age=3600"  # by this token
        headers = {
            "Cache-Control": kept,
            "Content-Security-Policy": policy,
            "Cross-Origin-Resource-Policy": "same-origin",
            "Referrer-Policy": "no-referrer",
            "X-Content-Type-Options": "nosniff",
        }
        return Response(data, media_type=kind, headers=headers)

    async def socket(page: Any) -> None:
        known = secrets.compare_digest(page.path_params["token"].encode(), token.encode())
        headers = page.headers
        if not known or headers.get("host") not in hosts or headers.get("origin") not in origins:
            await page.close(1008)
            return
        if len(pages) >= MOST_PAGES:
            await page.close(1013)
            return
        await page.accept()
        pages.add(page)
        try:
            await Conversation(page, Session(lab), lab).hold()
        finally:
            pages.discard(page)

    routes = [WebSocketRoute("/{token}/socket", socket), Route("/{token}/{path:path}", file)]
    return Starlette(routes=routes)


def _in_one_line(record: logging.LogRecord) -> bool:
    """Log invalid UTF-8 or HTTP from a page without a traceback: the error is not the lab's."""
    kind = type(record.exc_info[1]).__name__ if record.exc_info else ""
    if kind in ("UnicodeDecodeError", "LocalProtocolError"):  # h11's, of a body that is none
        record.exc_info = None
    return True


class Conversation:
    """Messages of one page, answered one after the other.

    A newer question of the same kind and slot cancels an older one.
    """

    def __init__(self, page: Any, session: Session, lab: Lab):
        self.page, self.session, self.lab = page, session, lab
        self.bucket = Bucket(A_SECOND, AT_ONCE)
        self.waiting: list[str] = []
        self.left = False  # whether nobody waits for answers
        self.newest: dict[tuple[str, str], int] = {}
        self.came = asyncio.Event()

    async def hold(self) -> None:
        """Answer messages until the page leaves."""
        from starlette.websockets import WebSocketDisconnect

        answering = asyncio.create_task(self._answer())
        try:
            while True:
                text = await self.page.receive_text()
                await asyncio.sleep(self.bucket.wait())
                self._note(text)
                self.waiting = [*self.waiting[-WAITING + 1 :], text]
                self.came.set()
        # KeyError: bytes, where text was expected; RuntimeError: it left while it was answered
        except (WebSocketDisconnect, KeyError, RuntimeError):
            pass
        finally:
            self.left = True
            answering.cancel()
            with suppress(asyncio.CancelledError, WebSocketDisconnect, RuntimeError):
                await answering

    def _note(self, text: str) -> None:
        with suppress(ValueError, RecursionError):
            message = read(text)
            self.newest[message.kind, message.slot] = message.id

    def _is_stale(self, text: str) -> bool:
        with suppress(ValueError, RecursionError):
            message = read(text)
            return self.newest.get((message.kind, message.slot), message.id) != message.id
        return False

    async def _answer(self) -> None:
        while True:
            await self.came.wait()
            await self._answer_waiting()
            self.came.clear()

    async def _answer_waiting(self) -> None:
        while self.waiting:
            text = self.waiting.pop(0)
            if self._is_stale(text):
                await self._send({"id": number_of(text), "done": True, "stale": True})
            else:
                await self._answer_one(text)

    async def _answer_one(self, text: str) -> None:
        answers: Any = self.session.answers(text)
        while (part := await asyncio.to_thread(self._next, answers)) is not None:
            await self._send(part)
            if "rows" in part:  # probes take long, and nothing that others change
                await self._answer_waiting()
            if not part.get("done") and self._is_stale(text):
                await self._send({"id": number_of(text), "done": True, "stale": True})
                answers.close()
                return

    def _next(self, answers: Iterator[dict[str, Any]]) -> dict[str, Any] | None:
        """Return the next part of an answer; None at its end."""
        with self.lab.lock:
            return None if self.left else next(answers, None)

    async def _send(self, part: dict[str, Any]) -> None:
        await self.page.send_text(json.dumps(part))


def serve(lab: Lab, port: int, browse: bool) -> None:
    """Serve the lab until it is interrupted, and open its page in the browser.

    Args:
        port: 0 for any free port.

    Raises:
        ImportError: If starlette and uvicorn are not installed.
        OSError: If the port is in use.
    """
    _check_installed()
    import socket

    import uvicorn

    try:
        listener = socket.create_server((LOOPBACK, port))  # from here on browsers are heard
    except OSError as error:
        said = (error.strerror or "").partition(" (")[0]
        raise OSError(f"cannot listen on port {port} of {LOOPBACK}: {said}") from None
    port, token = listener.getsockname()[1], secrets.token_urlsafe(24)
    address = f"http://{LOOPBACK}:{port}/{token}/"
    config = uvicorn.Config(
        make_app(lab, token, port),
        log_level="warning",
        ws_max_size=4 * LARGEST,
        lifespan="off",
        access_log=False,
        timeout_graceful_shutdown=int(LEAVE),
        server_header=False,
    )
    print(f"The lab is at {address}\nIt ends with Ctrl+C.", flush=True)
    if browse:
        webbrowser.open(address)
    uvicorn.Server(config).run(sockets=[listener])


def _check_installed() -> None:
    with imports.extra("lab", "the lab needs starlette, uvicorn and websockets"):
        for name in ("starlette", "uvicorn", "websockets"):
            importlib.import_module(name)
