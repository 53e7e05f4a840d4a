"""A perceptron with two hidden layers for symbolic observations, which a CPU trains in minutes."""

import math
from typing import Any

import torch
from torch import Tensor, nn

from astray.agents.actor_critic import ActorCritic, dense


class CircleEmbedding(nn.Module):
    """Planes of categories [B, C, H, W] uint8 -> float planes [B, channels, H, W].

    Binary planes stay. In a plane with more categories, each becomes a point on the unit circle,
    evenly spaced, and 0 (nothing) the centre. So a plane becomes two, where one-hot
    planes would turn Maze's 4 into 14, with a single table look-up that needs no gradient.

    Args:
        largest: Largest category of each plane, binary planes first.
    """

    def __init__(self, largest: list[int]):
        super().__init__()
        self.flags = sum(top == 1 for top in largest)
        if any(top != 1 for top in largest[: self.flags]):
            raise ValueError(f"planes of 0 and 1 must come first; got planes up to {largest}")
        self.planes, self.channels = len(largest), self.flags + 2 * (len(largest) - self.flags)
        # On "meta" torch would load its compiler for this, which takes a second.
        angle = torch.arange(256, device="cpu") * (2 * torch.pi / max(largest))
        circle = torch.stack([angle.cos(), angle.sin()]).float()
        circle[:, 0] = 0
        self.circle: Tensor
        self.register_buffer("circle", circle, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        planes = x.new_empty((len(x), self.channels, *x.shape[2:]), dtype=torch.float32)
        planes[:, : self.flags] = x[:, : self.flags]
        if self.channels > self.flags:
            categories = x[:, self.flags :]
            flat, k = categories.int().flatten(), categories.shape[1]
            for axis in range(2):
                first = self.flags + axis * k
                picked = self.circle[axis].index_select(0, flat)
                planes[:, first : first + k] = picked.view(categories.shape)
        return planes


class MLP(ActorCritic):
    """Symbolic planes [B, C, H, W] uint8 -> logits [B, actions], values [B].

    Vectors [B, D] float32 have no `largest`, and are not embedded.
    """

    spread: Any  # embedding of planes; the identity for vectors

    def __init__(self, shape: tuple[int, ...], largest: list[int], actions: int, width: int = 64):
        super().__init__()
        self.spread = CircleEmbedding(largest) if largest else nn.Identity()
        channels = self.spread.channels if isinstance(self.spread, CircleEmbedding) else shape[0]
        self.inputs = channels * math.prod(shape[1:])
        self.features = dense(self.inputs, width, width)
        self.add_heads(width, actions)

    def hidden(self, observations: Tensor) -> Tensor:
        return self.features(self.spread(observations))
