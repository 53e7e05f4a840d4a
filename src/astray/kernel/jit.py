"""Compilation: three decorators, and an on-disk cache that cannot be stale."""

from __future__ import annotations

import contextlib
import functools
import hashlib
import warnings
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler

from astray.kernel.cache import cache_folder, held, passing_folder
from astray.kernel.stored import Stored
from astray.kernel.versions import LOCK

PACKAGE = Path(__file__).parents[1]
KERNELS = ("kernel/*.py", "games/*/*.py", "envs/loops.py", "game.py")  # all that is compiled


def source_digest(patterns: Sequence[str] = KERNELS) -> str:
    """Hash of sources; by default of all that compiled code depends on, numba and flags too."""
    flags = (numba.__version__, numba.config.BOUNDSCHECK, numba.config.OPT)  # pyright: ignore
    digest = hashlib.sha256(repr(flags).encode())
    for path in sorted(p for pattern in patterns for p in PACKAGE.glob(pattern)):
        digest.update(path.name.encode() + path.read_bytes())
    return digest.hexdigest()[:16]


IMPORTED = source_digest()  # what is loaded: sources may be edited before any is compiled


@functools.cache
def code_folder() -> str:
    """Where this process keeps compiled code: chosen, and made, when some is first asked for.

    Numba notices edits to the file a kernel is in, not to the files it calls into; a folder named
    after all of them does. "" where there is none.
    """
    if source_digest() != IMPORTED:
        warnings.warn(
            "compiled code is not kept: astray's sources, or numba's settings, are not those that "
            "it was imported with",
            stacklevel=2,
        )
        return passing_folder()
    return cache_folder(IMPORTED)


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


def passing(function: Callable) -> Any:
    """A decorator of functions that Python calls, whose compiled code ends with the process."""
    return numba.njit(nogil=True)(function)


def entry(function: Callable) -> Any:
    """A decorator of functions that Python calls; only these are kept in files."""
    compiled = passing(function)
    if compiled is not function and Path(function.__code__.co_filename).is_file():
        compiled._cache = Stored(function, code_folder)
    return compiled


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


@contextlib.contextmanager
def one_at_a_time(label: str = "") -> Iterator[None]:
    """Compile in here: numba's cache breaks when two processes write one entry.

    label  of what is specialised, which nobody waits for who compiles something else
    """
    with held(code_folder(), f"compile-{label}.lock" if label else LOCK) as is_held:
        if not is_held:
            Stored.writes = False
        yield
