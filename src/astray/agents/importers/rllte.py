"""Importer of RLLTE's agents on Procgen: whole modules of torch, which are read and not run.

`rllte-hub` has PPO's encoder and actor as pickled modules, without a critic. The network is
IMPALA with two differences: the ReLU at the beginning of a residual unit works in place, so what is
added at its end is the rectified input; and there is none before the dense layer.
"""

import functools
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch

from astray.agents.importers import plain
from astray.agents.importers.archive import opened
from astray.agents.importers.imported import Imported, impala, rename
from astray.validation import shown

MARK = b"crllte.common.utils\nExportModel\n"  # with which its pickles begin, after two bytes
FLOATS, LITTLE = "torch FloatStorage", b"little"
DEEPEST, MOST = 8, 200  # modules in each other, and modules and parameters in all
# Modules without inner modules, and the values that their settings may have, the usual one first.
CONVOLUTION = {"stride": [(1, 1)], "padding": [(1, 1), "SAME"], "dilation": [(1, 1)],
               "groups": [1], "padding_mode": ["zeros"]}  # fmt: skip
POOL = {"kernel_size": [3], "stride": [2], "padding": [1], "dilation": [1], "ceil_mode": [False]}
KINDS = {"Conv2d": CONVOLUTION, "Conv2d_tf": CONVOLUTION, "MaxPool2d": POOL, "Linear": {},
         "ReLU": {}, "Flatten": {}, "Identity": {}, "Sequential": {}}  # fmt: skip
LONGEST = 100  # characters of a name; those of the network have 10
NAMES = (
    (r"^encoder\.trunk\.4\.", "features.linear."), (r"^actor\.actor\.", "policy."),
    (r"^encoder\.trunk\.([012])\.main\.", lambda m: f"block{int(m[1]) + 1}."),
    (r"^(block\d)\.0\.", r"\1.conv."),
    (r"^(block\d)\.([23])\.", lambda m: f"{m[1]}.residual{int(m[2]) - 1}."),
)  # fmt: skip


def is_module(data: bytes) -> bool:
    """Return whether the bytes of a file of torch are a module of RLLTE."""
    try:
        with opened(data) as (_, _, raw):
            return MARK in raw[: len(MARK) + 2]
    except ValueError:
        return False


def read(data: bytes) -> Imported:
    """Return the agent in the bytes of a file of rllte-hub.

    Raises:
        ValueError: If the bytes are damaged or hold another network.
    """
    found = [*_parameters(_root(data))]
    if sum(array.nbytes for _, array in found) > len(data):
        raise ValueError("its weights are more than the file holds")
    tensors = {rename(name, NAMES): torch.from_numpy(array.copy()) for name, array in found}
    tensors |= {"value.weight": torch.zeros(1, 256), "value.bias": torch.zeros(1)}
    return impala("impala-rectified", tensors, "RLLTE", note="; without a critic: every value is 0")


def _root(data: bytes) -> Any:
    with opened(data) as (archive, home, raw):
        if (order := f"{home}/byteorder") in archive.namelist() and archive.read(order) != LITTLE:
            raise ValueError("its numbers begin with their largest part, and are not read")
        # Once each: a pickle may ask for the same bytes any number of times.
        read = functools.cache(lambda key: archive.read(f"{home}/data/{key}"))

        def numbers(kind: str, key: str, count: int) -> np.ndarray:
            if kind != FLOATS:
                raise ValueError("it keeps something other than numbers of 32 bits")
            return np.frombuffer(read(key), "<f4", count)

        return plain.read(raw, numbers)


def _parameters(root: Any) -> Iterator[tuple[str, np.ndarray]]:
    """Yield the parameters in a module and those in it, by name."""
    left, todo = MOST, [("", root, 0)]
    while todo:
        path, module, depth = todo.pop()
        state = module.state if isinstance(module, plain.Foreign) else None
        if not isinstance(state, dict) or depth > DEEPEST:
            raise ValueError(f"{path or 'it'} is not a module, or in too many others")
        own, inner = _dict(state, "_parameters"), _dict(state, "_modules")
        if (left := left - len(own) - len(inner)) < 0:
            raise ValueError(f"it has more than {MOST} modules and parameters")
        kind, is_relu = module.path.rpartition(" ")[2], path.endswith((".relu.", ".trunk.5."))
        if not inner and (kind not in KINDS or (is_relu and kind != "ReLU")):
            raise ValueError(
                f"{path[:-1]} is the module {kind[:LONGEST]}, which its network does not have"
            )
        for name, usual in KINDS.get(kind, {}).items():
            if (noted := state.get(name, usual[0])) not in usual:
                raise ValueError(f"{path}{name} is {shown(noted)}; in its network {usual[0]}")
        if path.endswith(".relu.") and state.get("inplace") is not True:
            raise ValueError(f"{path[:-1]} does not work in place, as that of its network does")
        for name, value in own.items():
            if isinstance(value, np.ndarray):
                yield f"{path}{name}", value
        todo += [(f"{path}{name}.", module, depth + 1) for name, module in inner.items()]


def _dict(state: dict[Any, Any], name: str) -> dict[Any, Any]:
    found = state.get(name)
    if not isinstance(found, dict) or any(len(str(one)) > LONGEST for one in found):
        raise ValueError(f"one of its modules has no {name}, or a long name")
    return found
