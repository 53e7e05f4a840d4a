"""Memory that a Parquet file needs, from its headers, which are in Thrift's compact encoding."""

import struct
from typing import Any

LARGEST = 2**24  # bytes of a footer; those of data sets have some 10,000
VALUE = 16  # bytes of a value in memory, or of a reference to one, at most
PAGES = (5, 7, 8)  # fields of a page's header: of data, a dictionary, and data as since 2.0


def unpacked(data: bytes) -> int:
    """Return the most bytes that the tables in the bytes of a Parquet file take in memory.

    Raises:
        ValueError: If it is damaged.
    """
    try:
        length = struct.unpack("<I4s", data[-8:])[0]
        if length > LARGEST:
            raise ValueError(f"its footer must have at most {LARGEST:,} bytes; got {length:,}")
        groups = _Thrift(data, len(data) - 8 - length).fields()[4]
        columns = [column[3] for group in groups for column in group[1]]
        return sum(_unpacked(_Thrift(data, min(c[9], c.get(11, c[9]))), c[7]) for c in columns)
    except (IndexError, KeyError, TypeError, struct.error, RecursionError) as error:
        raise ValueError("it is no Parquet file, or damaged") from error


def _unpacked(pages: "_Thrift", packed: int) -> int:
    """Return the bytes that the pages of a column take, which have `packed` bytes in the file."""
    size, end = 0, pages.at + packed
    while pages.at < end:
        header = pages.fields()
        values = [header[kind][1] for kind in PAGES if kind in header]
        size += abs(header[2]) + VALUE * abs(values[0])
        pages.at += abs(header[3])
    return size


class _Thrift:
    """A reader of Thrift's compact encoding, `at` a byte of `data`."""

    def __init__(self, data: bytes, at: int):
        self.data, self.at = data, at

    def fields(self) -> dict[int, Any]:
        """Return the fields of a struct by their numbers."""
        found, number = {}, 0
        while head := self._byte():
            number = number + (head >> 4) if head >> 4 else self._integer()
            found[number] = head & 15 if head & 15 in (1, 2) else self._value(head & 15)
        return found

    def _byte(self) -> int:
        self.at += 1
        return self.data[self.at - 1]

    def _count(self) -> int:
        byte = self._byte()
        return byte if byte < 128 else byte - 128 + 128 * self._count()

    def _integer(self) -> int:
        count = self._count()
        return count >> 1 ^ -(count & 1)

    def _value(self, kind: int) -> Any:
        if kind in (4, 5, 6):
            return self._integer()
        if kind == 12:
            return self.fields()
        if kind == 9:
            head = self._byte()
            count = head >> 4 if head < 0xF0 else self._count()
            return [self._value(head & 15) for _ in range(count)]
        if kind not in (1, 2, 3, 7, 8):
            raise ValueError(f"it is damaged: it has a value of kind {kind}")
        more = self._count() if kind == 8 else 8 if kind == 7 else 1
        self.at += more
        if self.at > len(self.data):
            raise IndexError
        return None
