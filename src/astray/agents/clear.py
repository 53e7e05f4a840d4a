"""The "clear" network: convolutions that are easy to interpret (Hilton et al. 2020).

It has no residual connections, so all information passes through every layer. Pools are as large
as their stride, so gradients have no grid, and L2, so gradients are continuous. Dense layers
follow where positions no longer matter. OpenAI's published CoinRun agents have this network.

Every activation is a named module, so that hooks can read and change it: `block2.relu1`,
`block4.pool`, `features.relu2`, ... The original's convolutions 1a, 2a, 2b, 3a and 4a are
`block1.conv1`, `block2.conv1`, `block2.conv2`, `block3.conv1` and `block4.conv1`.
"""

from collections import OrderedDict

import torch
from torch import Tensor, nn

from astray.agents.actor_critic import Pixels, dense

BLOCKS = ((16,), (32, 32), (32,), (32,))  # channels of the convolutions before each pool
FIRST, LATER = 7, 5  # pixels a side of the kernels: of the first convolution, of all others
HIDDEN = (256, 512)  # units of the dense layers
TINY = 1e-8  # under the root, whose slope at 0 would be infinite


class L2Pool(nn.Module):
    """Root mean square of each 2 x 2 pixels, [B, C, H, W]; sides are halved and rounded up."""

    def forward(self, x: Tensor) -> Tensor:
        # A square beyond the edge is not counted, as TensorFlow's "same" pools have it.
        mean = nn.functional.avg_pool2d(x**2, 2, ceil_mode=True, count_include_pad=False)
        return torch.sqrt(mean + TINY)


def block(before: int, kernel: int, widths: tuple[int, ...]) -> nn.Sequential:
    """Build convolutions that keep the side, each with a ReLU, and one pool."""
    layers: OrderedDict[str, nn.Module] = OrderedDict()
    for k, width in enumerate(widths, 1):
        layers[f"conv{k}"] = nn.Conv2d(before, width, kernel, padding=kernel // 2)
        layers[f"relu{k}"] = nn.ReLU()
        before = width
    layers["pool"] = L2Pool()
    return nn.Sequential(layers)


class Clear(Pixels):
    """Images [B, H, W, C] uint8 -> logits [B, actions], values [B]."""

    def __init__(self, shape: tuple[int, ...], actions: int):
        super().__init__()
        height, width, channels = shape
        inputs = (channels, *(widths[-1] for widths in BLOCKS[:-1]))
        kernels = (FIRST, *(LATER for _ in BLOCKS[1:]))
        self.block1, self.block2, self.block3, self.block4 = map(block, inputs, kernels, BLOCKS)
        for _ in BLOCKS:
            height, width = (height + 1) // 2, (width + 1) // 2
        self.features = dense(BLOCKS[-1][-1] * height * width, *HIDDEN)
        self.add_heads(HIDDEN[1], actions)

    def see(self, planes: Tensor) -> Tensor:
        return self.block4(self.block3(self.block2(self.block1(planes))))
