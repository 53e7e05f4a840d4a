"""Class 3: numbers without measure, files without end, servers that go on, levels without a way."""

from __future__ import annotations

import contextlib
import functools
import http.server
import os
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from attack import words
from attack.core import Attempt, Place
from attack.files import PLACED
from attack.readers import READERS
from helpers.flat import kinds

HUGE = 10**60
ENDLESS = ("a pipe", "a device without end", "a full device", "a link to itself", "a terabyte")


def attempts() -> Iterator[Attempt]:
    for name, act in {**_numbers(), **_settings(), **_counts(), **_files()}.items():
        # A list says which it cannot read; a report whose findings lead nowhere is none.
        lenient = "listed" in name or name.startswith("the findings of a report is a link")
        wants = "any" if lenient else "refusal"
        yield Attempt(3, name, act, wants)
    for name, (act, wants) in {**_served(), **_levels(), **_texts()}.items():
        yield Attempt(3, name, act, wants, seconds=45)


def _numbers() -> dict[str, Callable[[Place], Any]]:
    """Every number of every verb, far beyond its bounds."""
    from astray.cli.verbs import VERBS

    def act(verb: str, option: str, value: str, place: Place) -> Any:
        return place.astray(verb, *words.with_option(words.words_of(verb, place), option, value))

    return {
        f"{verb} --{option} {title}": functools.partial(act, verb, option, value)
        for verb in VERBS
        for option, kind, _ in words.options_of(verb)
        if "int" in kind.replace("|", " ").split()
        for title, value in (("of 60 digits", f"{HUGE}"), ("of 5,000 digits", "9" * 5000),
                             ("below all bounds", f"-{HUGE}"))
    }  # fmt: skip


def _settings() -> dict[str, Callable[[Place], Any]]:
    """Every whole number among the settings of a training."""
    from dataclasses import replace

    from astray.training.config import PRESETS

    def act(name: str, value: int, place: Place) -> Any:
        from astray.training.loop import train

        tiny = replace(
            PRESETS["small"],
            variant="corner-small",
            steps=32,
            num_envs=4,
            num_steps=4,
            minibatches=1,
            width=4,
        )
        return train(tiny.changed(**{name: value}), place.work / "there", progress=False)

    return {
        f"settings: {setting} of {title}": functools.partial(act, setting, value)
        for setting, kind in kinds().items()
        if kind in (int, int | None)
        for title, value in (("60 digits", HUGE), ("10^20,000", 10**20_000))
    }


def _counts() -> dict[str, Callable[[Place], Any]]:
    """Counts for which there is neither memory nor time."""

    def made(options: dict[str, Any], _: Place) -> Any:
        from astray.envs.vector import GameVectorEnv

        return GameVectorEnv(**{"game": "maze", "variant": "corner-small"} | options)

    def said(given: tuple[Any, ...], place: Place) -> Any:
        place.copy("run")
        place.copy("actions.txt")
        return place.astray(*given)

    level = ("level", "maze", "corner-small", "--levels")
    tiny = ("train", "maze", "corner-small", "--out", "there")
    found: dict[str, Callable[[Place], Any]] = {
        f"environments: {options}": functools.partial(made, options)
        for options in (
            {"num_envs": 10**9},
            {"num_envs": 2**31},
            {"threads": 10**6},
            {"num_envs": 10**8, "observation": "symbolic"},
            {"num_envs": 2**63},
        )
    }
    return found | {
        f"counts: {' '.join(map(str, given))[:70]}": functools.partial(said, given)
        for given in (
            (*level, "0:9999999999"), (*level, "0:2147483647"), (*level, "0:1," * 100_000),
            (*level, f"0:{HUGE}"), (*level, f"{HUGE}"), (*level, "-1:5"), (*level, ":" * 1000),
            ("evaluate", "run", "--levels", "0:100000000"),
            ("evaluate", "run", "--levels", "0:2", "--batch", "10000000000"),
            ("export", "run", "--levels", "0:2000000000"),
            ("overlap", "maze", "corner-small", "corner-small", "--test-levels", "0:999999999"),
            (*tiny, "--num-envs", "1000000000"), (*tiny, "--num-steps", "1000000000"),
            (*tiny, "--width", "10000000"), (*tiny, "--num-levels", "2147483647"),
            (*tiny, "--buffer", "2000000000", "--num-levels", "2000000000", "--sampler", "plr"),
            (*tiny, "--num-envs", "100000", "--num-steps", "100000"),
            ("record", "maze-corner", "--pixels", "100000"),
            ("sweep", "maze", "corner-small", "--set", "seed=" + ",".join(map(str, range(20_000)))),
            ("sweep", "maze", "corner-small", "--set", "width=" + ",".join(
                map(str, range(1, 20_000)))),
            ("sweep", "maze", "corner-small", "--set", "width=8", "--seeds", "100000000"),
            ("lab", "maze-corner", "--export", "page", "--num-levels", "1000000"),
            ("explain", "maze-corner", "--num-levels", "1000000"),
            ("level", "maze", "corner", "--set", "world=1000000"),
            ("level", "maze", "corner", "--set", "world=" + "9" * 5000),
            ("level", "maze", "corner", "--set", "time_limit=" + "[" * 100_000),
            ("level", "coinrun", "coin-end", "--set", "sections=1000000000"),
            ("level", "keys", "many-chests", "--set", "keys=1000000000"),
        )
    }  # fmt: skip


def _files() -> dict[str, Callable[[Place], Any]]:
    """Everything that is read, as what has no end, or nobody ever writes to."""

    def act(reader: str, how: str, place: Place) -> Any:
        path, use = READERS[reader](place)
        if path.is_dir():
            raise OSError("a folder is read; its files are others of these")
        path.unlink()
        if how == "a terabyte":
            os.link(place.made.parent / "terabyte", path)
        else:
            PLACED[how](path)
        place.watch()
        return use(place)

    return {
        f"{reader} is {how}": functools.partial(act, reader, how)
        for reader in READERS
        for how in ENDLESS
    }


class _Endless(http.server.BaseHTTPRequestHandler):
    """A server that never comes to an end, each way by its own path."""

    def log_message(self, *_: Any) -> None:
        pass

    def do_GET(self) -> None:
        how = self.path.strip("/").split("/")[0]
        with contextlib.suppress(OSError):
            getattr(self, f"_{how}")()

    do_HEAD = do_POST = do_GET

    def _headers(self) -> None:
        self.wfile.write(b"HTTP/1.1 200 OK\r\n")
        while True:
            self.wfile.write(b"X-More: and more\r\n" * 1000)

    def _status(self) -> None:
        while True:
            self.wfile.write(b"H" * 10_000)

    def _body(self) -> None:
        self._begin()
        while True:
            self.wfile.write(b"0" * 65536)

    def _length(self) -> None:
        self._begin(Content_Length="9" * 60)
        self.wfile.write(b"0")

    def _negative(self) -> None:
        self._begin(Content_Length="-1")
        self.wfile.write(b"0" * 100)

    def _chunks(self) -> None:
        self._begin(Transfer_Encoding="chunked")
        self.wfile.write(b"f" * 10_000 + b"\r\n")

    def _redirect(self) -> None:
        self.send_response(302)
        self.send_header("Location", self.path)
        self.end_headers()

    def _elsewhere(self) -> None:
        self.send_response(302)
        self.send_header("Location", "file:///etc/passwd")
        self.end_headers()

    def _range(self) -> None:
        self.send_response(206)
        self.send_header("Content-Range", "bytes 5-9/10")
        self.end_headers()
        self.wfile.write(b"0" * 5)

    def _error(self) -> None:
        self.send_response(500)
        self.end_headers()

    def _continue(self) -> None:
        while True:
            self.wfile.write(b"HTTP/1.1 100 Continue\r\n\r\n" * 100)

    def _gzip(self) -> None:
        self._begin(Content_Encoding="gzip", Content_Length="20")
        self.wfile.write(b"no gzip at all, none")

    def _begin(self, **headers: str) -> None:
        self.send_response(200)
        for name, value in headers.items():
            self.send_header(name.replace("_", "-"), value)
        self.end_headers()


WAYS = tuple(
    name[1:] for name in vars(_Endless) if name[0] == "_" and name[1] != "_" and name != "_begin"
)


def _served() -> dict[str, tuple[Callable[[Place], Any], Any]]:
    """Downloads from such a server: of an agent of the catalogue, and of the Hub."""

    def act(how: str, hub: bool, place: Place) -> Any:
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), _Endless)
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://127.0.0.1:{server.server_port}/{how}"
        if hub:
            from astray.experiments.hub import pull

            return pull("ada/mouse", name="mouse", endpoint=address)
        from astray.published.download import download

        return download(address, place.work / "file", size=1000, digest="0" * 64)

    return {
        f"{'the Hub' if hub else 'a download'} from a server: {how}": (
            functools.partial(act, how, hub),
            "refusal",
        )
        for how in WAYS
        for hub in (False, True)
        if not (hub and how == "continue")  # a Hub that one has named is waited for
    }


def _levels() -> dict[str, tuple[Callable[[Place], Any], Any]]:
    """Levels without a way to what they hold, and such as are all open, solved."""
    from attack.material import SMALLEST

    def act(game: str, how: str, place: Place) -> Any:
        path = place.copy(f"{game}.txt")
        text = path.read_text()
        wall, open_ = {"maze": ("#", "."), "keys": ("#", "."), "coinrun": ("#", ".")}[game]
        changed = {
            "walled in": text.replace(open_, wall),
            "all open": text.replace(wall, open_),
            "a row twice": text.split("\n", 1)[0] + "\n" + text,
            "a hundred times": text * 100,
            "of 100,000 rows": text.split("\n", 1)[0] * 100_000,
        }[how]
        path.write_text(changed)
        return place.astray(
            "replay",
            game,
            SMALLEST[game],
            "--level-file",
            path,
            "--unsolvable",
            "--actions",
            place.made / "actions.txt",
        )

    return {
        f"a level of {game} that is {how}": (functools.partial(act, game, how), "any")
        for game in SMALLEST
        for how in ("walled in", "all open", "a row twice", "a hundred times", "of 100,000 rows")
    }


def _texts() -> dict[str, tuple[Callable[[Place], Any], Any]]:
    """Long texts for what reads words."""

    def actions(text: str, place: Place) -> Any:
        place.mine("long.txt", text)
        return place.astray(
            "replay", "maze", "corner-small", "--level", "0", "--actions", "long.txt"
        )

    def asked(text: str, _: Place) -> Any:
        from astray.lab.messages import read

        return read(text)

    found: dict[str, tuple[Callable[[Place], Any], Any]] = {
        "a million actions": (functools.partial(actions, "up " * 300_000), "any"),
        "an action of a megabyte": (functools.partial(actions, "u" * 2**20), "refusal"),
        "a number of a megabyte": (functools.partial(actions, "9" * 2**20), "refusal"),
        "actions that are brackets": (functools.partial(actions, "[" * 2**20), "any"),
    }
    for name, text in {
        "of brackets": "[" * 2**17,
        "of objects": '{"a":' * 2**15,
        "of one number": '{"id": ' + "9" * 2**17 + "}",
        "too long": "x" * 2**19,
        "of a text": '"' + "\\u0000" * 2**14 + '"',
    }.items():
        found[f"a message {name}"] = (functools.partial(asked, text), "refusal")
    return found


def make_terabyte(kept: Path) -> None:
    """A file of a terabyte that takes no room, beside what attempts are made with."""
    with open(kept / "terabyte", "wb") as file:
        file.truncate(2**40)
