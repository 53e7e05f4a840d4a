"""Compilation: three decorators, and an on-disk cache that cannot be stale."""

import builtins
import contextlib
import enum
import functools
import hashlib
import inspect
import re
import sys
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any
from weakref import WeakKeyDictionary

import numba
import numpy as np
from numba.core.caching import FunctionCache, NullCache
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import Compiler
from numba.core.dispatcher import Dispatcher
from numba.core.typing.templates import builtin_registry

from astray import provenance
from astray.kernel.cache import cache_folder, held
from astray.kernel.stored import Stored
from astray.kernel.versions import LOCK

VALUES = (
    bool, int, float, complex, str, bytes, tuple, np.ndarray, np.generic, np.dtype, type, slice,
    enum.Enum, numba.types.Type,
)  # fmt: skip  # what compiled code keeps


def version_digest() -> str:
    """Return a digest of versions and numba's settings, on which all compiled code depends."""
    settings = (numba.config.BOUNDSCHECK, numba.config.OPT)  # pyrefly: ignore
    flags = (numba.__version__, np.__version__, *settings)
    return hashlib.sha256(repr(flags).encode()).hexdigest()[:16]


@functools.cache
def code_folder() -> str:
    """Return the folder of this process's compiled code, or ""; it is created on first use."""
    return cache_folder(version_digest())


def code_digest(function: Any) -> str | None:
    """Return a digest of a function, its bound names, and all sources that these import.

    Numba notices edits to the file of a kernel, but not to the files that it calls.

    Returns:
        16 hexadecimal digits, or None if the dependencies are unknown: the function has no file,
        as in a notebook.
    """
    bound, called = getattr(function, "bound", {}).values(), {}
    told = [how for one in (function, *bound) for how in _how(one)]
    for name, part in _parts("", function):
        is_function = isinstance(part, FunctionType)
        told.extend(_frozen(name, part, called) if is_function else [(name, part)])
    return provenance.digest(function, called, data=sorted(told, key=repr))


def _parts(name: str, part: Any) -> Iterator[tuple[str, Any]]:
    """Find a function or a number, and all names that `specialise` bound in it."""
    part = inspect.unwrap(getattr(part, "py_func", part))
    yield name, part
    for inner, bound in getattr(part, "bound", {}).items():
        yield from _parts(inner, bound)


def renewed(functions: Iterable[Any]) -> str:
    """Let users' kernels be compiled again if they, or kernels they call, keep other values by now.

    Numba would take the code that it has, also in its files, as if it had been made of the new
    values.

    Returns:
        A digest of these values.
    """
    called: dict[FunctionType, Any] = {}
    for one in functions:
        for name, part in _parts("", one):
            if isinstance(part, FunctionType) and _is_of_user(part):
                list(_frozen(name, part, called, one))
    kept: dict[Any, str] = {
        compiled: repr(sorted(_frozen("", function, {}), key=repr))
        for function, compiled in reversed(called.items())
        if isinstance(compiled, Dispatcher) and _is_of_user(function)
    }
    changed = [one for one, values in kept.items() if _values.setdefault(one, values) != values]
    for one in kept:
        if type(one._cache) is FunctionCache:  # stale after an edit of what its file imports
            one._cache = NullCache()
            changed.append(one)
    for one in filter(lambda one: one._can_compile, changed):
        one._reset_overloads()
    for one in filter(lambda one: not one._can_compile, changed):  # those of declared types
        one.recompile()
    _values.update(kept)
    return hashlib.sha256(repr([*kept.values()]).encode()).hexdigest()


_values: WeakKeyDictionary[Any, str] = WeakKeyDictionary()  # that users' kernels were compiled with


def _is_of_user(function: FunctionType) -> bool:
    """Return whether a function is not astray's, or calls what was bound to its names."""
    return hasattr(function, "bound") or not f"{function.__module__}".startswith("astray.")


def _frozen(
    name: Any, function: FunctionType, passed: dict[FunctionType, Any], by: Any = None
) -> Iterator[tuple]:
    """Find the globals whose values compiled code keeps, also in the kernels that it calls.

    No source shows these where a module read them from a file or the environment. `passed` are
    the functions that were found, each with its compiled one, which may be what it is called `by`.
    """
    yield name, *_written(function)
    if function in passed:
        return
    passed[function] = getattr(function, "compiled", by)
    codes = [function.__code__]
    for code in codes:
        codes.extend(one for one in code.co_consts if isinstance(one, CodeType))
    closed = _closed(function)
    used = {"", *closed, *(name for code in codes for name in code.co_names)}
    overloads = _overloads(builtin_registry.functions[-1], builtin_registry.attributes[-1])
    scopes: list[Mapping] = [function.__globals__, closed, vars(builtins), overloads]
    within: list[object] = []
    for scope in scopes:  # also those of modules and classes that are found in these
        for name in filter(scope.__contains__, used):
            value = scope[name]  # lists and dicts are what overloads choose from
            several = [*value, *value.values()] if isinstance(value, dict) else value
            for at, one in enumerate(several if isinstance(several, tuple | list) else (value,)):
                each = [one, *overloads.get(id(one), ())]
                if isinstance(kind := getattr(one, "class_type", None), numba.types.ClassType):
                    parts = (kind.jit_methods, kind.jit_static_methods, *kind.jit_props.values())
                    each += [method for methods in parts for method in methods.values()]
                for called in each:
                    if how := _how(called):
                        yield name, at, *how
                    by, called = called, inspect.unwrap(getattr(called, "py_func", called))
                    package = f"{getattr(called, '__module__', '')}".partition(".")[0]
                    if isinstance(called, FunctionType) and package not in provenance.LIBRARIES:
                        yield from _frozen((name, at), called, passed, by)
                if isinstance(one, ModuleType | type) and all(one is not s for s in within):
                    within.append(one)
                    scopes.append(vars(one))
                if isinstance(one, VALUES):
                    yield name, at, _kept(one)


def _how(called: Any) -> tuple[Any, ...]:
    """Return numba's options for a function, and the types that are declared for it.

    Signatures count only where no others are compiled: else they are those that were asked for.
    """
    one = getattr(called, "_dispatcher", called)  # of what is vectorized
    if not hasattr(one, "targetoptions"):
        return ()
    options = {n: sorted(x) if isinstance(x, set) else x for n, x in one.targetoptions.items()}
    if getattr(called, "_can_compile", True) and not getattr(called, "_frozen", False):
        return options, one.locals
    return options, one.locals, called.types if one is not called else called.nopython_signatures


@functools.lru_cache(1)
def _overloads(*_last: Any) -> dict[Any, tuple]:
    """Return users' functions that numba calls in place of others, of which `_last` are the last.

    A key is the id of the other, the name of a method or an attribute, or "" of any operator.
    """
    found: dict[Any, tuple] = {}
    for one in (*builtin_registry.functions, *builtin_registry.attributes):
        function = getattr(one, "_overload_func", None)
        if f"{getattr(function, '__module__', None)}".partition(".")[0] not in ("numba", "None"):
            key = "" if getattr(one.key, "__module__", "") == "_operator" else id(one.key)
            name = getattr(one, "_attr", key)
            found[name] = (*found.get(name, ()), function)
    return found


def _written(function: FunctionType) -> tuple[Any, ...]:
    """Return what tells a function from others, also from what its file says by now."""
    code, values = function.__code__, (*(function.__defaults__ or ()), *_closed(function).values())
    kept = [_kept(value) for value in (*code.co_consts, *values) if isinstance(value, VALUES)]
    return code.co_qualname, code.co_firstlineno, code.co_code, code.co_names, kept


def _closed(function: FunctionType) -> dict[str, Any]:
    """Return the names that a function has from the function that made it."""
    cells = zip(function.__code__.co_freevars, function.__closure__ or (), strict=True)
    return {name: cell.cell_contents for name, cell in cells if cell != CellType()}  # an empty one


def _kept(value: Any) -> Any:
    """Return a value that numba keeps, such that its `repr` is complete."""
    if isinstance(value, np.ndarray | np.void):
        return value.dtype.descr, value.shape, hashlib.sha256(value.tobytes()).hexdigest()
    if isinstance(value, type) and issubclass(value, enum.Enum):
        return [(name, _kept(one.value)) for name, one in value.__members__.items()]
    if isinstance(value, enum.Enum):
        return value.name, _kept(value.value)
    if isinstance(getattr(value, "class_type", None), numba.types.ClassType):
        return re.sub("#[0-9a-f]+", "", f"{value.class_type.struct}")  # names have addresses
    return [_kept(one) for one in value] if isinstance(value, tuple) else value


class _Part(JITCodeLibrary):
    """Code that is only linked into other code, finally into an entry's.

    For every function numba makes machine code of the function and all its callees, as if Python
    called it. For CoinRun that is a third of the compile time.
    """

    def _finalize_final_module(self) -> None:
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0

    @property
    def codegen(self) -> Any:
        return self

    def set_env(self, name: str, env: Any) -> None:
        """Ignore what numba sets in machine code; here there is none."""


class _LargePart(_Part):
    """Code that is optimised only where it is linked into, because that takes long."""

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
    """Decorate a function that compiled code calls; Python interprets it."""
    options |= {"pipeline_class": compiler, "no_cfunc_wrapper": True, "no_cpython_wrapper": True}
    compile_part = numba.njit(**options)

    def decorate(function: Any) -> Callable:
        provenance.see(function)
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


def entry(function: Any) -> Any:
    """Decorate a function that Python calls; only their compiled code is cached in files.

    They are compiled one at a time, but for those of one game, whose batch loop has its own lock.
    """
    compiled: Any = numba.njit(nogil=True)(function)
    # What closes over a function numba's files tell apart by its address.
    digest = None if function.__closure__ else code_digest(function)

    if compiled is not function and digest and Path(function.__code__.co_filename).is_file():
        compiled._cache = Stored(function, digest, code_folder)
        if not hasattr(function, "bound"):
            compiled._compile_for_args = one_at_a_time()(compiled._compile_for_args)
    return compiled


def specialise(
    template: Callable, label: str, decorate: Callable = entry, **names: Any
) -> Callable:
    """Compile `template` with some of its global `names` bound to one game's kernels.

    Numba can cache neither a closure over a compiled function nor a call with one as argument. It
    can cache a copy of the function with other globals. `label` and a digest of all sources
    separate the cache entries of different games.
    """
    assert isinstance(template, FunctionType)
    clone: Any = FunctionType(template.__code__, {**template.__globals__, **names}, label)
    clone.__module__, clone.bound = template.__module__, names
    clone.__qualname__ = f"{template.__name__}_{label}"
    clone.__qualname__ += f"_{code_digest(clone)}"
    return decorate(clone)


@contextlib.contextmanager
def one_at_a_time(label: str = "") -> Iterator[None]:
    """Compile in this context alone: numba's cache breaks if two processes write one entry.

    Args:
        label: Name of the specialised code; others do not wait.
    """
    interrupts: list[BaseException] = []
    tell = sys.unraisablehook

    def note(what: Any) -> None:
        if isinstance(what.exc_value, KeyboardInterrupt):
            interrupts.append(what.exc_value)
        else:
            tell(what)

    name = f"compile-{label}.lock" if label else LOCK
    with held(code_folder() if Stored.writes else "", name) as Stored.writes:
        interruptible = threading.current_thread() is threading.main_thread()
        if interruptible:  # no other thread gets Ctrl+C, and one hook is for all
            sys.unraisablehook = note
        try:
            yield
        finally:
            if interruptible:
                sys.unraisablehook = tell
            if interrupts:  # came while LLVM called Python, which only tells of it and goes on
                raise interrupts[0]
