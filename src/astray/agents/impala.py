"""The paper's network: IMPALA's residual convolutions, feed-forward (Espeholt et al. 2018).

Every activation is a named module, so that hooks can read and change it:
`block2.residual1.relu1`, `block3.pool`, `features.relu`, ...
"""

from collections import OrderedDict

import torch
from torch import Tensor, nn

from astray.agents.actor_critic import Pixels, dense

WIDTHS = (16, 32, 32)  # channels of the three blocks, at scale 1
FEATURES = 256


class Residual(nn.Module):
    """Residual unit x + conv(relu(conv(relu(x)))), [B, C, H, W], at the same width.

    Args:
        rectified: Add relu(x) in the place of x.
    """

    def __init__(self, channels: int, rectified: bool = False):
        super().__init__()
        self.rectified = rectified
        self.relu1 = nn.ReLU()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1)
        self.relu2 = nn.ReLU()
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        begun = self.relu1(x)
        return (begun if self.rectified else x) + self.conv2(self.relu2(self.conv1(begun)))


class SamePool(nn.Module):
    """Max-pooling [B, C, H, W] of 3 x 3 pixels with stride 2, padded as TensorFlow's "SAME".

    An even side is padded after its last pixel alone, so the windows of `nn.MaxPool2d(3, 2, 1)`
    lie one pixel further up and left.
    """

    def forward(self, x: Tensor) -> Tensor:
        height, width = x.shape[-2:]
        before_y, before_x = height % 2, width % 2
        padded = nn.functional.pad(x, (before_x, 1, before_y, 1), value=-torch.inf)
        return nn.functional.max_pool2d(padded, 3, stride=2)


def block(before: int, after: int, same: bool = False, rectified: bool = False) -> nn.Sequential:
    """Build a convolution, pooling to half the side, and two residual units."""
    return nn.Sequential(
        OrderedDict[str, nn.Module](
            conv=nn.Conv2d(before, after, 3, padding=1),
            pool=SamePool() if same else nn.MaxPool2d(3, stride=2, padding=1),
            residual1=Residual(after, rectified),
            residual2=Residual(after, rectified),
        )
    )


class Impala(Pixels):
    """Images [B, H, W, C] uint8 -> logits [B, actions], values [B].

    Args:
        scale: Multiplies the channels: 1 in the published code, 4 in the paper's sweeps.
        widths: Channels of the three blocks at scale 1.
        same: Pool as TensorFlow's and JAX's "SAME" does: see `SamePool`.
        rectified: RLLTE's variant: see `Residual`; and no ReLU before the dense layer.
    """

    def __init__(
        self,
        shape: tuple[int, ...],
        actions: int,
        scale: int = 1,
        widths: tuple[int, ...] = WIDTHS,
        same: bool = False,
        rectified: bool = False,
    ):
        super().__init__()
        height, width, channels = shape
        widths = tuple(scale * w for w in widths)
        self.block1 = block(channels, widths[0], same, rectified)
        self.block2 = block(widths[0], widths[1], same, rectified)
        self.block3 = block(widths[1], widths[2], same, rectified)
        for _ in widths:  # each block's pooling halves the picture, rounding up
            height, width = (height + 1) // 2, (width + 1) // 2
        layers = dense(widths[2] * height * width, FEATURES).named_children()
        begin = nn.Identity() if rectified else nn.ReLU()
        self.features = nn.Sequential(OrderedDict([("relu_in", begin), *layers]))
        self.add_heads(FEATURES, actions)

    def see(self, planes: Tensor) -> Tensor:
        return self.block3(self.block2(self.block1(planes)))
