"""Class 6: pickles, archives, caches and modules that others hand over; nothing of them is run."""

from __future__ import annotations

import functools
import io
import json
import os
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from attack import pickles
from attack.core import Attempt, Place, Told, Wrong

IMPORT = ("--as", "mine", "--game", "maze", "--variant", "anywhere", "--art", "own")


def attempts() -> Iterator[Attempt]:
    for how in pickles.all_of(""):
        for container in CONTAINERS:
            act = functools.partial(_unpickled, how, container)
            yield Attempt(6, f"a pickle of {how} {container}", act)
    for name, (act, wants) in {**_modules(), **_archives(), **_caches(), **_kept()}.items():
        yield Attempt(6, name, act, wants, seconds=40)


def _zipped(name: str, data: bytes, **more: bytes) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr(name, data)
        for other, content in more.items():
            archive.writestr(other.replace("_", "/"), content)
    return file.getvalue()


def _npz(data: bytes) -> bytes:
    header = b"{'descr': '|O', 'fortran_order': False, 'shape': (1,), }"
    padded = header.ljust(117) + b"\n"
    array = b"\x93NUMPY\x01\x00" + len(padded).to_bytes(2, "little") + padded + data
    return _zipped("states.npy", array)


def _joblib(data: bytes) -> bytes:
    """As joblib writes it: the payload where an array of objects would be."""
    return b"\x80\x03" + data.removeprefix(b"\x80\x02").removeprefix(b"\x80\x04")


def _legacy(data: bytes) -> bytes:
    """torch's old format: four pickles one after the other."""
    return b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19.\x80\x02M\xe9\x03.\x80\x02}." + data


# Where a pickle lies: the file's name, its bytes, and how it is read.
CONTAINERS: dict[str, tuple[str, Callable[[bytes], bytes]]] = {
    "in a .pth": ("a.pth", lambda data: _zipped("a/data.pkl", data, a_version=b"3\n")),
    "as a .pth": ("a.pth", lambda data: data), "in an old .pth": ("a.pth", _legacy),
    "as a .jd": ("a.jd", lambda data: data), "in a .jd": ("a.jd", _joblib),
    "in an .npz": ("a.npz", _npz),
}  # fmt: skip


def _unpickled(how: str, container: str, place: Place) -> Any:
    name, wrap = CONTAINERS[container]
    path = place.mine(name, wrap(pickles.all_of(str(place.canary))[how]))
    if path.suffix == ".npz":
        from astray.envs.states import load_states

        return load_states(path, "maze")
    return place.astray("import", path, *IMPORT)


CANARY = "import pathlib; pathlib.Path({!r}).touch()\ndef run(*_): pathlib.Path({!r}).touch()\n"


def _module(place: Place) -> None:
    """A module that tells when it is imported, or its function is called, where Python looks."""
    import sys

    text = CANARY.format(str(place.canary), str(place.canary))
    place.mine("canary_module.py", text)
    place.mine("canary_package/__init__.py", text)
    sys.path.insert(0, str(place.work))


def _modules() -> dict[str, tuple[Callable[[Place], Any], Any]]:
    """Names of modules in files: none is imported, and nothing of those that are is called."""
    from attack.files import header_of, with_header

    def named(setting: str, name: str, place: Place) -> Any:
        _module(place)
        path = place.copy("run") / "config.json"
        data = json.loads(path.read_text())
        data["config"][setting] = name
        path.write_text(json.dumps(data))
        return place.astray("evaluate", "run", "--levels", "0:2")

    def built(name: str, place: Place) -> Any:
        _module(place)
        path = place.copy("run") / "checkpoints" / "1024" / "agent.safetensors"
        header, rest = header_of(path.read_bytes())
        told = json.loads(header["__metadata__"]["astray"])
        told["architecture"]["name"] = name
        header["__metadata__"]["astray"] = json.dumps(told)
        path.write_bytes(with_header(header, rest))
        return place.astray("evaluate", "run", "--levels", "0:2")

    def resumed(setting: str, name: str, place: Place) -> Any:
        _module(place)
        path = place.copy("half", "runs/seed-0") / "config.json"
        data = json.loads(path.read_text())
        data["config"][setting] = name
        path.write_text(json.dumps(data))
        from attack.material import TINY

        return place.astray("train", *TINY, "--out", "runs")

    names = ("canary_module:run", "canary_package:run", "os:system", "builtins:exec", "sys:exit",
             "subprocess:call", "astray.cli:main")  # fmt: skip
    found: dict[str, tuple[Callable[[Place], Any], Any]] = {}
    for name in names:
        for setting in ("network", "loss", "sampler"):
            title = f"settings with {setting} {name}"
            # What trained an agent does not matter where it is played; its network is in its file.
            found[title] = (functools.partial(named, setting, name), "any")
            found[f"{title}, gone on with"] = (functools.partial(resumed, setting, name), "refusal")
        found[f"an agent's network {name}"] = (functools.partial(built, name), "refusal")
    return found


def _archives() -> dict[str, tuple[Callable[[Place], Any], Any]]:
    """Wheels and checkouts of pictures that would lead out of their folder, or have no end."""
    inside = "procgen/data/assets/"

    def wheel(entries: dict[str, bytes], mode: int, place: Place) -> Told:
        file = io.BytesIO()
        with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
            for name, data in entries.items():
                told = zipfile.ZipInfo(name)
                told.external_attr = mode << 16
                told.compress_type = zipfile.ZIP_DEFLATED
                archive.writestr(told, data)
        os.environ["ASTRAY_ART"] = str(place.work / "art" / "deep")
        path = place.mine("pictures.whl", file.getvalue())
        return place.astray("art", "import", path)

    def checkout(link: str, place: Place) -> Told:
        os.environ["ASTRAY_ART"] = str(place.work / "art")
        there = place.work / "checkout" / inside
        there.mkdir(parents=True)
        (there / "kenney").symlink_to(link)
        return place.astray("art", "import", "checkout")

    first = f"{inside}kenney/Items/coinGold.png"
    cases = {
        "a path above": ({"../../evil.txt": b"x"}, 0o644),
        "a path above, inside": ({f"{inside}../../../evil.txt": b"x"}, 0o644),
        "an absolute path": ({"/tmp/evil.txt": b"x"}, 0o644),
        "a path of Windows": ({"..\\..\\evil.txt": b"x", "C:\\evil": b"x"}, 0o644),
        "a link": ({first: b"/etc/passwd"}, 0o120777),
        "a bomb": ({first: bytes(2**26)}, 0o644),
        "a hundred bombs": ({f"{inside}{k}.png": bytes(2**20) for k in range(100)}, 0o644),
        "100,000 names": ({f"{inside}{k}": b"" for k in range(100_000)}, 0o644),
        "a name of 60,000 characters": ({inside + "x" * 60_000: b""}, 0o644),
        "a terminal's codes": ({f"../{chr(27)}[2Jevil": b""}, 0o644),
        "other pictures": ({first: b"\x89PNG\r\n\x1a\n"}, 0o644),
    }  # fmt: skip
    found: dict[str, tuple[Callable[[Place], Any], Any]] = {
        f"a wheel with {name}": (functools.partial(wheel, *given), "refusal")
        for name, given in cases.items()
    }
    for link in ("/", "/etc", "/proc/self", ".", "/dev"):
        found[f"a checkout that is a link to {link}"] = (
            functools.partial(checkout, link),
            "refusal",
        )
    return found


def _caches() -> dict[str, tuple[Callable[[Place], Any], Any]]:
    """Folders of compiled code that others may have written to: another takes their place."""

    def act(open_up: Callable[[Path], Any], place: Place) -> None:
        import warnings

        from astray.kernel.cache import cache_folder

        home = place.work / "code"
        folder = home / "astray" / ("0" * 16)
        folder.mkdir(parents=True, mode=0o700)
        home.chmod(0o700)
        os.environ["NUMBA_CACHE_DIR"] = str(home)
        open_up(folder)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            chosen = Path(cache_folder("0" * 16))
        if chosen.resolve() == folder.resolve():
            raise Wrong("it is used all the same")

    def planted(path: Path) -> None:
        path.write_bytes(b"planted")
        path.chmod(0o666)

    cases: dict[str, Callable[[Path], Any]] = {
        "that all may write to": lambda folder: folder.chmod(0o777),
        "that its group may write to": lambda folder: folder.chmod(0o770),
        "below one that all may write to": lambda folder: folder.parents[1].chmod(0o777),
        "below one that its group may write to": lambda folder: folder.parents[1].chmod(0o775),
        "below a sticky one of others' files": lambda folder: (
            folder.chmod(0o755),
            planted(folder / "one.nbi"),
        ),
        "with a file that all may write to": lambda folder: (
            folder.chmod(0o755),
            planted(folder / "one.nbi"),
        ),
        "with a folder that all may write to": lambda folder: (
            folder.chmod(0o755),
            (folder / "maze_1").mkdir(),
            (folder / "maze_1").chmod(0o777),
        ),
        "that is a link to one of root's": lambda folder: (
            folder.rmdir(),
            folder.symlink_to("/usr/share"),
        ),
        "that is a file": lambda folder: (folder.rmdir(), folder.touch()),
        "that is closed": lambda folder: folder.chmod(0),
        "that is for reading": lambda folder: folder.chmod(0o500),
        "that is a link to nothing": lambda folder: (
            folder.rmdir(),
            folder.symlink_to("/nonexistent"),
        ),
    }
    return {
        f"compiled code in a folder {name}": (functools.partial(act, open_up), "success")
        for name, open_up in cases.items()
    }


# Names that are none, of agents and of repositories.
AGENTS = (
    "../outside", "..", ".", "/", "a/b", "a\\b", "~", "a\nb", "-", "--help", "A", "a b", "é",
    "con.", "a" * 300, "*", "[a]", "a;b", "$(a)",
)  # fmt: skip
REPOSITORIES = (
    "../a", "a/../b", "a/b/c", "/a", "a", "a/", "https://a/b", "a/b?x", "a/b#c", "a b/c", "a/b\n",
    "é/b", "a/" + "b" * 300, "-/-", "a/..", "./a",
)  # fmt: skip


def _kept() -> dict[str, tuple[Callable[[Place], Any], Any]]:
    """Names and links that lead out of the folders that they are looked for in."""

    def act(given: tuple[Any, ...], place: Place) -> Told:
        os.environ["ASTRAY_AGENTS"] = str(place.work / "agents")
        place.copy("run", "outside")
        place.copy("run")
        place.copy("agent.pth")
        (place.work / "agents").mkdir()
        return place.astray(*given)

    found: dict[str, tuple[Callable[[Place], Any], Any]] = {}
    for name in AGENTS:
        shown = name[:20]
        for verb, given in {
            "import": ("import", "agent.pth", f"--as={name}", *IMPORT[2:]),
            "keep": ("keep", "run", f"--as={name}", "--out", "to"),
            "find": ("evaluate", f"--agent={name}", "--levels", "0:2"),
        }.items():
            found[f"{verb}: an agent called {shown!r}"] = (functools.partial(act, given), "refusal")
    for name in REPOSITORIES:
        shown = name[:20]
        found[f"pull: a repository called {shown!r}"] = (
            functools.partial(act, ("pull", "--", name)),
            "refusal",
        )
    return found
