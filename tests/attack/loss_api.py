"""Class 1: what is removed or written over must be astray's own; functions, links and kills."""

from __future__ import annotations

import functools
import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from attack.core import Attempt, Place, Wrong
from attack.loss import HEX


def attempts() -> Iterator[Attempt]:
    for name, act in (_written() | _killed() | _downloads() | _homes() | _removed()).items():
        yield Attempt(1, name, act, "any", seconds=60)


def _states(place: Place) -> Any:
    from astray.envs.states import load_states

    return load_states(place.made / "maze.npz", "maze")


def _save(path: Path, place: Place) -> None:
    from astray.envs.states import save_states

    save_states(path, "maze", _states(place))


def _table(path: Path, place: Place) -> None:
    import polars as pl

    from astray.analysis.tables import write_table

    write_table(pl.DataFrame({"a": [1]}), path)


def _video(path: Path, place: Place) -> None:
    from astray.analysis.video import write_gif

    write_gif(np.zeros((2, 32, 32, 3), np.uint8), path)


def _activations(path: Path, place: Place) -> None:
    import polars as pl

    from astray.insight.activations import Activations

    Activations({"a": np.zeros((2, 3), np.float32)}, pl.DataFrame({"b": [1, 2]})).save(path)


def _figure(path: Path, place: Place) -> None:
    from matplotlib.figure import Figure

    from astray.figures.style import save

    save(Figure(), path.parent, path.stem)


def _bytes(path: Path, place: Place) -> None:
    from astray.files import write_aside

    write_aside(path, b"new")


FUNCTIONS: dict[str, tuple[str, Callable[[Path, Place], None]]] = {
    "states": ("there.npz", _save), "a table": ("there.parquet", _table),
    "a table as text": ("there.csv", _table), "a video": ("there.gif", _video),
    "activations": ("there.npz", _activations), "a figure": ("there.png", _figure),
    "bytes": ("there", _bytes),
}  # fmt: skip


def _written() -> dict[str, Callable[[Place], Any]]:
    """Functions that write a file, where there is something else."""

    def act(name: str, lay: Callable[[Place, Path], Any], place: Place) -> Any:
        file, write = FUNCTIONS[name]
        path = place.work / file
        lay(place, path)
        place.watch()
        return write(path, place)

    laid: dict[str, Callable[[Place, Path], Any]] = {
        "a link to a file": lambda place, path: (
            place.mine("kept"),
            path.symlink_to(place.work / "kept"),
        ),
        "a link to nothing": lambda place, path: path.symlink_to(place.work / "gone"),
        "a folder": lambda place, path: place.mine(path / "notes.txt"),
        "a pipe": lambda place, path: os.mkfifo(path),
        "temporaries beside it": lambda place, path: (
            place.mine(path.with_name(f".{path.name}.{HEX}")),
            place.mine(f".{path.name}"),
            place.mine(f"{path.name}.tmp"),
            place.mine(f"{path.name}.part"),
        ),
    }
    return {
        f"{name}, where there is {title}": functools.partial(act, name, lay)
        for name in FUNCTIONS
        for title, lay in laid.items()
    }


def _killed() -> dict[str, Callable[[Place], Any]]:
    """Kills at each step of writing: the old file or the new one is there, and whole."""

    def act(name: str, step: str, place: Place) -> None:
        file, write = FUNCTIONS[name]
        path = place.work / file
        if not (first := os.fork()):  # its threads, of Polars, would be missing in the second fork
            write(path, place)
            os._exit(0)
        os.waitpid(first, 0)
        old = path.read_bytes()
        place.mine("beside.txt")
        child = os.fork()
        if not child:
            setattr(os, step, lambda *_, **__: os.kill(os.getpid(), signal.SIGKILL))
            write(path, place)
            os._exit(0)
        _, status = os.waitpid(child, 0)
        if not os.WIFSIGNALED(status):
            raise Wrong(f"{step} was not called")
        if path.read_bytes() != old and name not in ("a figure", "a video"):
            raise Wrong("the file is neither the old one nor the new one")

    return {
        f"{name}, killed at {step}": functools.partial(act, name, step)
        for name in FUNCTIONS
        for step in ("fsync", "replace")
    }


def _downloads() -> dict[str, Callable[[Place], Any]]:
    """Downloads to where something of the user's lies."""
    import http.server
    import threading

    class Server(http.server.BaseHTTPRequestHandler):
        def log_message(self, *_: Any) -> None:
            pass

        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Length", "3")
            self.end_headers()
            self.wfile.write(b"new")

    def served() -> str:
        server = http.server.ThreadingHTTPServer(("127.0.0.1", 0), Server)
        server.daemon_threads = True
        threading.Thread(target=server.serve_forever, daemon=True).start()
        return f"http://127.0.0.1:{server.server_port}/file.pth"

    def act(lay: Callable[[Place, Path], Any], known: bool, place: Place) -> Any:
        import hashlib

        from astray.published.download import download

        path = place.work / "file.pth"
        lay(place, path)
        place.watch()
        digest = hashlib.sha256(b"new").hexdigest() if known else None
        return download(served(), path, size=3, digest=digest)

    def fetched(lay: Callable[[Place, Path], Any], place: Place) -> Any:
        from astray.published import catalogue
        from astray.published.imported import Known

        os.environ["ASTRAY_AGENTS"] = str(place.work / "agents")
        lay(place, place.work / "agents" / catalogue.DOWNLOADS / "file.pth")
        place.watch()
        one = catalogue.Published("one", Known("maze", "anywhere"), "file.pth", served())
        return catalogue.fetch(one, unchecked=True)

    laid: dict[str, Callable[[Place, Path], Any]] = {
        "a file": lambda place, path: place.mine(path),
        "half a file": lambda place, path: place.mine(path.with_name(f"{path.name}.part")),
        "a link": lambda place, path: (
            path.parent.mkdir(parents=True, exist_ok=True),
            place.mine("kept"),
            path.symlink_to(place.work / "kept"),
        ),
        "a link as half a file": lambda place, path: (
            path.parent.mkdir(parents=True, exist_ok=True),
            place.mine("kept"),
            path.with_name(f"{path.name}.part").symlink_to(place.work / "kept"),
        ),
        "a folder": lambda place, path: place.mine(path / "notes.txt"),
    }
    found: dict[str, Callable[[Place], Any]] = {
        f"a download, where there is {name}, digest known: {known}": functools.partial(
            act, lay, known
        )
        for name, lay in laid.items()
        for known in (True, False)
        if "file" not in name
    }
    return found | {
        f"an agent is fetched, where there is {name}": functools.partial(fetched, lay)
        for name, lay in laid.items()
        if name != "half a file"
    }


def _homes() -> dict[str, Callable[[Place], Any]]:
    """Agents of both kinds beside what is hidden in a home, and folders that are links."""

    def kept(name: str, place: Place) -> Any:
        for hidden in (f".{name}", f".{name}.{HEX}", f".{name}.bak"):
            place.mine(place.home / hidden / "config.json")
            place.mine(place.home / hidden / "checkpoints" / "1" / "agent.safetensors")
        place.copy("run")
        place.watch()
        return place.astray("keep", "run", "--as", name, "--out", place.home)

    def imported(name: str, place: Place) -> Any:
        os.environ["ASTRAY_AGENTS"] = str(place.home)
        place.mine(place.home / f".{name}" / "id")
        place.mine(place.home / f"{name}.{HEX}" / "id")
        place.copy("agent.pth")
        place.watch()
        return place.astray("import", "agent.pth", "--as", name, "--game", "maze", "--variant",
                            "anywhere", "--art", "own")  # fmt: skip

    def linked(what: str, place: Place) -> Any:
        from attack.material import TINY

        place.mine("home/checkpoints-of-mine/512/agent.safetensors")
        place.mine("home/notes.txt")
        run = place.copy("half", "runs/seed-0")
        path = run / what
        if path.is_dir():
            import shutil

            shutil.rmtree(path)
        elif path.exists():
            path.unlink()
        path.symlink_to(place.work / "home")
        place.watch()
        return place.astray("train", *TINY, "--out", "runs")

    def named(name: str, place: Place) -> Any:
        os.environ["ASTRAY_AGENTS"] = str(place.work / "agents")
        place.mine(f"agents/{name}/notes.txt")
        place.copy("agent.pth")
        place.watch()
        return place.astray("import", "agent.pth", "--as", "mine", "--game", "maze", "--variant",
                            "anywhere", "--art", "own")  # fmt: skip

    found: dict[str, Callable[[Place], Any]] = {}
    for name in ("ssh", "config", "git", "cache"):
        found[f"an agent kept as {name} in the home"] = functools.partial(kept, name)
        found[f"an agent imported as {name} to the home"] = functools.partial(imported, name)
    for what in (
        "checkpoints",
        "tensorboard",
        "metrics.jsonl",
        "config.json",
        "checkpoints/512",
        ".lock",
    ):
        found[f"a training whose {what} is a link to a home"] = functools.partial(linked, what)
    for name in ("mine", f".mine.{HEX}", "downloads", "results"):
        title = name.replace(HEX, "...")
        found[f"an import beside the user's {title}"] = functools.partial(named, name)
    return found


def _removed() -> dict[str, Callable[[Place], Any]]:
    """What removes what was left by kills, among files of the user's by such names."""

    def act(lay: Callable[[Place], Any], place: Place) -> Any:
        from astray.files import remove_left

        lay(place)
        place.watch()
        return remove_left(place.work / "there", ("agent.safetensors", "config.json"))

    there = "there"
    cases: dict[str, Callable[[Place], Any]] = {
        "another name": lambda p: p.mine(f"{there}/.notes.txt.{HEX}"),
        "a digit less": lambda p: p.mine(f"{there}/.config.json.{HEX[:-1]}"),
        "a digit more": lambda p: p.mine(f"{there}/.config.json.{HEX}0"),
        "large letters": lambda p: p.mine(f"{there}/.config.json.{HEX.upper()}"),
        "no dot": lambda p: p.mine(f"{there}/config.json.{HEX}"),
        "a folder with notes": lambda p: p.mine(f"{there}/.512.{HEX}/notes.txt"),
        "a folder with ours and notes": lambda p: (
            p.mine(f"{there}/.512.{HEX}/agent.safetensors"),
            p.mine(f"{there}/.512.{HEX}/a"),
        ),
        "a folder in a folder": lambda p: p.mine(f"{there}/.512.{HEX}/agent.safetensors/a"),
        "a link by our name": lambda p: (
            p.mine("kept"),
            p.mine(f"{there}/a"),
            (p.work / there / f".config.json.{HEX}").symlink_to(p.work / "kept"),
        ),
        "a link to a folder": lambda p: (
            p.mine("kept/agent.safetensors"),
            p.mine(f"{there}/a"),
            (p.work / there / f".512.{HEX}").symlink_to(p.work / "kept"),
        ),
        "a link in a folder": lambda p: (
            p.mine("kept"),
            p.mine(f"{there}/.512.{HEX}/a").unlink(),
            (p.work / there / f".512.{HEX}" / "agent.safetensors").symlink_to(p.work / "kept"),
        ),
        "itself a link": lambda p: (
            p.mine(f"home/.config.json.{HEX}"),
            (p.work / there).symlink_to(p.work / "home"),
        ),
    }
    return {
        f"removal of what was left, with {name}": functools.partial(act, lay)
        for name, lay in cases.items()
    }
