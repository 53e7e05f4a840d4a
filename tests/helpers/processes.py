"""Other processes, that find what the tests find."""

import multiprocessing
import os
import runpy
import sys
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from multiprocessing import forkserver
from multiprocessing.process import BaseProcess
from pathlib import Path

# What takes most programs three seconds of a core to import; nothing of astray.
LIBRARIES = (
    "av", "gymnasium", "jinja2", "matplotlib.pyplot", "numba", "PIL.Image", "polars",
    "rich.progress", "safetensors.torch", "scipy.stats", "sklearn.linear_model",
    "stable_baselines3", "torch",
)  # fmt: skip


def environment(**changes: str) -> dict[str, str]:
    """This process's environment, with `changes`, for a Python that imports what this one does."""
    path = os.pathsep.join(filter(None, map(os.path.abspath, sys.path)))
    return os.environ | {"PYTHONPATH": path} | changes


@dataclass(frozen=True)
class Begun:
    """A program in a process of its own, and the files of what it writes."""

    process: BaseProcess
    out: Path
    err: Path

    def ended(self) -> tuple[int | None, str, str]:
        """Wait for its exit code, and what it wrote to standard output and to standard error."""
        self.process.join()
        return self.process.exitcode, self.out.read_text(), self.err.read_text()


def begin(
    program: str, folder: Path, *words: object, env: Mapping[str, str] | None = None
) -> Begun:
    """Begin a program in a folder, in a process of its own.

    It is forked from one that has imported the libraries, but no astray.
    """
    context, server = multiprocessing.get_context("forkserver"), forkserver._forkserver
    if server._preload_modules != list(LIBRARIES):  # a World's processes need astray in it
        server._stop()
        context.set_forkserver_preload(list(LIBRARIES))
    told = Path(tempfile.mkdtemp(dir=folder.parent))
    (told / "program.py").write_text(program, "utf-8")
    given = (told, folder, tuple(map(str, words)), {**(env or environment())})
    process = context.Process(target=_run, args=given)
    process.start()
    return Begun(process, told / "out", told / "err")


def _run(told: Path, folder: Path, words: tuple[str, ...], env: dict[str, str]) -> None:
    for stream, name in ((1, "out"), (2, "err")):
        os.dup2(os.open(told / name, os.O_WRONLY | os.O_CREAT), stream)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(env)
    sys.path[:0] = env.get("PYTHONPATH", "").split(os.pathsep)
    sys.argv = [str(told / "program.py"), *words]
    runpy.run_path(sys.argv[0], run_name="__main__")
