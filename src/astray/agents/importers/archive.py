"""Files of torch since 1.6: archives of a pickle, and of the numbers that it names."""

import contextlib
import struct
import zipfile
from collections.abc import Iterator

from astray import files

PICKLE = "/data.pkl"
LARGEST = 4_000_000  # bytes of a pickle; those of agents have some 10,000
# Errors of a damaged archive.
BROKEN = (OSError, RuntimeError, EOFError, OverflowError, struct.error, zipfile.BadZipFile)


@contextlib.contextmanager
def opened(data: bytes) -> Iterator[tuple[zipfile.ZipFile, str, bytes]]:
    """Open the archive in the bytes of a file of torch: with its parts' folder, and its pickle.

    Raises:
        ValueError: If it is damaged, also where it is read later, or if its parts could be of any
            size: they are compressed, overlap, have one name, or are too many.
    """
    try:
        with files.archive_of(data, (zipfile.ZIP_STORED,)) as archive:  # as torch writes them
            parts = archive.infolist()
            sizes = {one.filename: one.file_size for one in parts}
            if sum(sizes.values()) > len(data) or len(sizes) < len(parts):
                raise ValueError("it is damaged, or not a file of torch: its parts overlap")
            found = [one for one in parts if one.filename.endswith(PICKLE)]
            if len(found) != 1:
                told = f"{len(found)} parts are a pickle"
                raise ValueError(f"it is damaged, or not a file of torch: {told}")
            if found[0].file_size > LARGEST:
                raise ValueError(f"its data.pkl has more than {LARGEST:,} bytes")
            yield archive, found[0].filename.removesuffix(PICKLE), archive.read(found[0])
    except (KeyError, *BROKEN) as error:
        raise ValueError(f"it is damaged, or not a file of torch: {error}") from error
