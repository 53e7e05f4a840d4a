"""Import of users' objects by name, "module:attribute", as in entry points."""

import builtins
import contextlib
import importlib
import json
import logging
import os
import re
import signal
import sys
import threading
import traceback
import warnings
from collections.abc import Collection, Iterator, Sequence
from importlib.metadata import EntryPoint, distribution, distributions
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from astray.validation import brief, shown

LOG = logging.getLogger("astray")
LONG = 10.0  # seconds of an import before it is announced
NAME = re.compile(r"[^\W\d][\w.]*:[^\W\d][\w.]*")
# Files of code that is not the user's; a dataclass is made of a text.
OTHERS = re.compile(rf"-packages|<frozen|<str|lib.python3|{re.escape(str(Path(__file__).parent))}")


class Terminated(KeyboardInterrupt):
    """The process was asked to end, for instance by a cluster; partial files are removed."""


class _Lent:
    """State that users' code may set while it runs: streams, functions, path, folder, limits.

    Threads that run such code at once share what is lent: the first lends, the last takes back.
    """

    def __init__(self) -> None:
        self.lock, self.inside, self.output = threading.Lock(), 0, 0

    def __enter__(self) -> None:
        with self.lock:
            self.inside += 1
            if self.inside > 1:
                return
            self.standard = [(module, {**vars(module)}) for module in (builtins, json, os)]
            self.own, self.path, self.output = (sys.stdout, sys.stderr), [*sys.path], 0
            self.filters = [*warnings.filters]
            self.depth, self.folder = sys.getrecursionlimit(), ""
            self.muted, self.errors, self.mask = LOG.manager.disable, np.geterr(), os.umask(0o077)
            os.umask(self.mask)
            self.leaves_alarm = os.name == "nt" or any(signal.getitimer(signal.ITIMER_REAL))
            self.dtype = getattr(sys.modules.get("torch"), "get_default_dtype", lambda: None)()
            with contextlib.suppress(OSError):  # it was removed
                self.folder = os.getcwd()
            if sys.__stderr__ and sys.stdout is sys.__stdout__:  # a program may read the output
                stream = open(2, "w", 1, errors="backslashreplace", closefd=False)
                sys.stdout = sys.stderr = stream
                with contextlib.suppress(AttributeError, OSError, ValueError):  # none, or closed
                    sys.__stdout__.flush()  # pyrefly: ignore
                    self.output = os.dup(1)
                    os.dup2(2, 1)

    def __exit__(self, *_: object) -> None:
        with self.lock:
            self.inside -= 1
            if not self.inside:
                sys.setrecursionlimit(max(self.depth, sys.getrecursionlimit()))
                np.seterr(**self.errors)
                # A warning that is an error would break what is imported next.
                warnings.filters[:] = [  # pyrefly: ignore
                    one for one in warnings.filters if one[0] != "error" or one in self.filters
                ]
                os.umask(self.mask)
                if not self.leaves_alarm:
                    signal.alarm(0)
                with contextlib.suppress(KeyError, AttributeError):  # no torch, or not yet all
                    (torch := sys.modules["torch"]).set_default_dtype(self.dtype or torch.float32)
                for module, own in self.standard:
                    vars(module).update(own)
                if LOG.manager.disable != self.muted:  # all loggers look their level up anew
                    logging.disable(self.muted)
                if self.output:
                    with contextlib.suppress(AttributeError, OSError, ValueError):
                        sys.__stdout__.flush()  # pyrefly: ignore
                    os.dup2(self.output, 1)
                    os.close(self.output)
                sys.stdout, sys.stderr = self.own
                if lost := [place for place in self.path if place not in (sys.path or ())]:
                    sys.path = [*(sys.path or ()), *lost]  # else others seem not to be installed
                with contextlib.suppress(OSError):
                    os.chdir(self.folder)  # which relative paths of the user's begin at


LENT = _Lent()


@contextlib.contextmanager
def guarded(what: str, *passed: type[Exception]) -> Iterator[None]:
    """Turn every error of a user's code into a ValueError, also an exit, but not an interrupt.

    Args:
        what: Name of the code for the error, which says "{what} fails".
        passed: Errors that are raised unchanged, but for ValueErrors of the user's own lines.

    Raises:
        ValueError: If the code raises anything but those.
    """
    learns = getattr(sys.modules.get("torch"), "is_grad_enabled", lambda: True)()  # of a thread
    try:
        with LENT:
            yield
    except BaseException as error:
        # NumPy's say nothing of where; nothing tells an interrupt that the code raises from Ctrl+C.
        is_bare = type(error) is ValueError and place(error)
        if isinstance(error, (KeyboardInterrupt, *passed)) and not is_bare:
            raise
        raise ValueError(f"{what} fails: {shown(error, 300)}{place(error)}") from error
    finally:
        getattr(sys.modules.get("torch"), "set_grad_enabled", lambda _: None)(learns)


def place(error: BaseException) -> str:
    """Return the last line of a user's own code that an error passed, for a sentence's end."""
    calls = [(f.f_code.co_filename, line) for f, line in traceback.walk_tb(error.__traceback__)]
    theirs = [(name, line) for name, line in calls if not OTHERS.search(name)]
    return f" ({Path(theirs[-1][0]).name}, line {theirs[-1][1]})" if theirs else ""


@contextlib.contextmanager
def announced(seconds: float, text: str) -> Iterator[None]:
    """Log a warning if the block takes longer than so many seconds, as it may never end."""
    timer = threading.Timer(seconds, LOG.warning, ["%s", text])
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def is_name(text: str) -> bool:
    """Return whether `text` has the form of an object's name, "module:attribute"."""
    return bool(NAME.fullmatch(text))


def name_of(thing: Any) -> str:
    """Return the name "module:attribute" of a function or a class.

    Raises:
        ValueError: If the name does not lead back to it, for instance within a function.
    """
    name = f"{getattr(thing, '__module__', None)}:{getattr(thing, '__qualname__', None)}"
    try:
        found = attrgetter(thing.__qualname__)(sys.modules[thing.__module__])
    except (KeyError, AttributeError):
        found = None
    if found is not thing:
        raise ValueError(f"{thing!r} must be a function or a class at the top of a module")
    return name


def find(name: str, called: bool = False) -> Any:
    """Import the module in a name "module:attribute", and return the object. The module is run.

    Raises:
        ValueError: If there is no such object, the module fails, or it cannot be `called`.
    """
    if not is_name(name):
        raise ValueError(f"a name must be module:attribute, as my_package:WORLD; got {name!r}")
    module, _, attribute = name.partition(":")
    told = f"the module {module!r} is still being imported after {LONG:g} seconds"
    try:
        with announced(LONG, told), guarded(f"the module {module!r}", ImportError, AttributeError):
            found = attrgetter(attribute)(importlib.import_module(module))
    except (ImportError, AttributeError) as error:
        with guarded(f"the module {module!r}"):  # an error of its own may exit when it is read
            told = brief(error)
        raise ValueError(f"{name!r} cannot be imported: {told}") from error
    if called and not callable(found):
        raise ValueError(f"{name!r} must be a function or a class, not a {type(found).__name__}")
    return found


def find_each(names: Sequence[str]) -> dict[str, Any]:
    """Return the objects of names "module:attribute" by their last parts.

    Raises:
        ValueError: If one does not exist, or two have one last part.
    """
    found = {name.rpartition(":")[2]: find(name) for name in names}
    if len(found) < len(names):
        raise ValueError(f"two of these have one name: {', '.join(names)}")
    return found


def offered(group: str) -> list[EntryPoint]:
    """Return the entry points of `group` in all installed packages; import none.

    A package whose list cannot be read causes a warning; the others are still listed.
    """
    found: dict[str, list[EntryPoint]] = {}
    for package in distributions():
        name = "a package"
        try:
            if package.entry_points.select(group=group):  # a name takes ten times as long to read
                name = package.name  # of two of one name the first is the one that is imported
                found[name] = list(distribution(name).entry_points.select(group=group))
        except Exception as error:  # of a file that anybody may have written
            with contextlib.suppress(Exception):
                name = package.name
            warnings.warn(
                f"what {name} offers {group} is not seen: its entry_points.txt cannot be read "
                f"({error!r}); to install it anew may mend it",
                stacklevel=2,
            )
    return [point for points in found.values() for point in points]


def only(name: str, values: Collection[str], group: str) -> Any:
    """Import the object that packages offer by `name`; raise ValueError if they offer several."""
    if len({*values}) > 1:
        raise ValueError(
            f"{name!r} is offered by several packages as one of the {group}: {', '.join(values)}; "
            "uninstall all but one"
        )
    return find(next(iter(values)))


def known(name: str, group: str, kind: type) -> Any:
    """Return the object that a name in a file refers to, without importing other modules.

    The object is either an entry point of `group` in an installed package, or a class derived from
    `kind` in a module that this process has imported. Otherwise a file could name any function of
    the loaded modules, and have it called.

    Raises:
        ValueError: If it is neither.
    """
    if name in {point.value for point in offered(group)}:
        return find(name)
    if (module := name.partition(":")[0]) not in sys.modules:
        raise ValueError(
            f"{name} is not astray's own: import {module} first, or install a package that "
            f"offers it as one of the entry points {group!r}"
        )
    found = find(name)
    if not isinstance(found, type) or not issubclass(found, kind):
        raise ValueError(
            f"{name} must be a class derived from {kind.__name__}, or one of the entry points "
            f"{group!r}; got {found!r}"
        )
    return found


def missing(need: str, extra: str) -> ImportError:
    """Return the error for a library that is not installed, with the extra that installs it.

    It names no package index: astray is on none, so its name there could belong to anybody.
    """
    return ImportError(f'{need}: pip install ".[{extra}]" in a clone of astray')


@contextlib.contextmanager
def extra(name: str, need: str) -> Iterator[None]:
    """Import libraries of the extra `name` in the block; raise `missing` if one is not there."""
    try:
        yield
    except ImportError as error:
        raise missing(need, name) from error


def needed_by(thing: str, error: ModuleNotFoundError) -> ImportError:
    """Return the error for a missing library: that of `missing`, if the extra train installs it."""
    library = f"{error.name}".partition(".")[0]
    ours = re.compile(rf"{re.escape(library)}\b(?!-).*extra == .train")  # not a user's own
    is_ours = any(map(ours.match, distribution("astray").requires or ()))
    return missing(f"{thing} needs {library}", "train") if is_ours else error
