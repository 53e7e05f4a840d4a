"""The lab's server answers this machine's own page, and nobody else."""

import json

import pytest

pytest.importorskip("starlette", reason="starlette is not installed")
pytest.importorskip("websockets", reason="websockets is not installed")

import asyncio
import contextlib
import logging
import re
import socket
import threading
import urllib.error
import urllib.request
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from urllib.parse import urlsplit

from starlette.websockets import WebSocketDisconnect
from websockets.asyncio.client import connect
from websockets.exceptions import ConnectionClosedError, InvalidStatus

from astray.lab import server, session
from astray.lab.server import Bucket, Conversation, files
from astray.lab.session import Session
from helpers.browsed import usual_lab


def run(coroutine):
    """The result of a coroutine, run in a thread: a browser's tests keep a loop in this one."""
    with ThreadPoolExecutor(1) as thread:
        return thread.submit(asyncio.run, coroutine).result()


def fetched(address, path="", host=None):
    request = urllib.request.Request(address + path, headers={"Host": host} if host else {})
    try:
        with urllib.request.urlopen(request) as answer:
            return answer.status, dict(answer.headers), answer.read()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, dict(error.headers), error.read()


def test_the_page_runs_no_script_but_its_own(served):
    status, headers, body = fetched(served)
    policy = headers["content-security-policy"]
    assert status == 200 and b"<script type" in body
    assert "script-src 'self';" in policy and "default-src 'none'" in policy
    assert "unsafe" not in policy and b"<style" not in body and b" style=" not in body


def test_every_file_of_the_page_is_served_and_nothing_else(served):
    told = {path: fetched(served, path) for path in files()}
    assert all(status == 200 for status, *_ in told.values())
    kept = {
        path for path, (_, headers, _) in told.items() if headers["cache-control"] != "no-store"
    }
    assert kept == {*files()} - {"index.html"}  # a new server has another address
    for path in ("../server.py", "..%2Fserver.py", "%2e%2e/server.py", "lab.py", "/etc/passwd"):
        assert fetched(served, path)[0] == 404


@contextlib.contextmanager
def logged():
    """The server's records in the meantime."""
    records = []

    class Kept(logging.Handler):
        def emit(self, record):
            records.append(record)

    logger, kept = logging.getLogger("uvicorn.error"), Kept()
    logger.addHandler(kept)
    try:
        yield records
    finally:
        logger.removeHandler(kept)


def test_text_that_is_no_utf8_ends_the_page_and_is_logged_in_a_line(served):
    async def spoilt():
        parts = urlsplit(served)
        address = f"ws://{parts.netloc}{parts.path}socket"
        async with connect(address, origin=f"http://{parts.netloc}") as socket:
            await socket.send(b"\xff\xfe", text=True)
            with pytest.raises(ConnectionClosedError, match="1007"):
                await asyncio.wait_for(socket.recv(), 60)

    with logged() as records:
        run(spoilt())
    assert all(record.exc_info is None for record in records)
    assert fetched(served)[0] == 200


def test_a_request_whose_body_is_none_is_logged_in_lines(served):
    parts = urlsplit(served)
    head = (
        f"POST {parts.path} HTTP/1.1\r\nHost: {parts.netloc}\r\nTransfer-Encoding: chunked\r\n\r\n"
    )
    with logged() as records, socket.create_connection((parts.hostname, parts.port)) as sent:
        sent.sendall(head.encode() + b"zz\r\n")
        assert sent.recv(100).startswith(b"HTTP/1.1 400")
        assert fetched(served)[0] == 200
    assert records and all(record.exc_info is None for record in records)


class Leaving:
    """A page that asks, and has left before the answer."""

    def __init__(self):
        self.asked, self.left = False, asyncio.Event()

    async def receive_text(self):
        if not self.asked:
            self.asked = True
            return '{"id": 1, "kind": "hello"}'
        await self.left.wait()
        raise RuntimeError('WebSocket is not connected. Need to call "accept" first.')

    async def send_text(self, text):
        self.left.set()
        raise WebSocketDisconnect(1006)


class Left:
    """A page that asks, and leaves while others are answered."""

    asked = False

    async def receive_text(self):
        if self.asked:
            await asyncio.sleep(0.2)
            raise WebSocketDisconnect(1001)
        self.asked = True
        return '{"id": 1, "kind": "hello"}'


def test_nothing_is_computed_for_a_page_that_has_left():
    """Else Ctrl+C waits for the answers to all pages that were open."""
    computed = []

    class Computing:
        def answers(self, text):
            computed.append(text)
            yield {"id": 1, "done": True}

    lab = SimpleNamespace(lock=threading.Lock())

    async def leave():
        with lab.lock:
            await asyncio.wait_for(Conversation(Left(), Computing(), lab).hold(), 60)

    run(leave())
    assert not computed


def test_a_page_that_leaves_amid_an_answer_ends_its_conversation():
    lab = usual_lab()
    run(asyncio.wait_for(Conversation(Leaving(), Session(lab), lab).hold(), 60))


def test_the_address_is_told_when_somebody_listens_there(monkeypatch):
    import uvicorn

    heard = []

    def told(text, **_):
        address = urlsplit(re.search(r"http\S+", text)[0])
        with socket.create_connection((address.hostname, address.port), 5):
            heard.append(address.port)

    monkeypatch.setattr(server, "print", told, raising=False)
    monkeypatch.setattr(uvicorn.Server, "run", lambda *_, sockets: sockets[0].close())
    server.serve(usual_lab(), 0, browse=False)
    assert len(heard) == 1


def test_without_the_token_there_is_nothing(served):
    root = "{0.scheme}://{0.netloc}/".format(urlsplit(served))
    assert fetched(root)[0] == fetched(root, "index.html")[0] == fetched(root, "wrong/")[0] == 404


def test_another_name_for_this_machine_is_refused(served):
    assert fetched(served, host="evil.example:80")[0] == 404


async def asked(address, *messages, origin=...):
    """The answers over a socket, as a page of that origin gets them."""
    parts = urlsplit(address)
    here = f"http://{parts.netloc}" if origin is ... else origin
    async with connect(f"ws://{parts.netloc}{parts.path}socket", origin=here) as socket:
        for message in messages:
            await socket.send(message)
        answers = []
        while sum(bool(a.get("done")) for a in answers) < len(messages):
            answers.append(json.loads(await asyncio.wait_for(socket.recv(), 60)))
        return answers


@pytest.mark.parametrize("origin", ["http://evil.example", None, "null"])
def test_pages_of_other_sites_are_refused(served, origin):
    with pytest.raises(InvalidStatus):
        run(asked(served, '{"id": 1, "kind": "hello"}', origin=origin))


def test_a_question_is_answered(served):
    (answer,) = run(asked(served, '{"id": 1, "kind": "hello"}'))
    assert "maze" in answer["games"]


def test_junk_is_answered_with_what_is_wrong_and_the_socket_stays(served):
    junk = ["", "{", "[]", "null", '{"id": 9}', "\x00" * 10]
    answers = run(asked(served, *junk, '{"id": 3, "kind": "art", "game": "maze"}'))
    assert all("error" in answer for answer in answers[:-1]) and "mouse" in answers[-1]["pictures"]


def test_a_mistake_of_the_lab_itself_ends_the_answer_to_its_question_alone(served, monkeypatch):
    def fails(*_):
        raise ZeroDivisionError("nobody reckoned with this")

    monkeypatch.setattr(session, "ANSWERS", {**session.ANSWERS, "level": fails})
    words = {"game": "maze", "variant": "corner-small"}
    questions = [
        {"id": 41, "kind": "level", "level": 3, **words},
        {"id": 42, "kind": "art", **words},
    ]
    first, second = run(asked(served, *map(json.dumps, questions)))
    assert first["id"] == 41 and "the lab itself failed: ZeroDivision" in first["error"]
    assert second["id"] == 42 and "mouse" in second["pictures"]


def test_of_many_like_questions_the_last_is_answered(served):
    question = {
        "kind": "fields",
        "game": "maze",
        "variant": "anywhere-small",
        "slot": "own",
        "agent": "maze-corner",
    }
    many = [json.dumps(question | {"id": k, "level": k}) for k in range(40)]
    answers = run(asked(served, *many))
    last = [answer for answer in answers if answer["id"] == 39]
    assert last[-1]["done"] and last[-1]["cells"]
    assert all("error" not in answer for answer in answers)


def test_messages_that_come_too_fast_wait():
    bucket = Bucket(rate=100, most=10)
    waits = [bucket.wait() for _ in range(60)]
    assert not any(waits[:10]) and 0.4 < waits[-1] < 0.51
