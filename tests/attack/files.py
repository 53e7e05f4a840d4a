"""Files that are ruined: of any kind, and of safetensors."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np


def header_of(data: bytes) -> tuple[dict[str, Any], bytes]:
    """The header of a safetensors file, and what follows it."""
    size = int.from_bytes(data[:8], "little")
    return json.loads(data[8 : 8 + size]), data[8 + size :]


def with_header(header: Any, rest: bytes) -> bytes:
    """A safetensors file of a header, which may be anything, and the rest."""
    text = header if isinstance(header, bytes) else json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + rest


def rewritten(data: bytes, tensors: Mapping[str, np.ndarray]) -> bytes:
    """The safetensors file with other tensors and its own metadata."""
    from safetensors.numpy import save

    return save(dict(tensors), header_of(data)[0].get("__metadata__"))


# What is written in the place of a file's content.
CHANGED: dict[str, Callable[[bytes], bytes]] = {
    "empty": lambda data: b"",
    "a byte": lambda data: data[:1],
    "half": lambda data: data[: len(data) // 2],
    "without its end": lambda data: data[:-1],
    "with an end more": lambda data: data + b"\x00more",
    "zeros": lambda data: bytes(len(data)),
    "every byte turned": lambda data: bytes(255 - byte for byte in data),
    "a byte turned in the middle": lambda data: (
        data[: len(data) // 2] + bytes([255 - data[len(data) // 2]]) + data[len(data) // 2 + 1 :]
    ),
    "its first bytes turned": lambda data: bytes(255 - b for b in data[:8]) + data[8:],
    "twice": lambda data: data + data,
    "UTF-16": lambda data: data.decode("latin-1").encode("utf-16"),
    "no text": lambda data: b"\xff\xfe\x00\xd8" + data,
    "null": lambda data: b"null\n",
    "a list": lambda data: b"[1, 2]\n",
    "a number": lambda data: b"7\n",
    "an empty object": lambda data: b"{}\n",
    "brackets without end": lambda data: b"[" * 200_000,
    "a number of a million digits": lambda data: b'{"steps": ' + b"9" * 1_000_000 + b"}\n",
    "a page of the web": lambda data: b"<!DOCTYPE html><html><body>404</body></html>\n",
    "a line of a megabyte": lambda data: b"a" * 2**20,
}


def pipe(path: Path) -> None:
    os.mkfifo(path)


def locked(path: Path) -> None:
    path.write_text("closed")
    path.chmod(0)


# What is put in the place of a file.
PLACED: dict[str, Callable[[Path], None]] = {
    "a folder": lambda path: path.mkdir(),
    "a pipe": pipe,
    "a link to nothing": lambda path: path.symlink_to("nothing"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "a closed file": locked,
    "a device without end": lambda path: path.symlink_to("/dev/zero"),
    "a full device": lambda path: path.symlink_to("/dev/full"),
    "nothing": lambda path: None,
}


def ruin(path: Path, how: str) -> None:
    """Ruin the file at `path` in the way that is called so."""
    if how in CHANGED:
        path.write_bytes(CHANGED[how](path.read_bytes()))
    else:
        path.unlink()
        PLACED[how](path)
