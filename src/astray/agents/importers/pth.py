"""Importer of IMPALA agents from train-procgen-pytorch, as in the paper, and two other programs.

Files hold weights by name, either directly or under `model_state_dict` (older: `state_dict`), some
with the optimizer's state. train-procgen-pfrl and CleanRL's ppo_procgen compute the same network
under other names, with any channels: images are divided by 255, actions are sampled. Recurrent
agents of train-procgen-pytorch have a GRU between the network and its heads.
"""

import io
import re
import warnings
import zipfile
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from astray.agents.importers import plain, rllte
from astray.agents.importers.archive import opened
from astray.agents.importers.imported import Imported, impala, rename
from astray.validation import shown

# Kinds of numbers in weights, and their bytes.
SIZES = {"Double": 8, "Long": 8, "Float": 4, "Int": 4, "Half": 2, "BFloat16": 2, "Short": 2,
         "Char": 1, "Byte": 1, "Bool": 1}  # fmt: skip
# What weights are made of. Torch itself lets a file make empty memory of any size, as bytearrays.
MADE_OF = re.compile(
    rf"collections OrderedDict|torch ({'|'.join(SIZES)})Storage|"
    r"torch\._utils _rebuild_(tensor(_v2)?|parameter)"
)
OLD_PICKLES = 5  # before the weights: a mark, the version, the machine, the data, keys of weights
OTHERS = {"version", "byteorder"}  # parts of an archive besides its data
HOLDS = ("model_state_dict", "state_dict")


@dataclass(frozen=True)
class Names:
    """A program's names for the weights of its IMPALA network.

    Attributes:
        heads: Weights of the first convolution and the policy, which every such file has.
        renamed: Pairs (regular expression, replacement) that yield astray's names.
    """

    program: str
    heads: tuple[str, str]
    renamed: tuple[tuple[str, str | Callable[[re.Match[str]], str]], ...]


def _plus_one(match: re.Match[str]) -> str:
    """Return the match with each number increased by one: that program counts from 0."""
    return re.sub(r"\d", lambda digit: str(int(digit[0]) + 1), match[0])


PROGRAMS = (
    Names("train-procgen-pytorch", ("embedder.block1.conv.weight", "fc_policy.weight"), (
        (r"^embedder\.fc\.", "features.linear."), (r"^embedder\.", ""),
        (r"\.res(?=\d)", ".residual"), (r"^fc_", ""), (r"^gru\.gru\.(.*)_l0$", r"cell.\1"),
    )),
    Names("train-procgen-pfrl", ("conv_seqs.0.conv.weight", "logits_fc.weight"), (
        (r"^conv_seqs\.\d|res_block\d|conv\d", _plus_one), (r"^conv_seqs\.", "block"),
        (r"\.res_block", ".residual"), (r"^hidden_fc\.", "features.linear."),
        (r"^logits_fc\.", "policy."), (r"^value_fc\.", "value."),
    )),
    Names("CleanRL's ppo_procgen", ("network.0.conv.weight", "actor.weight"), (
        (r"^network\.5\.", "features.linear."), (r"^network\.\d|res_block\d|conv\d", _plus_one),
        (r"^network\.", "block"), (r"\.res_block", ".residual"),
        (r"^actor\.", "policy."), (r"^critic\.", "value."),
    )),
)  # fmt: skip


def read(data: bytes) -> Imported:
    """Return the agent in the bytes of a .pth or .pt file.

    Raises:
        ValueError: If the bytes are damaged, hold more than weights, or another network.
    """
    if rllte.is_module(data):
        return rllte.read(data)
    tensors = weights(data)
    names = next((one for one in PROGRAMS if set(one.heads) <= set(tensors)), None)
    if names is None:
        there = ", ".join(list(tensors)[:3])
        programs = " or ".join(one.program for one in PROGRAMS)
        raise ValueError(f"it is not an IMPALA network of {programs}: its weights are {there}, ...")
    renamed = {rename(name, names.renamed): tensor for name, tensor in tensors.items()}
    if len(renamed) < len(tensors):
        raise ValueError("it has two weights of the same layer, under two names")
    if not any(name.startswith("cell.") for name in renamed):
        return impala("impala", renamed, names.program)
    renamed = {n if n.startswith("cell.") else f"body.{n}": t for n, t in renamed.items()}
    return impala("impala+gru", renamed, names.program)


def weights(data: bytes) -> dict[str, Tensor]:
    """Return the weights by name in the bytes of a file that torch wrote; nothing in it is run.

    Raises:
        ValueError: If the bytes are damaged or hold more than weights.
    """
    file = _checked(data)
    try:
        with warnings.catch_warnings(action="ignore"):  # of a format that it then refuses
            found = torch.load(file, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises nearly anything for what is no file of its own
        first = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise ValueError(f"it is damaged, or not a file of torch: {first}") from error
    return _tensors(found, len(data))


def _checked(data: bytes) -> io.BytesIO:
    """Return a file with the weights in a file of torch, and nothing that torch does not need.

    Its pickles are read by `plain` first, whose work is bounded. Torch hashes any key: a tuple of
    two equal tuples of two equal tuples and so on takes 2**depth steps. It copies a dictionary each
    time that a file says so, and before 2.13 it takes weights from beyond a part that is too short.

    Raises:
        ValueError: If the pickles contain more than weights.
    """
    asked: dict[str, int] = {}

    def noted(kind: str, key: str, count: int) -> None:
        asked[key] = max(asked.get(key, 0), count * SIZES[kind[len("torch ") : -len("Storage")]])

    if not data.startswith(b"PK"):  # as torch wrote them before 1.6: pickles, then the weights
        file = io.BytesIO(data)
        *_, keys = [plain.read(file, noted, MADE_OF) for _ in range(OLD_PICKLES)]
        is_whole = type(keys) is list and {*map(type, keys)} <= {str} and {*keys} == asked.keys()
        if not is_whole or sum(asked.values()) > len(data):  # what is not a key is not filled
            raise ValueError("its weights are more than the file holds, or have no names")
        return io.BytesIO(data)
    kept = io.BytesIO()
    # Torch finds parts otherwise than Python: of any case, and in another table of contents.
    with opened(data) as (archive, home, raw), zipfile.ZipFile(kept, "w") as copy:
        plain.read(raw, noted, MADE_OF)
        copy.writestr("archive/data.pkl", raw)
        for part in OTHERS & {one.removeprefix(f"{home}/") for one in archive.namelist()}:
            copy.writestr(f"archive/{part}", archive.read(f"{home}/{part}"))
        names = {*map(str.lower, asked)}
        for key, size in asked.items():
            numbers = archive.read(f"{home}/data/{key}")
            if len(numbers) < size or len(names) < len(asked):
                raise ValueError("its weights are more than the file holds, or have one name")
            copy.writestr(f"archive/data/{key}", numbers)
    return io.BytesIO(kept.getvalue())


def _tensors(found: Any, size: int) -> dict[str, Tensor]:
    """Return the weights by name; none can be larger than the file of `size` bytes."""
    for name in HOLDS:
        if isinstance(found, Mapping) and isinstance(found.get(name), Mapping):
            found = found[name]
    if not isinstance(found, Mapping) or not found:
        raise ValueError(f"it holds a {type(found).__name__}, not weights by name")
    tensors = dict(found)
    wrong = [n for n, t in tensors.items() if not (isinstance(n, str) and isinstance(t, Tensor))]
    if wrong:
        raise ValueError(
            f"it holds {shown(wrong[0])}, which is not a weight; {' or '.join(HOLDS)} has all"
        )
    if sum(t.numel() * t.element_size() for t in tensors.values()) > size:
        raise ValueError("its weights are more than the file holds")
    return tensors
