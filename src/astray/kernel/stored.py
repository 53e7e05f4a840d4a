"""Compiled code in files that are whole or not read, and whose loss is no error."""

from __future__ import annotations

import contextlib
import hashlib
import io
import os
import pickle
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

SUM = hashlib.sha256().digest_size  # bytes before what they are the sum of
OTHER = "another version"  # than any of numba


class _Locator(UserProvidedCacheLocator):
    """numba.config.CACHE_DIR, in folders for the user alone."""

    def ensure_cache_path(self) -> None:
        path = self.get_cache_path()
        os.makedirs(path, mode=0o700, exist_ok=True)
        tempfile.TemporaryFile(dir=path).close()


class _Implementation(CompileResultCacheImpl):
    _locator_classes = [_Locator]  # no other folder is checked  # noqa: RUF012


class _Files(IndexDataCacheFile):
    """Numba's, each behind its check sum: a file cut short could end the process."""

    @contextlib.contextmanager
    def _open_for_write(self, filepath: str) -> Iterator[Any]:
        content = io.BytesIO()
        yield content
        with super()._open_for_write(filepath) as file:
            file.write(hashlib.sha256(content.getvalue()).digest() + content.getvalue())

    def _load_index(self) -> dict:
        content = io.BytesIO(_whole(Path(self._index_path)) or pickle.dumps(OTHER))
        if pickle.load(content) != self._version:
            return {}
        stamp, overloads = pickle.load(content)
        return overloads if stamp == self._source_stamp else {}

    def _load_data(self, name: str) -> Any:
        content = _whole(Path(self._data_path(name)))
        return None if content is None else pickle.loads(content)


def _whole(path: Path) -> bytes | None:
    """What was written to `path`; None where it is not there, or is something else by now."""
    try:
        data = path.read_bytes()
    except OSError:
        return None
    content = data[SUM:]
    return content if hashlib.sha256(content).digest() == data[:SUM] else None


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
