"""Compilation: three decorators, and an on-disk cache that cannot be stale."""

from __future__ import annotations

import atexit
import contextlib
import hashlib
import os
import re
import shutil
import tempfile
import time
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
from filelock import FileLock
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

PACKAGE = Path(__file__).parents[1]
KERNELS = ("kernel/*.py", "games/*/*.py", "envs/loops.py", "game.py")  # all that is compiled
DIGEST = re.compile("[0-9a-f]{16}")  # what `source_digest` returns
KEPT_FOR = 30 * 24 * 3600  # seconds that the compiled code of another version is kept


def source_digest(patterns: Sequence[str] = KERNELS) -> str:
    """Hash of sources; by default of all that compiled code depends on, numba and flags too."""
    flags = (numba.__version__, numba.config.BOUNDSCHECK, numba.config.OPT)  # pyright: ignore
    digest = hashlib.sha256(repr(flags).encode())
    for path in sorted(p for pattern in patterns for p in PACKAGE.glob(pattern)):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_folder() -> Path:
    """The folder of this version's compiled code; a temporary one where home is read-only."""
    home = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "astray"
    folder = home / source_digest()
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "used").touch()
    except OSError as error:
        warnings.warn(f"compiled code is not kept: {error}", stacklevel=2)
        return _passing_folder()
    for other in home.iterdir():
        used = other / "used"
        is_ours = DIGEST.fullmatch(other.name) and not other.is_symlink() and used.is_file()
        if is_ours and used.stat().st_mtime < time.time() - KEPT_FOR:
            _remove(other)
    return folder


def _remove(folder: Path) -> None:
    """Remove the compiled code of another version, and the folder if nothing else is in it."""
    with contextlib.suppress(OSError):
        for path in folder.glob("**/*"):
            if path.suffix in (".nbi", ".nbc", ".lock") or path == folder / "used":
                path.unlink()
        for path in sorted((p for p in folder.glob("**/*") if p.is_dir()), reverse=True):
            path.rmdir()
        folder.rmdir()


def _passing_folder() -> Path:
    """A folder that ends with this process, and not with one forked from it."""
    folder, owner = Path(tempfile.mkdtemp(prefix="astray-")), os.getpid()

    def remove() -> None:
        if os.getpid() == owner:
            shutil.rmtree(folder, ignore_errors=True)

    atexit.register(remove)
    return folder


# Numba notices edits to the file a kernel is in, not to the files it calls into; a folder
# named after all of them does. A folder that the user chose wins.
if not os.environ.get("NUMBA_CACHE_DIR"):
    numba.config.CACHE_DIR = str(_cache_folder())  # pyright: ignore


class _Part(JITCodeLibrary):
    """Code that is only linked into other code, in the end an entry's.

    Numba makes machine code of every function together with all that it calls, as if Python
    called it: with CoinRun a third of the time that compiling takes.
    """

    def _finalize_final_module(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0

    @property
    def codegen(self) -> Any:
        return self

    def set_env(self, name: str, env: Any) -> None:
        """Numba sets this in machine code; here there is none."""


class _LargePart(_Part):
    """One that is optimised where it is linked into alone, as that takes long."""

    def _optimize_final_module(self) -> None:
        pass


class _PartCompiler(Compiler):
    kind = _Part

    def define_pipelines(self) -> list:
        state = self.state
        state.library = self.kind(state.targetctx.codegen(), state.func_id.func_qualname)
        return super().define_pipelines()


class _LargePartCompiler(_PartCompiler):
    kind = _LargePart


def _part(compiler: type[Compiler], **options: Any) -> Callable:
    """A decorator of functions that compiled code calls; Python that calls one interprets it."""
    options |= {"pipeline_class": compiler, "no_cfunc_wrapper": True, "no_cpython_wrapper": True}
    compile_part = numba.njit(**options)

    def decorate(function: Any) -> Callable:
        compiled = compile_part(function)
        if compiled is not function:  # as it is where nothing is compiled
            function._numba_type_ = compiled._numba_type_
            function.compiled = compiled  # the type alone would not keep it
        return function

    return decorate


# Forced inlining: 334 ns instead of 983 for a kernel that calls 20 small ones twice.
# No fastmath: it may differ between machines.
kernel = _part(_PartCompiler, forceinline=True)
shared = _part(_LargePartCompiler)  # not inlined: for what is large or seldom called
entry = numba.njit(cache=True, nogil=True)  # for what Python calls; only these are cached


def specialise(
    template: Callable, label: str, decorate: Callable = entry, **names: Any
) -> Callable:
    """Compile `template` with some of its global `names` bound to one game's kernels.

    Numba can cache neither a closure over a compiled function nor a call that takes one as
    an argument; a copy of the function with other globals it can. `label` keeps the cache
    entries of two games apart.
    """
    assert isinstance(template, FunctionType)
    clone = FunctionType(template.__code__, {**template.__globals__, **names}, label)
    clone.__qualname__, clone.__module__ = f"{template.__name__}_{label}", template.__module__
    return decorate(clone)


def one_at_a_time() -> FileLock:
    """Held while compiling: numba's cache breaks when two processes write one entry."""
    folder = Path(numba.config.CACHE_DIR)  # pyright: ignore
    folder.mkdir(parents=True, exist_ok=True)
    return FileLock(folder / "compile.lock")
