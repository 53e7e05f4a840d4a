"""Digests of the code and data that a result is computed from.

The code is found by following imports from the given functions, also imports within functions. It
is that which runs: a module that is edited runs as it was, until it is loaded again, so each counts
as it was when it was first looked at since it was loaded.
"""

import codecs
import contextlib
import functools
import hashlib
import importlib.util
import re
import sys
from argparse import Namespace
from collections import deque
from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import fields, is_dataclass
from datetime import date, time, timedelta
from importlib.machinery import ModuleSpec
from itertools import accumulate
from numbers import Number
from pathlib import Path, PurePath
from types import CodeType, FunctionType, MappingProxyType, MethodType, ModuleType, SimpleNamespace
from typing import Any

import numpy as np

Root = ModuleType | FunctionType | type
ITSELF = "astray"  # of whose own imports only its own modules are followed
INSTALLED = {"site-packages", "dist-packages"}  # names of folders
PLAIN = (
    Number, str, bytes, bytearray, range, date, time, timedelta, type(None), PurePath, np.generic,
)  # fmt: skip  # of values
PYTHONS = Path(contextlib.__file__).parent  # the folder of Python's own modules
LIBRARIES = {"gymnasium", "numba", "numpy", "torch"}  # whose objects games and agents consist of
# A parser takes 100 ms for what a game imports, this 7; with names as a list in parentheses or not.
IMPORT = re.compile(
    rb"(?:^|[;:])[ \t]*(?:from(?=[ \t.])([\w. \t\x80-\xff]+?)(?<![\w\x80-\xff])"
    rb"import(?![\w\x80-\xff])[ \t]*(\((?:[^()#]|#[^\n]*)*\)|[^\n;(]+)|import[ \t]+([^\n;]+))",
    re.MULTILINE,
)
_loaded: dict[str, tuple[object, bytes]] = {}  # module -> what loaded it, and its source


def digest(*things: object, data: object = None) -> str | None:
    """Return a digest of the sources that `things` come from, and of `data`.

    Args:
        things: Functions, classes and modules, also within mappings, sequences and records.
        data: Any object whose `repr` is complete.

    Returns:
        16 hexadecimal digits, or None if a source cannot be read, as in a notebook.
    """
    found = sources(*things)
    if found is None:
        return None
    return hashlib.sha256(repr((data, sorted(found.items()))).encode()).hexdigest()[:16]


def sources(*things: object, known: Collection[str] = ()) -> dict[str, str] | None:
    """Return the digest of each module that `things` come from or import.

    Args:
        things: As for `digest`.
        known: Modules that are neither read nor followed.

    Returns:
        Module -> digest of its source, or None if a source cannot be read.
    """
    found, todo = dict.fromkeys(known, ""), [_module(root) for root in _roots(things, {})]
    packages = {name.partition(".")[0] for name, *_ in todo} - LIBRARIES
    while todo:
        name, spec, loaded = todo.pop()
        package = name.partition(".")[0]
        if name in found or (package in sys.stdlib_module_names and _is_pythons(spec)):
            continue
        if name not in _loaded or _loaded[name][0] is not loaded:
            if (source := read_source(spec)) is None:
                return None
            _loaded[name] = loaded, source
        source = _loaded[name][1]
        found[name] = hashlib.sha256(source).hexdigest()
        # Installed libraries are read but not followed: there is no end to what they import.
        if spec and (package in packages or not INSTALLED & {*Path(spec.origin or "").parts}):
            todo += [(one, its, its) for one, its in _imported(source, name, spec)]
    return {name: found[name] for name in found.keys() - set(known)}


def values(thing: Any, passed: dict[int, Any] | None = None) -> Iterator[str]:
    """Yield the values that a function or a record carries, which no source tells.

    They are those of closures, defaults, partial arguments, attributes, parts, and of the globals
    that a function of a script may have from its command line.
    """
    if isinstance(thing, PLAIN):
        yield repr(thing)
    elif (array := _array_of(thing)) is not None:
        if array.dtype.hasobject:
            yield from values(array.tolist(), passed)
        else:
            yield f"{array.dtype} {array.shape} {hashlib.sha256(array.tobytes()).hexdigest()}"
    elif isinstance(thing, set | frozenset):
        yield from sorted(one for part in thing for one in values(part, passed))
    elif id(thing) not in (passed := {} if passed is None else passed):
        passed[id(thing)] = thing
        for part in _carried(thing):
            yield from values(part, passed)


def _array_of(thing: Any) -> np.ndarray | None:
    """Return an array, a tensor or a table as an array; None if NumPy cannot have its numbers."""
    if hasattr(type(thing), "__array__"):
        with contextlib.suppress(Exception):  # as of a tensor of bfloat16, whose `repr` counts
            return np.asarray(thing.detach().cpu() if hasattr(thing, "detach") else thing)
    return None


def _carried(thing: Any) -> Iterable[Any]:
    """Return the parts of a thing in which there may be values."""
    own, kind = getattr(thing, "__dict__", {}), type(thing)
    if isinstance(thing, ModuleType | type):
        return ()
    if isinstance(thing, FunctionType):
        cells = [cell.cell_contents for cell in thing.__closure__ or ()]
        attributes = [one for item in own.items() if _is_data(item) for one in item]
        return [cells, thing.__defaults__, thing.__kwdefaults__, attributes, *_named(thing)]
    if isinstance(thing, Mapping):
        return [part for item in thing.items() for part in item]
    called = [one for one in [getattr(kind, "__call__", None)] if is_users(one)]  # noqa: B004
    if is_dataclass(thing):  # other fields follow from these, or change with use
        return called + [getattr(thing, one.name) for one in fields(thing) if one.init]
    if isinstance(thing, functools.partial | MethodType | tuple | list | deque) or "py_func" in own:
        return _parts(thing) or ()
    if _is_record(kind):  # its `repr` may be anything
        return [called, object.__getstate__(thing)]  # of slots, too
    told = repr(thing)
    is_part = " at 0x" in told or (own and "..." in told)  # as NumPy's of long arrays
    return [called, *(own.items() if is_part else [told])]


def _named(function: FunctionType) -> Iterator[Any]:
    """Yield the values, functions and records that a function names, also in modules and classes.

    Those of Python and libraries, and of astray's other modules, have sources alone.
    """
    there, used = function.__globals__, sorted({*_names(function.__code__)})
    scopes: list[Mapping[str, Any]] = [there]
    within: list[object] = []
    for scope in scopes:
        for one in (scope[name] for name in used if name in scope):
            if isinstance(one, ModuleType | type):
                its = one.__mro__ if isinstance(one, type) else (one,)
                new = [x for x in its if is_users(x) and all(x is not y for y in within)]
                within += new
                scopes += [{**vars(x), **getattr(x, "__members__", {})} for x in new]
            elif _tells(one, there):
                is_bound = isinstance(one, staticmethod | classmethod)
                yield one.__func__ if is_bound else getattr(one, "fget", one)


def _tells(thing: Any, there: Mapping[str, Any]) -> bool:
    """Return whether a thing is data, a function of `there` or a user's, or a record of these."""
    if isinstance(thing, dict | MappingProxyType):
        return all(_tells(part, there) for item in thing.items() for part in item)
    if isinstance(thing, functools.partial | MethodType):
        return all(_tells(part, there) for part in [*(_parts(thing) or ())][1:])
    if isinstance(thing, list | set | frozenset | deque):
        return all(_tells(part, there) for part in thing)
    if isinstance(thing, tuple | SimpleNamespace | Namespace) or _is_data(thing):
        return True
    its = getattr(thing, "fget", getattr(thing, "__wrapped__", thing))
    if isinstance(its, FunctionType):
        return its.__globals__ is there or is_users(its)
    frozen = getattr(getattr(thing, "__dataclass_params__", None), "frozen", False)  # as a Config
    return frozen or _is_record(type(thing))


def _is_record(kind: type) -> bool:
    """Return whether a class is a user's, and derives from Python's alone.

    A record of a library's class, as an environment or a network, changes with use.
    """
    python = sys.stdlib_module_names
    return is_users(kind) and all(is_users(x) or x.__module__ in python for x in kind.__mro__)


def is_users(thing: Any) -> bool:
    """Return whether a function, class or module is neither Python's, a library's nor astray's."""
    name = f"{getattr(thing, '__name__' if isinstance(thing, ModuleType) else '__module__', '')}"
    if name in ("__main__", "__mp_main__"):  # which has no file in a notebook
        return True
    its = thing if isinstance(thing, ModuleType) else sys.modules.get(name)
    there = thing.__globals__ if isinstance(thing, FunctionType) else getattr(its, "__dict__", {})
    path = there.get("__file__")
    if not path or name.partition(".")[0] in {ITSELF, *sys.stdlib_module_names}:
        return False
    return not INSTALLED & {*Path(path).parts}


def _is_data(thing: Any) -> bool:
    """Return whether a thing is numbers and text alone, as what a module reads from a file."""
    if isinstance(thing, dict | MappingProxyType):
        return all(map(_is_data, (*thing, *thing.values())))
    if isinstance(thing, list | tuple | set | frozenset | deque):
        return all(map(_is_data, thing))
    return isinstance(thing, PLAIN) or hasattr(type(thing), "__array__")


def _names(code: CodeType) -> Iterator[str]:
    """Yield the names in a function's code, and in that of functions within."""
    yield from code.co_names
    for one in code.co_consts:
        if isinstance(one, CodeType):
            yield from _names(one)


def see(*things: object) -> None:
    """Look at the sources of things while these are what was imported."""
    still = {
        n for n, (by, _) in _loaded.items() if by is getattr(sys.modules.get(n), "__spec__", None)
    }
    sources(*things, known=still)


def read_source(spec: ModuleSpec | None) -> bytes | None:
    """Return the source file of a module, also from a zip archive; b"" for a namespace package."""
    if spec and spec.submodule_search_locations is not None and not spec.has_location:
        return b""
    try:
        return spec.loader.get_data(spec.origin)  # pyrefly: ignore
    except (AttributeError, OSError, TypeError):
        return None


def _is_pythons(spec: ModuleSpec | None) -> bool:
    """Return whether a module with a name of Python's is Python's: `profile.py` may be a user's."""
    return not (spec and spec.has_location and spec.origin) or PYTHONS in Path(spec.origin).parents


def _roots(thing: Any, passed: dict[int, Any]) -> Iterator[Root]:
    """Find the functions, classes and modules in a thing, except in those that were `passed`."""
    if id(thing) in passed:
        return
    passed[id(thing)] = thing
    parts = _parts(thing)
    if parts is None or isinstance(thing, FunctionType):  # one may stand before another
        yield thing
    for part in parts or ():
        yield from _roots(part, passed)
    if isinstance(thing, FunctionType) and (thing.__closure__ or is_users(thing)):
        # Its module need not import what it names, as where another function made it.
        yield from filter(is_users, _roots([x for x in _carried(thing) if not _is_data(x)], passed))


def _parts(thing: Any) -> Iterable[Any] | None:
    """Return the parts of a thing; None for a function, a class or a module."""
    own = getattr(thing, "__dict__", {})
    if isinstance(thing, ModuleType | type):
        return None
    if "py_func" in own or "__wrapped__" in own:
        return [own.get("py_func", own.get("__wrapped__"))]
    if isinstance(thing, FunctionType):
        return None
    if isinstance(thing, functools.partial):
        return [thing.func, thing.args, thing.keywords]
    if isinstance(thing, MethodType):
        return [thing.__func__, thing.__self__]
    if isinstance(thing, Mapping):
        return thing.values()
    if isinstance(thing, tuple | list | set | frozenset | deque):
        return thing
    kind, asked = type(thing), functools.cached_property  # whose value follows from the rest
    return [kind, *(x for n, x in own.items() if not isinstance(getattr(kind, n, None), asked))]


def _module(root: Root) -> tuple[str, ModuleSpec | None, object]:
    """Return name, spec, and what loaded it, of a module or of that which defines `root`."""
    there: Mapping[str, Any]
    if isinstance(root, FunctionType):
        there = root.__globals__  # of a file that was run, too, which no name leads to
    else:
        name = root.__name__ if isinstance(root, ModuleType) else root.__module__
        module = sys.modules.get(name)  # NumPy imports only on demand what it names as a class's
        there = vars(module) if module else {"__name__": name, "__spec__": _place(name)}
    name, spec, path = there["__name__"], there.get("__spec__"), there.get("__file__")
    loaded = spec or there  # a script is run with other names each time
    if spec is None and path:
        spec = importlib.util.spec_from_file_location(name, path)
    return name, spec, loaded


def _imported(source: bytes, name: str, spec: ModuleSpec) -> Iterator[tuple[str, ModuleSpec]]:
    """Find the modules that a source imports; in astray's own sources only astray's own."""
    package = name if spec.submodule_search_locations is not None else name.rpartition(".")[0]
    itself = f"{name}.".startswith(f"{ITSELF}.")
    for module, attribute in _statements(source):
        if module.startswith("."):
            try:
                module = importlib.util.resolve_name(module, package)
            except ImportError:
                continue
        if itself and not f"{module}.".startswith(f"{ITSELF}."):
            continue
        if attribute == "*":  # imports the submodules that a package lists, too
            listed = (f"{module}.{x}" for x in getattr(sys.modules.get(module), "__all__", ()))
            yield from ((one, found) for one in listed if (found := _place(one)))
        for one in (f"{module}.{attribute}", module):
            if found := _place(one):
                yield one, found
                break
        if not attribute:  # `import a.b` binds a, with all its names
            above = accumulate(module.split(".")[:-1], "{}.{}".format)
            yield from ((one, found) for one in above if (found := _place(one)))


@functools.lru_cache(1024)
def _statements(source: bytes) -> frozenset[tuple[str, str]]:
    """Return each module that is imported, with each name that is imported from it, or ""."""
    found = set()
    lines = b"\n".join(source.removeprefix(codecs.BOM_UTF8).splitlines())  # which end in any way
    for words in IMPORT.findall(lines.replace(b"\\\n", b" ").replace(b"\f", b" ")):
        module, names, modules = (text.decode(errors="replace") for text in words)
        for listed in re.sub(r"#[^\n]*", "", names or modules).strip("() \t\n").split(","):
            if one := _joined(re.split(r"\sas\s", listed)[0]):
                found.add((_joined(module), one) if module else (one, ""))
    return frozenset(found)


def _joined(name: str) -> str:
    return "".join(name.split())


def _place(name: str) -> ModuleSpec | None:
    """Return a module's spec without importing it or its parents; None if there is none."""
    if name in sys.modules:
        module = sys.modules[name]
        return getattr(module, "__spec__", None) or ModuleSpec(name, None)
    within, _, last = name.rpartition(".")
    above = _place(within) if within else None
    if not last or (within and (above is None or above.submodule_search_locations is None)):
        return None
    for finder in sys.meta_path:
        # KeyError: a folder without __init__.py is found only in what has been imported.
        with contextlib.suppress(ImportError, KeyError):
            if found := finder.find_spec(name, above.submodule_search_locations if above else None):
                return found
    return None
