"""Networks for images that a CPU can train: their first convolutions have strides of 2, 4 or 8.

Nearly all multiplications of the paper's network are in its first two blocks, on 64 x 64 and 32 x
32 places; here there are at most 16 x 16. Every activation is a named module, so that hooks can
read and change it: `body.relu1`, `body.residual1.relu2`, `features.relu`, ...
"""

from collections import OrderedDict
from collections.abc import Mapping

import torch
from torch import Tensor, nn
from torch.nn.functional import max_pool2d

from astray.agents.actor_critic import Pixels, dense
from astray.agents.impala import Residual, block


class Convolutions(Pixels):
    """Images [B, H, W, C] uint8 -> logits [B, actions], values [B].

    Args:
        layers: Modules by name, applied in order to planes [B, C, H, W].
        features: Units of the dense layer before the heads.
    """

    def __init__(
        self, layers: Mapping[str, nn.Module], shape: tuple[int, ...], actions: int, features: int
    ):
        super().__init__()
        self.body = nn.Sequential(OrderedDict(layers))
        height, width, channels = shape
        seen = torch.zeros(1, 1, height, width, device="cpu")
        for layer in self.body.modules():  # on "meta" a convolution would load torch's compiler
            if isinstance(layer, nn.Conv2d | nn.MaxPool2d):  # whose results have the same shape
                seen = max_pool2d(seen, layer.kernel_size, layer.stride, layer.padding)  # pyrefly: ignore
            if isinstance(layer, nn.Conv2d):
                channels = layer.out_channels
            if isinstance(layer, nn.AdaptiveAvgPool2d):
                seen = layer(seen)
        self.features = dense(channels * seen.numel(), features)
        self.add_heads(features, actions)

    def see(self, planes: Tensor) -> Tensor:
        return self.body(planes)


def nature(shape: tuple[int, ...], actions: int) -> Convolutions:
    """Build the network of Mnih et al. 2015, as in Stable-Baselines3's `CnnPolicy`."""
    layers = {
        "conv1": nn.Conv2d(shape[2], 32, 8, stride=4),
        "relu1": nn.ReLU(),
        "conv2": nn.Conv2d(32, 64, 4, stride=2),
        "relu2": nn.ReLU(),
        "conv3": nn.Conv2d(64, 64, 3),
        "relu3": nn.ReLU(),
    }
    return Convolutions(layers, shape, actions, 512)


def overlap(shape: tuple[int, ...], actions: int, scale: int = 1) -> Convolutions:
    """Build a network on overlapping patches: 8 x 8 pixels with stride 4."""
    layers = {
        "conv1": nn.Conv2d(shape[2], 16 * scale, 8, stride=4),
        "relu1": nn.ReLU(),
        "conv2": nn.Conv2d(16 * scale, 32 * scale, 4, stride=2),
        "relu2": nn.ReLU(),
    }
    return Convolutions(layers, shape, actions, 256)


def patch(
    shape: tuple[int, ...], actions: int, scale: int = 1, pooled: bool = False
) -> Convolutions:
    """Build a network on patches of 8 x 8 pixels, with two residual units as in IMPALA.

    Args:
        pooled: Give the dense layer each channel's mean over all patches, without positions.
    """
    channels = 16 * scale
    layers: dict[str, nn.Module] = {
        "stem": nn.Conv2d(shape[2], channels, 8, stride=8),
        "relu1": nn.ReLU(),
        "residual1": Residual(channels),
        "residual2": Residual(channels),
        "relu2": nn.ReLU(),
    }
    if pooled:
        layers["mean"] = nn.AdaptiveAvgPool2d(1)
    return Convolutions(layers, shape, actions, 256)


def patch_impala(shape: tuple[int, ...], actions: int, scale: int = 1) -> Convolutions:
    """Build IMPALA on 16 x 16 patches of 4 x 4 pixels."""
    layers = {
        "stem": nn.Conv2d(shape[2], 16 * scale, 4, stride=4),
        "residual": Residual(16 * scale),
        "block": block(16 * scale, 32 * scale),
        "relu": nn.ReLU(),
    }
    return Convolutions(layers, shape, actions, 256)


class Centre(nn.Module):
    """Brings planes from 0 to 1 to -2 to 2, as learning is slow from inputs that are positive."""

    def forward(self, planes: Tensor) -> Tensor:
        """Return centred planes [N, C, H, W] of `planes` of that shape."""
        return (planes - 0.5) * 4


def strided_impala(shape: tuple[int, ...], actions: int, scale: int = 1) -> Convolutions:
    """Build IMPALA on 16 x 16 places, which two convolutions of stride 2 have seen."""
    layers = {
        "centre": Centre(),
        "conv1": nn.Conv2d(shape[2], 16 * scale, 5, stride=2, padding=2),
        "relu1": nn.ReLU(),
        "conv2": nn.Conv2d(16 * scale, 32 * scale, 3, stride=2, padding=1),
        "relu2": nn.ReLU(),
        "block": block(32 * scale, 32 * scale),
        "relu": nn.ReLU(),
    }
    return Convolutions(layers, shape, actions, 256)
