"""Importer of IMPALA agents from train-procgen-pytorch, as in the paper, and two other programs.

Files hold weights by name, either directly or under `model_state_dict` (older: `state_dict`), some
with the optimizer's state. train-procgen-pfrl and CleanRL's ppo_procgen compute the same network
under other names, with any channels: images are divided by 255, actions are sampled. Recurrent
agents of train-procgen-pytorch have a GRU between the network and its heads.
"""

import contextlib
import io
import pickle
import pickletools
import re
import warnings
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from astray.agents.importers import rllte
from astray.agents.importers.imported import ACTIONS, SHAPE, Imported, build, check_actions
from astray.agents.policy import Architecture
from astray.validation import shown

MOST_AGAIN = 16  # times that a file takes a tuple out of its memo; those of torch never do
MOST_TUPLES = 10_000  # of a file; those of IMPALA and its optimizer take some hundreds
# What weights are made of. Torch itself lets a file make empty memory of any size, as bytearrays.
MADE_OF = re.compile(
    r"collections OrderedDict|torch \w+Storage|torch\._utils _rebuild_(tensor(_v2)?|parameter)"
)
# Instructions after which what is on top is no tuple.
MAKES_OTHERS = {
    "BINUNICODE", "SHORT_BINUNICODE", "GLOBAL", "STACK_GLOBAL", "EMPTY_DICT", "EMPTY_LIST",
    "BINPERSID", "REDUCE", "NEWOBJ", "BUILD", "SETITEM", "SETITEMS", "APPEND", "APPENDS",
    "SHORT_BINBYTES", "BINBYTES", "LONG1",
}  # fmt: skip
LARGEST_PICKLE = 64_000_000  # bytes; the names and shapes of weights take some 10,000
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
    Names(
        "train-procgen-pytorch",
        ("embedder.block1.conv.weight", "fc_policy.weight"),
        (
            (r"^embedder\.fc\.", "features.linear."),
            (r"^embedder\.", ""),
            (r"\.res(?=\d)", ".residual"),
            (r"^fc_", ""),
            (r"^gru\.gru\.(.*)_l0$", r"cell.\1"),
        ),
    ),
    Names(
        "train-procgen-pfrl",
        ("conv_seqs.0.conv.weight", "logits_fc.weight"),
        (
            (r"^conv_seqs\.\d|res_block\d|conv\d", _plus_one),
            (r"^conv_seqs\.", "block"),
            (r"\.res_block", ".residual"),
            (r"^hidden_fc\.", "features.linear."),
            (r"^logits_fc\.", "policy."),
            (r"^value_fc\.", "value."),
        ),
    ),
    Names(
        "CleanRL's ppo_procgen",
        ("network.0.conv.weight", "actor.weight"),
        (
            (r"^network\.5\.", "features.linear."),
            (r"^network\.\d|res_block\d|conv\d", _plus_one),
            (r"^network\.", "block"),
            (r"\.res_block", ".residual"),
            (r"^actor\.", "policy."),
            (r"^critic\.", "value."),
        ),
    ),
)


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
    check_actions(tensors[names.heads[1]])
    renamed = {rllte.rename(name, names.renamed): tensor for name, tensor in tensors.items()}
    if len(renamed) < len(tensors):
        raise ValueError("it has two weights of the same layer, under two names")
    convolutions = [renamed.get(f"block{k}.conv.weight") for k in (1, 2, 3)]
    widths = tuple(len(c) for c in convolutions if c is not None and c.ndim == 4)
    cell = "+gru" if any(name.startswith("cell.") for name in renamed) else ""
    if cell:
        renamed = {n if n.startswith("cell.") else f"body.{n}": t for n, t in renamed.items()}
    architecture = Architecture(f"impala{cell}", SHAPE, (), ACTIONS, widths=widths)
    about = f"{names.program}: IMPALA{cell}, channels {'/'.join(map(str, widths))}"
    return Imported(build(architecture.build, renamed), architecture, about)


def weights(data: bytes) -> dict[str, Tensor]:
    """Return the weights by name in the bytes of a file that torch wrote; nothing in it is run.

    Raises:
        ValueError: If the bytes are damaged or hold more than weights.
    """
    return _tensors(_load(data), len(data))


def _load(data: bytes) -> Any:
    check_plain(data)
    try:
        with warnings.catch_warnings(action="ignore"):  # of a format that it then refuses
            return torch.load(io.BytesIO(data), map_location="cpu", weights_only=True)
    except pickle.UnpicklingError as error:
        # What torch says besides is how to run the file all the same.
        why = re.search(r"GLOBAL (\S+)", str(error))
        raise ValueError(_more(why[1] if why else "")) from error
    except Exception as error:  # torch raises nearly anything for what is no file of its own
        first = (str(error).strip().splitlines() or [type(error).__name__])[0]
        raise ValueError(f"it is damaged, or not a file of torch: {first}") from error


def _more(asked: str) -> str:
    """Return the reason for refusing a file that asks for a class or a function, if known."""
    more = "it holds more than weights, or is damaged, and nothing in a file is run"
    return f"{more}: it asks for {asked}" if asked else more


def check_plain(data: bytes) -> None:
    """Raise ValueError if the pickles in a file contain more than weights need.

    A tuple of two equal tuples of two equal tuples and so on is short, but takes 2**depth steps to
    hash: as a key it would keep torch busy for ever. One nested 100,000 deep would crash it.
    """
    try:
        with rllte.stored(data) as archive:
            inside = [one for one in archive.infolist() if one.filename.endswith("data.pkl")]
            if sum(one.file_size for one in inside) > LARGEST_PICKLE:
                raise ValueError(f"its data.pkl has more than {LARGEST_PICKLE:,} bytes")
            pickles = [archive.read(one) for one in inside]
    except rllte.BROKEN as error:
        if data.startswith(b"PK"):  # to torch it may be a whole one
            raise ValueError(f"it is damaged, or not a file of torch: {error}") from error
        pickles = [data]  # as torch wrote them before 1.6
    for raw in pickles:
        again, tuples, is_tuple = 0, 0, {}  # the latter as the memo's entries
        asked: list[str] = []
        with contextlib.suppress(Exception):  # what is no pickle torch refuses
            file = io.BytesIO(raw)
            while file.tell() < len(raw):
                before = ""
                for instruction, argument, _ in pickletools.genops(file):
                    name = instruction.name
                    tuples += name.startswith("TUPLE")
                    if name in ("BINPUT", "LONG_BINPUT", "PUT", "MEMOIZE"):
                        entry = len(is_tuple) if name == "MEMOIZE" else argument
                        is_tuple[entry] = before not in MAKES_OTHERS
                    elif name in ("BINGET", "LONG_BINGET", "GET"):
                        again += is_tuple.get(argument, False)
                    elif name == "DUP":
                        again += MOST_AGAIN + 1
                    elif name == "GLOBAL" and not MADE_OF.fullmatch(str(argument)):
                        asked.append(str(argument).replace(" ", "."))
                    before = name
        if asked:
            raise ValueError(_more(shown(asked[0])[1:-1]))
        if again > MOST_AGAIN:
            raise ValueError("it uses the same tuple many times, which weights do not need")
        if tuples > MOST_TUPLES:
            raise ValueError(f"it has more than {MOST_TUPLES:,} tuples, which weights do not need")


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
