"""Importer of RLLTE's agents on Procgen: whole modules of torch, which are read and not run.

`rllte-hub` has PPO's encoder and actor as pickled modules, without a critic. The network is
IMPALA with two differences: the ReLU at the beginning of a residual unit works in place, so what is
added at its end is the rectified input; and there is none before the dense layer.
"""

import contextlib
import functools
import io
import re
import struct
import zipfile
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import torch

from astray import files
from astray.agents.importers import plain
from astray.agents.importers.imported import ACTIONS, SHAPE, Imported, build, check_actions
from astray.agents.policy import Architecture

MARK = b"crllte.common.utils\nExportModel\n"  # with which its pickles begin, after two bytes
PICKLE = "/data.pkl"
FLOATS = "torch FloatStorage"
# Errors of a damaged archive.
BROKEN = (OSError, RuntimeError, EOFError, OverflowError, struct.error, zipfile.BadZipFile)
LARGEST = 4_000_000  # bytes of a pickle; those of its agents have some 10,000
DEEPEST, MOST = 8, 200  # modules in each other, and modules in all
NAMES = (
    (r"^encoder\.trunk\.4\.", "features.linear."), (r"^actor\.actor\.", "policy."),
    (r"^encoder\.trunk\.([012])\.main\.", lambda m: f"block{int(m[1]) + 1}."),
    (r"^(block\d)\.0\.", r"\1.conv."),
    (r"^(block\d)\.([23])\.", lambda m: f"{m[1]}.residual{int(m[2]) - 1}."),
)  # fmt: skip


def is_module(data: bytes) -> bool:
    """Return whether the bytes of a file of torch are a module of RLLTE."""
    try:
        with stored(data) as archive:
            return MARK in pickle_of(archive)[1][: len(MARK) + 2]
    except (ValueError, *BROKEN):
        return False


@contextlib.contextmanager
def stored(data: bytes) -> Iterator[zipfile.ZipFile]:
    """Open the archive in the bytes of a file of torch, whose parts together are no larger.

    Raises:
        ValueError: If parts are compressed, overlap or are too many, and could be of any size.
    """
    files.check_members(data)
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        parts = archive.infolist()
        if any(one.compress_type != zipfile.ZIP_STORED for one in parts):
            raise ValueError("it is compressed, which files of torch are not")
        if sum(one.file_size for one in parts) > len(data):
            raise ValueError("it is damaged, or not a file of torch: its parts overlap")
        yield archive


def read(data: bytes) -> Imported:
    """Return the agent in the bytes of a file of rllte-hub.

    Raises:
        ValueError: If the bytes are damaged or hold another network.
    """
    root = _root(data)
    tensors = {rename(name, NAMES): torch.from_numpy(t.copy()) for name, t in _parameters(root)}
    if "policy.bias" not in tensors:
        raise ValueError("it has no actor of one layer, as agents of images have")
    check_actions(tensors["policy.bias"])
    convolutions = [tensors.get(f"block{k}.conv.weight") for k in (1, 2, 3)]
    widths = tuple(len(c) for c in convolutions if c is not None and c.ndim)
    architecture = Architecture("impala-rectified", SHAPE, (), ACTIONS, widths=widths)
    tensors |= {"value.weight": torch.zeros(1, 256), "value.bias": torch.zeros(1)}
    channels = "/".join(map(str, widths))
    about = f"RLLTE: IMPALA, channels {channels}; without a critic: every value is 0"
    return Imported(build(architecture.build, tensors), architecture, about)


def pickle_of(archive: zipfile.ZipFile) -> tuple[str, bytes]:
    """Return the folder of an archive's parts, and the pickle; raise ValueError if there is none.

    Several, and one that is far larger than any agent's, are refused, too.
    """
    found = [one for one in archive.namelist() if one.endswith(PICKLE)]
    if len(found) != 1:
        raise ValueError(f"it is damaged, or not a file of torch: {len(found)} parts are a pickle")
    if archive.getinfo(found[0]).file_size > LARGEST:
        raise ValueError(f"its data.pkl has more than {LARGEST:,} bytes")
    return found[0].removesuffix(PICKLE), archive.read(found[0])


def _root(data: bytes) -> Any:
    try:
        with stored(data) as archive:
            home, raw = pickle_of(archive)
            # Once each: a pickle may ask for the same bytes any number of times.
            read = functools.cache(lambda key: archive.read(f"{home}/data/{key}"))

            def numbers(kind: str, key: str, count: int) -> np.ndarray:
                if kind != FLOATS:
                    raise ValueError("it keeps something other than numbers of 32 bits")
                return np.frombuffer(read(key), "<f4")

            return plain.read(raw, numbers)
    except BROKEN as error:
        raise ValueError(f"it is damaged, or not a file of torch: {error}") from error


def _parameters(root: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the parameters in a module and those in it, by name."""
    left, todo = MOST, [("", root, 0)]
    while todo:
        path, module, depth = todo.pop()
        left -= 1
        state = module.state if isinstance(module, plain.Foreign) else None
        if not isinstance(state, dict) or depth > DEEPEST or left < 0:
            raise ValueError(f"{path or 'it'} is not a module, or there are too many")
        if path.endswith(".relu.") and state.get("inplace") is not True:
            raise ValueError(f"{path[:-1]} does not work in place, as that of its network does")
        for name, value in _dict(state, "_parameters").items():
            if isinstance(value, np.ndarray):
                yield f"{path}{name}", value
        todo += [(f"{path}{n}.", m, depth + 1) for n, m in _dict(state, "_modules").items()]


def _dict(state: dict[Any, Any], name: str) -> dict[Any, Any]:
    found = state.get(name)
    if not isinstance(found, dict):
        raise ValueError(f"one of its modules has no {name}")
    return found


def rename(name: str, names: Iterable[tuple[Any, Any]]) -> str:
    """Return a name after each replacement of a pattern, (pattern, replacement) in `names`."""
    for there, here in names:
        name = re.sub(there, here, name)
    return name
