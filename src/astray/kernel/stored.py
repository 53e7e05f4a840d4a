"""Compiled code in files, which are complete or ignored, and may be lost."""

import contextlib
import hashlib
import io
import os
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from functools import cached_property
from pathlib import Path
from typing import Any

from numba.core.caching import (
    Cache,
    CompileResultCacheImpl,
    IndexDataCacheFile,
    UserProvidedCacheLocator,
)

PACKAGE = Path(__file__).parents[1]
SUM = hashlib.sha256().digest_size  # bytes


class _Locator(UserProvidedCacheLocator):
    """Locator of astray's own folder; numba's would use the user's folder for all functions.

    Everything in it is private to the user.
    """

    def __init__(self, function: Any, folder: str):
        code = function.__code__
        self._py_file, self._lineno = code.co_filename, code.co_firstlineno
        # Digests tell apart what is astray's own, so that installations and clones share it.
        own, path = Path(self._py_file).parent, self.get_suitable_cache_subpath(self._py_file)
        self._cache_path = os.path.join(folder, own.name if PACKAGE in own.parents else path)

    def ensure_cache_path(self) -> None:
        path = self.get_cache_path()
        os.makedirs(path, mode=0o700, exist_ok=True)
        tempfile.TemporaryFile(dir=path).close()


class _Implementation(CompileResultCacheImpl):
    """Implementation without numba's search through all folders that it knows."""

    _locator: Any

    def __init__(self, function: Any, digest: str, folder: str):
        code, ending = function.__code__, f"_{digest}"
        self._lineno, self._locator = code.co_firstlineno, _Locator(function, folder)
        name = f"{Path(code.co_filename).stem}.{function.__qualname__.removesuffix(ending)}{ending}"
        self._filename_base = self.get_filename_base(name, getattr(sys, "abiflags", ""))


class _Files(IndexDataCacheFile):
    """Numba's files with a checksum at the end; a truncated one could crash the process.

    Numba reads up to the checksum and no further.
    """

    @contextlib.contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[Any]:
        content = io.BytesIO()
        yield content
        with super()._open_for_write(filepath) as file:
            file.write(content.getvalue() + hashlib.sha256(content.getvalue()).digest())

    def save(self, key: Any, data: Any) -> None:
        # A file for each type, which no other process gives to another.
        name = self._data_name(int(hashlib.sha256(repr(key).encode()).hexdigest()[:12], 16))
        self._save_data(name, data)
        self._save_index(self._load_index() | {key: name})

    def _load_index(self) -> dict:
        return super()._load_index() if _is_whole(Path(self._index_path)) else {}

    def _load_data(self, name: str) -> Any:
        path = Path(self._data_path(name))
        if not _is_whole(path):
            raise OSError(f"{path} is not as it was written")  # which numba takes for no file
        return super()._load_data(name)


def _is_whole(path: Path) -> bool:
    """Return whether the file at `path` is readable and complete."""
    try:
        data = path.read_bytes()
    except OSError:
        return False
    return hashlib.sha256(data[:-SUM]).digest() == data[-SUM:]


class Stored(Cache):
    """Compiled code that is read from files, and written while `writes` is true.

    Args:
        function: Function whose source file names the files of code.
        digest: Digest of the sources that it depends on.
        folder: Function that returns the folder, "" for none; called when code is first needed.
    """

    writes = True  # of all functions

    def __init__(self, function: Any, digest: str, folder: Callable[[], str]):
        self._name, self._py_func, self._folder = repr(function), function, folder
        self._digest = digest
        self.enable()

    @cached_property
    def _impl(self) -> _Implementation:
        return _Implementation(self._py_func, self._digest, self._folder())

    @cached_property
    def _cache_file(self) -> _Files:  # pyrefly: ignore
        return _Files(self.cache_path, self._impl.filename_base, self._digest)

    @property
    def cache_path(self) -> str:
        return self._impl.locator.get_cache_path()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        return super().load_overload(sig, target_context) if self._folder() else None

    def save_overload(self, sig: Any, data: Any) -> None:
        self._save(super().save_overload, sig, data)

    def text(self, make: Callable[[], str]) -> str:
        """Return what `make` returns, from a file if it was made before."""
        found = self._cache_file.load("") if self._folder() else None
        if found is None:
            found = make()
            self._save(self._save_text, found)
        return found

    def _save_text(self, text: str) -> None:
        self._impl.locator.ensure_cache_path()
        with self._guard_against_spurious_io_errors():
            self._cache_file.save("", text)

    def _save(self, write: Callable, *what: Any) -> None:
        if not Stored.writes or not self._folder():
            return
        try:
            write(*what)
        except OSError as error:  # a full disk, or a folder that was closed
            Stored.writes = False
            warnings.warn(f"compiled code is not kept: {error}", stacklevel=2)
