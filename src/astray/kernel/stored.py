"""Compiled code in files that are whole or not read, and whose loss is no error."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import tempfile
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from numba.core.caching import (
    Cache,
    CompileResultCacheImpl,
    IndexDataCacheFile,
    UserProvidedCacheLocator,
)

SUM = hashlib.sha256().digest_size  # bytes


class _Locator(UserProvidedCacheLocator):
    """numba.config.CACHE_DIR, in folders for the user alone."""

    def ensure_cache_path(self) -> None:
        path = self.get_cache_path()
        os.makedirs(path, mode=0o700, exist_ok=True)
        tempfile.TemporaryFile(dir=path).close()


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # no other folder is checked  # noqa: RUF012


class _Files(IndexDataCacheFile):
    """Numba's, a check sum at the end of each: one that was cut short could end the process.

    Numba reads up to the sum, and no further.
    """

    @contextlib.contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[Any]:
        content = io.BytesIO()
        yield content
        with super()._open_for_write(filepath) as file:
            file.write(content.getvalue() + hashlib.sha256(content.getvalue()).digest())

    def _load_index(self) -> dict:
        return super()._load_index() if _is_whole(Path(self._index_path)) else {}

    def _load_data(self, name: str) -> Any:
        path = Path(self._data_path(name))
        if not _is_whole(path):
            raise OSError(f"{path} is not as it was written")  # which numba takes for no file
        return super()._load_data(name)


def _is_whole(path: Path) -> bool:
    """Whether the file at `path` can be read, and is as it was written."""
    try:
        data = path.read_bytes()
    except OSError:
        return False
    return hashlib.sha256(data[:-SUM]).digest() == data[-SUM:]


class Stored(Cache):
    """Compiled code that is read from files, and written while `writes` says so."""

    _impl_class = _Implementation
    writes = True  # of all functions

    def __init__(self, function: Any):
        super().__init__(function)
        files = self._cache_file
        self._cache_file = _Files(files._cache_path, self._impl.filename_base, files._source_stamp)

    def save_overload(self, sig: Any, data: Any) -> None:
        if not Stored.writes:
            return
        try:
            super().save_overload(sig, data)
        except OSError as error:  # a full disk, or a folder that was closed
            Stored.writes = False
            warnings.warn(f"compiled code is not kept: {error}", stacklevel=2)
