"""Networks for images that a CPU trains: their first convolution goes 4 or 8 pixels a step.

Nearly all products of the paper's network are in its first two blocks, on 64 x 64 and 32 x 32
places; here there are 16 x 16 at most. Every activation is a named module, so that hooks can read
and change it: `body.relu1`, `body.residual1.relu2`, `features.relu`, ...
"""

from __future__ import annotations

from collections import OrderedDict

import torch
from torch import Tensor, nn

from astray.agents.actor_critic import Pixels
from astray.agents.impala import Residual, block


class Convolutions(Pixels):
    """Images [B, H, W, C] uint8 -> logits [B, actions], values [B].

    layers    by name, one after another, of planes [B, C, H, W]
    features  units of the dense layer before the heads
    """

    def __init__(
        self, layers: dict[str, nn.Module], shape: tuple[int, int, int], actions: int, features: int
    ):
        super().__init__()
        self.body = nn.Sequential(OrderedDict(layers))
        height, width, channels = shape
        with torch.no_grad():
            inputs = self.body(torch.zeros(1, channels, height, width)).numel()
        self.features = nn.Sequential(
            OrderedDict(flatten=nn.Flatten(), linear=nn.Linear(inputs, features), relu=nn.ReLU())
        )
        self.add_heads(features, actions)

    def see(self, planes: Tensor) -> Tensor:
        return self.body(planes)


def nature(shape: tuple[int, int, int], actions: int) -> Convolutions:
    """The network of Mnih et al. 2015, as Stable-Baselines3's `CnnPolicy` has it."""
    layers = {
        "conv1": nn.Conv2d(shape[2], 32, 8, stride=4),
        "relu1": nn.ReLU(),
        "conv2": nn.Conv2d(32, 64, 4, stride=2),
        "relu2": nn.ReLU(),
        "conv3": nn.Conv2d(64, 64, 3),
        "relu3": nn.ReLU(),
    }
    return Convolutions(layers, shape, actions, 512)


def overlap(shape: tuple[int, int, int], actions: int, scale: int = 1) -> Convolutions:
    """Patches of 8 x 8 pixels every 4, then of 4 x 4 of those every 2."""
    layers = {
        "conv1": nn.Conv2d(shape[2], 16 * scale, 8, stride=4),
        "relu1": nn.ReLU(),
        "conv2": nn.Conv2d(16 * scale, 32 * scale, 4, stride=2),
        "relu2": nn.ReLU(),
    }
    return Convolutions(layers, shape, actions, 256)


def patch(
    shape: tuple[int, int, int], actions: int, scale: int = 1, pooled: bool = False
) -> Convolutions:
    """Patches of 8 x 8 pixels, and two residual units as IMPALA's among 8 x 8 of them.

    pooled  the dense layer is given each channel's mean over all patches, which says not where
    """
    channels = 16 * scale
    layers = {
        "stem": nn.Conv2d(shape[2], channels, 8, stride=8),
        "relu1": nn.ReLU(),
        "residual1": Residual(channels),
        "residual2": Residual(channels),
        "relu2": nn.ReLU(),
    }
    if pooled:
        layers["mean"] = nn.AdaptiveAvgPool2d(1)
    return Convolutions(layers, shape, actions, 256)


def patch_impala(shape: tuple[int, int, int], actions: int, scale: int = 1) -> Convolutions:
    """Patches of 4 x 4 pixels, then what IMPALA does, on 16 x 16 and 8 x 8 places."""
    layers = {
        "stem": nn.Conv2d(shape[2], 16 * scale, 4, stride=4),
        "residual": Residual(16 * scale),
        "block": block(16 * scale, 32 * scale),
        "relu": nn.ReLU(),
    }
    return Convolutions(layers, shape, actions, 256)
