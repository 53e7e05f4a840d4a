"""An imported agent, and checks of its weights."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor, nn

from astray.agents.policy import Architecture
from astray.validation import brief

Plain = int | float | str | bool | None
SHAPE = (64, 64, 3)  # what Procgen shows
ACTIONS = 15  # that Procgen has


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
    with torch.random.fork_rng(devices=[]):
        network = make()
    network.load_state_dict({name: tensor.float() for name, tensor in tensors.items()})
    return network


def check_actions(policy: Tensor) -> None:
    """Raise ValueError unless weights [actions, ...] are for Procgen's 15 actions."""
    count = len(policy) if policy.ndim else 0
    if count != ACTIONS:
        why = ", of CoinRun as it was before Procgen" if count in (7, 9) else ""
        raise ValueError(f"its policy chooses from {count} actions{why}; Procgen has {ACTIONS}")
