"""A trained network with all that is needed to build it again: saved, loaded, asked for actions."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from astray.agents.impala import Impala
from astray.agents.small import Small

NetworkName = Literal["impala", "small"]


@dataclass(frozen=True)
class Architecture:
    """What network to build.

    shape    of an observation: [H, W, C] for images, [C, H, W] for symbolic planes
    largest  the largest value of each symbolic plane; empty for images
    scale    multiplies the channels of "impala"
    width    hidden units of "small"
    """

    name: NetworkName
    shape: tuple[int, int, int]
    largest: tuple[int, ...]
    actions: int
    scale: int = 1
    width: int = 64

    def build(self) -> nn.Module:
        """The network, freshly initialised from torch's global random state."""
        if (self.name == "impala") != (not self.largest):
            seen = "symbolic planes" if self.largest else "images"
            raise ValueError(f"network {self.name!r} does not see {seen}")
        if self.name == "impala":
            return Impala(self.shape, self.actions, self.scale)
        return Small(self.shape, list(self.largest), self.actions, self.width)


def weights(network: nn.Module, architecture: Architecture) -> bytes:
    """The file that `load` reads: safetensors, the architecture in its header."""
    tensors = {name: tensor.contiguous().cpu() for name, tensor in network.state_dict().items()}
    return save(tensors, {"architecture": json.dumps(asdict(architecture))})


def load(path: Path, device: str = "cpu") -> tuple[nn.Module, Architecture]:
    """The network that `weights` wrote to `path`. Nothing in the file is executed."""
    try:
        with safe_open(path, "pt", device=device) as file:
            meta = json.loads((file.metadata() or {})["architecture"])
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
        shape, largest = tuple(meta.pop("shape")), tuple(meta.pop("largest"))
        architecture = Architecture(shape=shape, largest=largest, **meta)
        network = architecture.build().to(device)
        network.load_state_dict(tensors)
    except FileNotFoundError:
        raise FileNotFoundError(f"no agent at {path}") from None
    except (SafetensorError, OSError, KeyError, TypeError, ValueError, RuntimeError) as error:
        raise ValueError(f"{path} is not an agent of this version: {error}") from error
    return network, architecture


def usable(device: str) -> bool:
    """There is such a device: "cpu", "cuda" or "mps"."""
    if device == "cuda":
        return torch.cuda.is_available()
    return device == "cpu" or torch.backends.mps.is_available()


@torch.no_grad()
def outputs(network: nn.Module, observations: Tensor, chunk: int = 64) -> tuple[Tensor, Tensor]:
    """Logits [B, A] and values [B], the same for an observation whatever stands beside it.

    A matrix product of another size may round differently, so the network always sees exactly
    `chunk` observations, the last ones padded with zeros.
    """
    logits, values = [], []
    for part in observations.split(chunk):
        padding = part.new_zeros((chunk - len(part), *part.shape[1:]))
        some_logits, some_values = network(torch.cat([part, padding]))
        logits.append(some_logits[: len(part)])
        values.append(some_values[: len(part)])
    return torch.cat(logits), torch.cat(values)
