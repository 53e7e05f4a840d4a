"""An imported agent, and checks of its weights."""

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from astray.agents.policy import Architecture, defaults
from astray.validation import brief, shown

Plain = int | float | str | bool | None
SHAPE = (64, 64, 3)  # what Procgen shows
ACTIONS = 15  # that Procgen has
POLICY = re.compile(r"(body\.)?policy\.(weight|bias)")  # recurrent networks have a body
FIRST = re.compile(r"(body\.)?block[123]\.conv\.weight")  # of a block of the IMPALA network


@dataclass(frozen=True)
class Imported:
    """A network with its weights and the file's metadata.

    Attributes:
        about: Description of format and network.
        world: Procgen's name and difficulty of its training environment; None if unknown.
        settings: Settings of its training in the file, under astray's names.
        told: All settings in the file, under its own names.
    """

    network: nn.Module
    architecture: Architecture
    about: str
    world: tuple[str, str] | None = None
    settings: Mapping[str, Plain] = field(default_factory=dict)
    told: Mapping[str, Plain] = field(default_factory=dict)


def plain_settings(settings: Mapping[Any, Any], used: Iterable[str]) -> dict[str, Plain]:
    """Return the settings that are numbers or text; raise ValueError if one of `used` is not."""
    for name in used:
        if not isinstance(said := settings.get(name), Plain):
            raise ValueError(f"its setting {name} must be a number or text; got {shown(said)}")
    return {n: x for n, x in settings.items() if isinstance(n, str) and isinstance(x, Plain)}


def build(make: Callable[[], nn.Module], tensors: Mapping[str, Tensor]) -> Any:
    """Return the made network with these weights; raise ValueError if they do not fit it."""
    try:
        with torch.device("meta"):  # first without memory: a file can promise any size
            wanted = {name: t.shape for name, t in make().state_dict().items()}
    except (RuntimeError, OverflowError) as error:  # widths of weights without a number in them
        raise ValueError(f"its width fits no network: {brief(error)}") from error
    for name in (*tensors, *wanted):
        if name not in wanted:
            raise ValueError(f"it has {name}, which its network does not")
        if name not in tensors:
            raise ValueError(f"it lacks {name}")
        if tensors[name].shape != wanted[name]:
            shapes = tuple(tensors[name].shape), tuple(wanted[name])
            raise ValueError("{} is {}; it would be {}".format(name, *shapes))
        # As the network will have them: numbers of 64 bits may be none in 32.
        if not tensors[name].is_floating_point() or not tensors[name].float().isfinite().all():
            raise ValueError(f"{name} is not all finite numbers")
    with torch.random.fork_rng(devices=[]), defaults("cpu"):
        network = make()
    network.load_state_dict({name: tensor.float() for name, tensor in tensors.items()})
    return network


def of_procgen(
    kind: str, tensors: Mapping[str, Tensor], about: str, *more: Any, **settings: Any
) -> Imported:
    """Return the agent of a network with these weights; `more` are the last fields of `Imported`.

    Raises:
        ValueError: If they do not fit, or are for other actions than Procgen's 15.
    """
    policy = next((t for name, t in tensors.items() if POLICY.fullmatch(name)), None)
    if policy is None:
        raise ValueError("it has no policy of one layer, as agents of images have")
    if policy.ndim and (count := len(policy)) != ACTIONS:
        why = ", of CoinRun as it was before Procgen" if count in (7, 9) else ""
        raise ValueError(f"its policy chooses from {count} actions{why}; Procgen has {ACTIONS}")
    architecture = Architecture(kind, SHAPE, (), ACTIONS, **settings)
    return Imported(build(architecture.build, tensors), architecture, about, *more)


def impala(
    kind: str, tensors: Mapping[str, Tensor], program: str, *more: Any, note: str = ""
) -> Imported:
    """Return `of_procgen`, or raise its ValueError, for an IMPALA network of any channels."""
    firsts = [name for name in sorted(tensors) if FIRST.fullmatch(name)]
    for name in firsts:
        if tensors[name].ndim != 4:
            raise ValueError(f"{name} is {tuple(tensors[name].shape)}; it would have 4 dimensions")
    widths = tuple(len(tensors[name]) for name in firsts)
    called = "IMPALA+gru" if kind.endswith("+gru") else "IMPALA"
    about = f"{program}: {called}, channels {'/'.join(map(str, widths))}{note}"
    return of_procgen(kind, tensors, about, *more, widths=widths)


def turned(kernel: np.ndarray, side: int = 0) -> Tensor:
    """Return a kernel of Flax or TensorFlow in torch's layout: [out, in, ...].

    Args:
        kernel: [height, width, in, out], or of a dense layer [in, out].
        side: Pixels a side of a picture that a dense layer sees, ordered by rows, columns, channels
            there and by channels first here; 0 for other inputs.

    Raises:
        ValueError: If it has another number of axes.
    """
    if kernel.ndim == 4:
        return torch.from_numpy(kernel.transpose(3, 2, 0, 1).copy())
    if kernel.ndim != 2:
        raise ValueError(
            f"the kernel of a dense layer must be [inputs, outputs]; got {kernel.shape}"
        )
    if side and len(kernel) % side**2 == 0:
        pixels = kernel.reshape(side, side, len(kernel) // side**2, kernel.shape[1])
        kernel = pixels.transpose(2, 0, 1, 3).reshape(kernel.shape)
    return torch.from_numpy(kernel.T.copy())


def rename(name: str, names: Iterable[tuple[Any, Any]]) -> str:
    """Return a name after each replacement of a pattern, (pattern, replacement) in `names`."""
    for there, here in names:
        name = re.sub(there, here, name)
    return name
