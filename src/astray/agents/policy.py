"""Files of trained networks, with all that is needed to rebuild and evaluate them."""

import contextlib
import json
import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import torch
from safetensors import SafetensorError
from safetensors.torch import load as from_bytes
from safetensors.torch import save
from torch import Tensor, nn

from astray import imports
from astray.agents.cells import Cells
from astray.agents.clear import Clear
from astray.agents.drc import DRC
from astray.agents.impala import WIDTHS, Impala
from astray.agents.mlp import MLP
from astray.agents.names import check_network, depth_and_ticks, is_own
from astray.agents.patch import nature, overlap, patch, patch_impala, strided_impala
from astray.agents.recurrent import WithCell
from astray.files import read
from astray.validation import MOST, brief, shown

GROUP = "astray.networks"  # of entry points, by which installed packages offer theirs
LARGEST = 2**20  # bytes of a file's header; those of agents have some 3,000
MOST_SEEN = 2**25  # numbers of an observation: a picture of 4K has 25 million
FORMAT = 1  # of the files; goes up when an older version could not read them
ROUNDED = 1e-3  # part of a logit by which rounding may change it
SEQUENCES = ("shape", "largest", "widths")  # fields of an architecture that JSON has as lists


@contextlib.contextmanager
def defaults(device: str | None = None) -> Iterator[None]:
    """Make float32 torch's default, and `device`, both of which the program may have changed."""
    before, there = torch.get_default_dtype(), torch.get_default_device().type
    torch.set_default_dtype(torch.float32)
    try:  # a device of its own slows down every call of torch
        with torch.device(device) if device and device != there else contextlib.nullcontext():
            yield
    finally:
        torch.set_default_dtype(before)


@dataclass(frozen=True)
class Architecture:
    """Description of a network; the only argument of a custom one.

    Attributes:
        name: One of `names.NETWORKS`, or "module:Class".
        shape: Shape of an observation: [H, W, C] for images, [C, H, W] for symbolic planes, [D] for
            vectors.
        largest: Largest value of each symbolic plane; empty for images and vectors.
        scale: Multiplies the channels of convolutions, except in "clear" and "nature".
        width: Hidden units of "mlp".
        widths: Channels of "impala"'s three blocks, at scale 1.
    """

    name: str
    shape: tuple[int, ...]
    largest: tuple[int, ...]
    actions: int
    scale: int = 1
    width: int = 64
    widths: tuple[int, ...] = WIDTHS

    def __post_init__(self) -> None:
        sizes = (self.actions, self.scale, self.width, *self.shape, *self.largest, *self.widths)
        are_sizes = all(type(n) is int and 1 <= n <= MOST for n in sizes)
        if not are_sizes or not self.shape or len(self.widths) != 3:
            raise ValueError(f"sizes of networks must be integers from 1 to {MOST}; got {self}")
        if math.prod(self.shape) > MOST_SEEN:  # on which no weights of some networks depend
            told = f"at most {MOST_SEEN:,} numbers; its shape is {shown(self.shape)}"
            raise ValueError(f"an observation must have {told}")
        if self.largest and len(self.largest) != self.shape[0]:
            raise ValueError(f"`largest` must have a number for each plane; got {self}")
        check_network(self.name)

    @defaults()
    def build(self) -> nn.Module:
        """Build the network, initialised from torch's global random state.

        Raises:
            ValueError: If it is neither astray's own nor known: see `imports.known`.
        """
        if not is_own(self.name):
            return imports.known(self.name, GROUP, nn.Module)(self)
        name, _, cell = self.name.partition("+")
        if cell:
            return WithCell(replace(self, name=name).build(), cell)  # pyrefly: ignore
        if deep := depth_and_ticks(name):
            return DRC(self.shape, list(self.largest), self.actions, *deep, self.scale)
        vectors = "vectors" if len(self.shape) == 1 else "images"
        seen = "symbolic planes" if self.largest else vectors
        if (self.name == "mlp") == (seen == "images") or len(self.shape) == 2:
            raise ValueError(f"network {self.name!r} does not see {seen}")
        return BUILDERS[self.name](self)


BUILDERS: dict[str, Callable[[Architecture], nn.Module]] = {
    "impala": lambda given: Impala(given.shape, given.actions, given.scale, given.widths),
    "impala-same": lambda given: Impala(
        given.shape, given.actions, given.scale, given.widths, same=True
    ),
    "impala-rectified": lambda given: Impala(
        given.shape, given.actions, given.scale, given.widths, rectified=True
    ),
    "mlp": lambda given: MLP(given.shape, list(given.largest), given.actions, given.width),
    "clear": lambda given: Clear(given.shape, given.actions),
    "nature": lambda given: nature(given.shape, given.actions),
    "overlap": lambda given: overlap(given.shape, given.actions, given.scale),
    "patch": lambda given: patch(given.shape, given.actions, given.scale),
    "patch-pooled": lambda given: patch(given.shape, given.actions, given.scale, pooled=True),
    "patch-impala": lambda given: patch_impala(given.shape, given.actions, given.scale),
    "strided-impala": lambda given: strided_impala(given.shape, given.actions, given.scale),
    "cells": lambda given: Cells(given.shape, given.actions, given.scale),
}


def weights(network: nn.Module, architecture: Architecture, game: str) -> bytes:
    """Return the file that `load` reads: safetensors, with the architecture in its header."""
    told = network.state_dict().items()
    # Copies, as safetensors refuses what shares memory: a layer may have two names.
    tensors = {name: x.cpu().clone(memory_format=torch.contiguous_format) for name, x in told}
    return save(tensors, header(game, architecture=asdict(architecture)))


def load(path: Path, game: str, device: str = "cpu") -> tuple[nn.Module, Architecture]:
    """Load the network that `weights` wrote to `path`, without executing anything in the file.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not an agent of this game.
    """
    with _explained(path), defaults("cpu"):
        tensors, architecture = _read(path, game)
        promised = (empty := hollow(architecture)).state_dict()  # a header can promise any size
        _check_weights({n: t for n, t in tensors.items() if n in promised}, empty)
        _check_weights(tensors, network := architecture.build())
        network.load_state_dict(tensors)
        return network.to(device).eval(), architecture


@contextlib.contextmanager
def evaluating(network: nn.Module) -> Iterator[nn.Module]:
    """Put a module into evaluation mode, and afterwards each of its parts back into its own."""
    parts = [part for part in network.modules() if part.training]
    network.eval()
    try:
        yield network
    finally:
        for part in parts:
            part.training = True


def hollow(architecture: Architecture, build: Any = Architecture.build) -> nn.Module:
    """Build a network without memory for its weights, unless its own code reads numbers."""
    try:
        with torch.device("meta"):
            return build(architecture)
    except RuntimeError as error:
        if "meta tensor" not in f"{error}":
            raise
    with torch.random.fork_rng([]):
        return build(architecture)


def load_into(network: nn.Module, path: Path, game: str, **known: Any) -> None:
    """Load an agent's weights; raise FileNotFoundError or ValueError as `read_weights` does."""
    tensors = read_weights(path, game, **known)
    with _explained(path):
        _check_weights(tensors, network)
        network.load_state_dict(tensors)


def read_weights(path: Path, game: str, **known: Any) -> dict[str, Tensor]:
    """Return the weights of an agent.

    Args:
        known: Fields of the architecture that it must have.

    Raises:
        FileNotFoundError: If there is no such file.
        ValueError: If it is not an agent of this game, or of another network.
    """
    with _explained(path):
        tensors, its = _read(path, game)
    check_known(path, its, **known)
    return tensors


def check_known(path: Path, its: Architecture, **known: Any) -> None:
    """Raise ValueError unless the network in an agent's file has the fields `known`."""
    differ = [name for name, wanted in known.items() if getattr(its, name) != wanted]
    if differ:
        told = (f"{n} {getattr(its, n)}, where the settings say {known[n]}" for n in differ)
        raise ValueError(f"{path} is not an agent that can be used: it has {'; '.join(told)}")


def _check_weights(tensors: dict[str, Tensor], network: nn.Module) -> None:
    """Raise ValueError unless `tensors` have the names, shapes and dtypes of such a network."""
    promised = network.state_dict()
    if {n: t.shape for n, t in promised.items()} != {n: t.shape for n, t in tensors.items()}:
        raise ValueError("its weights are not those of its architecture")
    for name, tensor in tensors.items():  # torch would convert them, also to infinity
        if tensor.dtype != promised[name].dtype:
            kinds = f"{promised[name].dtype}; they are {tensor.dtype}"
            raise ValueError(f"its weights {name!r} must be {kinds}")


def _read(path: Path, game: str) -> tuple[dict[str, Tensor], Architecture]:
    tensors, found = read_tensors(path, game)
    if not all(x.isfinite().all() for x in tensors.values() if x.is_floating_point()):
        raise ValueError("its weights are not all finite numbers")
    data: Any = found["architecture"]
    if not isinstance(data, dict) or not all(isinstance(data.get(k), list) for k in SEQUENCES):
        raise ValueError(f"its architecture is {data!r}; it must name a network and its sizes")
    fields: dict[str, Any] = data | {name: tuple(data[name]) for name in SEQUENCES}
    return tensors, Architecture(**fields)


def read_tensors(path: Path, game: str) -> tuple[dict[str, Tensor], dict[str, Any]]:
    """Return the tensors of a safetensors file and its `header`.

    It is not mapped: a mapped file that shrinks kills the process, and Windows could not delete it.

    Raises:
        ValueError: If its header has more than LARGEST bytes, or is none of astray's.
    """
    data = read(path)
    if (size := int.from_bytes(data[:8], "little")) > LARGEST:  # 22 MB took 20 s and 0.4 GB
        raise ValueError(f"its header must be of at most {LARGEST:,} bytes; it has {size:,}")
    tensors = from_bytes(data)
    return tensors, read_header(json.loads(data[8 : 8 + size]).get("__metadata__"), game)


@contextlib.contextmanager
def _explained(path: Path) -> Iterator[None]:
    """Turn every error about an agent's file into one kind."""
    try:
        yield
    except (SafetensorError, OSError, KeyError, TypeError, ValueError, RuntimeError) as error:
        if isinstance(error, FileNotFoundError) and not path.exists():  # else a library's own
            raise FileNotFoundError(f"no agent at {path}") from None
        raise ValueError(f"{path} is not an agent that can be used: {brief(error)}") from error


def header(game: str, **more: Any) -> dict[str, str]:
    """Return a safetensors header with one entry, because the library shuffles several."""
    return {"astray": json.dumps({"format": FORMAT, "game": game} | more)}


def read_header(kept: dict[str, str] | None, game: str) -> dict[str, Any]:
    """Parse the result of `header`; raise ValueError if the version or game differs."""
    found = json.loads((kept or {}).get("astray", "null"))
    if not isinstance(found, dict):
        raise ValueError("it was not written by astray")
    if found.get("format") != FORMAT:
        raise ValueError(f"it has format {found.get('format')}; this version reads {FORMAT}")
    if found.get("game") != game:
        raise ValueError(f"it is of the game {found.get('game')!r}, not of {game!r}")
    return found


def usable(device: str) -> bool:
    """Return whether the device exists: "cpu", "cuda" or "mps"."""
    if device == "cuda":
        return torch.cuda.is_available()
    return device == "cpu" or torch.backends.mps.is_available()


@torch.no_grad()
def products(network: nn.Module, shape: tuple[int, ...], device: str = "cpu") -> int:
    """Return the number of multiplications by weights for one observation of that shape.

    torch's own counter takes a second of each process to begin with.
    """
    found = 0

    def note(module: nn.Module, _: Any, result: Any) -> None:
        nonlocal found
        each = result[0] if isinstance(result, tuple) else result
        places = each[0].numel() // each.shape[1 if each.ndim == 4 else -1]
        found += places * sum(w.numel() for w in module.parameters(False) if w.ndim > 1)

    with contextlib.ExitStack() as stack:
        for one in network.modules():
            if isinstance(one, nn.Linear | nn.Conv2d | nn.RNNCellBase):
                stack.callback(one.register_forward_hook(note).remove)
        kind = torch.uint8 if len(shape) == 3 else torch.float32
        network(torch.zeros((1, *shape), dtype=kind, device=device))
    return found


@torch.no_grad()
def outputs(
    network: Callable[..., tuple[Tensor, ...]],
    observations: Tensor,
    chunk: int = 64,
    *memory: Tensor,
) -> tuple[Tensor, ...]:
    """Return logits [B, A] and values [B], independent of the other observations in the batch.

    Matrix products of different sizes may round differently. The network therefore always sees
    exactly `chunk` observations, padded with zeros.

    Args:
        memory: For a network with memory, its states and first-step flags [B]; the next states [B,
            ...] are then returned too.

    Raises:
        ValueError: If the network does not return a row for each observation.
    """
    found = []
    for parts in zip(*(x.split(chunk) for x in (observations, *memory)), strict=True):
        n = len(parts[0])
        padded = (torch.cat([x, x.new_zeros((chunk - n, *x.shape[1:]))]) for x in parts)
        answer = network(*padded)
        if wrong := [x.shape for x in answer if x.shape[:1] != (chunk,)]:
            raise ValueError(f"a network must give {chunk} rows, one per observation; got {wrong}")
        found.append([x[:n] for x in answer])
    return tuple(torch.cat(column) for column in zip(*found, strict=True))


def check_independent(
    network: Any, observation: Tensor, logits: Tensor, chunk: int, name: str
) -> None:
    """Check that `logits` [A] of one observation [...] are the same in a batch of its copies.

    Raises:
        ValueError: If they are not.
    """
    copies = observation.expand(chunk, *observation.shape)
    # An LSTM without batches takes the rows for steps: the first is right, and the others are not.
    change = (outputs(network, copies, chunk)[0] - logits).abs().max()
    if change > ROUNDED * logits.abs().max():
        again = (outputs(network, copies, chunk)[0] - logits).abs().max()
        cause = "the others of its batch" if again == change else "every call, as with dropout"
        raise ValueError(
            f"{name} must give logits that depend on one observation alone; those of the first "
            f"change by {change:.2g} with {cause}"
        )
