"""Agents of train-procgen-pytorch, which the paper's were trained with: IMPALA, any channels.

Its files hold the weights under `model_state_dict` (older ones `state_dict`), some the
optimizer's state beside them. Images are divided by 255, actions drawn from the policy.
"""

from __future__ import annotations

import io
import pickle
import re
import warnings
from collections.abc import Mapping
from typing import Any

import torch
from torch import Tensor

from astray.agents.importers.imported import ACTIONS, SHAPE, Imported, build, check_actions
from astray.agents.policy import Architecture

HOLDS = ("model_state_dict", "state_dict")
RENAMED = (("embedder.fc.", "features.linear."), ("embedder.", ""), (".res", ".residual"),
           ("fc_", ""))  # fmt: skip


def read(data: bytes) -> Imported:
    """The agent in the bytes of a .pth file; ValueError says why it is none."""
    tensors = _tensors(_load(data), len(data))
    if any(name.startswith("gru.") for name in tensors):
        raise ValueError("it is a recurrent agent; only feed-forward ones are read")
    if "fc_policy.weight" not in tensors or "embedder.block1.conv.weight" not in tensors:
        names = ", ".join(list(tensors)[:3])
        raise ValueError(f"it is no IMPALA of train-procgen-pytorch: its weights are {names}, ...")
    check_actions(len(tensors["fc_policy.weight"]))
    renamed = {_rename(name): tensor for name, tensor in tensors.items()}
    convolutions = [renamed.get(f"block{k}.conv.weight") for k in (1, 2, 3)]
    widths = tuple(len(c) for c in convolutions if c is not None and c.ndim == 4)
    architecture = Architecture("impala", SHAPE, (), ACTIONS, widths=widths)
    about = f"train-procgen-pytorch: IMPALA, channels {'/'.join(map(str, widths))}"
    return Imported(build(architecture, renamed), architecture, about)


def _load(data: bytes) -> Any:
    try:
        with warnings.catch_warnings(action="ignore"):  # of a format that it then refuses
            return torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        # What torch says besides is how to run the file all the same.
        why = re.search(r"GLOBAL (\S+)", str(error))
        raise ValueError(
            "it holds more than weights, or is damaged, and nothing in a file is run"
            + (f": it asks for {why[1]}" if why else "")
        ) from error
    except Exception as error:  # torch raises nearly anything for what is no file of its own
        first = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise ValueError(f"it is damaged, or no file of torch: {first}") from error


def _tensors(found: Any, size: int) -> dict[str, Tensor]:
    """The weights by name; none can be larger than the file of `size` bytes."""
    for name in HOLDS:
        if isinstance(found, Mapping) and isinstance(found.get(name), Mapping):
            found = found[name]
    if not isinstance(found, Mapping) or not found:
        raise ValueError(f"it holds a {type(found).__name__}, not weights by name")
    tensors = dict(found)
    wrong = [n for n, t in tensors.items() if not (isinstance(n, str) and isinstance(t, Tensor))]
    if wrong:
        raise ValueError(f"it holds {wrong[0]!r}, which is no weight; {' or '.join(HOLDS)} has all")
    if sum(t.numel() * t.element_size() for t in tensors.values()) > size:
        raise ValueError("its weights are more than the file holds")
    return tensors


def _rename(name: str) -> str:
    for there, here in RENAMED:
        name = name.replace(there, here)
    return name
