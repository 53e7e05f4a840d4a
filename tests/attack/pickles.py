"""Pickles that run something when they are read, in all ways that a pickle can."""

from __future__ import annotations

import os
import pickle
import struct
import subprocess
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any


@dataclass
class Payload:
    """An object whose pickle calls a function that makes the file at `path`."""

    how: str
    path: str

    def __reduce__(self) -> tuple[Any, ...]:
        return CALLS[self.how](self.path)


def _code(path: str) -> str:
    return f"open({path!r}, 'w').close()"


def _of_compile(path: str) -> tuple[Any, ...]:
    return exec, (f"import pathlib; pathlib.Path({path!r}).touch()",)


CALLS: dict[str, Callable[[str], tuple[Any, ...]]] = {
    "touch": lambda path: (os.system, (f"touch '{path}'",)),
    "popen": lambda path: (os.popen, (f"touch '{path}'",)),
    "mkdir": lambda path: (os.mkdir, (path,)),
    "subprocess": lambda path: (subprocess.call, (["touch", path],)),
    "Popen": lambda path: (subprocess.Popen, (["touch", path],)),
    "eval": lambda path: (eval, (_code(path),)),
    "exec": _of_compile,
    "open": lambda path: (open, (path, "w")),
    "getattr": lambda path: (getattr(os, "mknod"), (path,)),  # noqa: B009
    "symlink": lambda path: (os.symlink, ("/dev/null", path)),
}


def opcodes(path: str) -> dict[str, bytes]:
    """Pickles that no pickler writes, of opcodes that a reader of a few may forget."""
    touch = f"touch '{path}'".encode()
    text = struct.pack("<I", len(touch)) + touch
    return {
        "GLOBAL and REDUCE": b"cposix\nsystem\n(X" + text + b"tR.",
        "INST": b"(X" + text + b"iposix\nsystem\n.",
        "OBJ": b"(cposix\nsystem\nX" + text + b"o.",
        "NEWOBJ": b"\x80\x02cposix\nsystem\nX" + text + b"\x85\x81.",
        "NEWOBJ_EX": b"\x80\x04\x8c\x05posix\x8c\x06system\x93X" + text + b"\x85}\x92.",
        "STACK_GLOBAL": b"\x80\x04\x8c\x05posix\x8c\x06system\x93X" + text + b"\x85R.",
        "BUILD": b"\x80\x02ccollections\nOrderedDict\n)R}X\x05\x00\x00\x00itemscposix\nsystem\nsb.",
        "a persistent name": b"Pposix.system\n.",
        "a name in builtins": b"c__builtin__\neval\n(X" + struct.pack("<I", len(_code(path)))
        + _code(path).encode() + b"tR.",
        "an extension": b"\x80\x02\x82\x01.",
        "a memo that is none": b"h\xff.",
        "a stack that is empty": b"R.",
        "a mark that is none": b"t.",
        "no end": b"(" * 10_000,
        "text without end": b"\x80\x04\x8d" + struct.pack("<Q", 2**62) + b"x.",
        "a frame without end": b"\x80\x04\x95" + struct.pack("<Q", 2**62) + b"N.",
        "a deep tuple": b")" + b"\x85" * 200_000 + b".",
        "a list in itself": b"]\x94h\x00a.",
    }  # fmt: skip


def all_of(path: str) -> dict[str, bytes]:
    """All pickles that would make the file at `path`, and those that only a reader may fail at."""
    return {how: pickle.dumps(Payload(how, path), 2) for how in CALLS} | opcodes(path)
