"""The paper's network: IMPALA's residual convolutions, feed-forward (Espeholt et al. 2018).

Every activation is a named module, so that hooks can read and change it:
`block2.residual1.relu1`, `block3.pool`, `features.relu`, ...
"""

from __future__ import annotations

from collections import OrderedDict

import torch
from torch import Tensor, nn

WIDTHS = (16, 32, 32)  # channels of the three blocks, at scale 1
FEATURES = 256


class Residual(nn.Module):
    """x + conv(relu(conv(relu(x)))), at the same width."""

    def __init__(self, channels: int):
        super().__init__()
        self.relu1 = nn.ReLU()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1)
        self.relu2 = nn.ReLU()
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor) -> Tensor:
        return x + self.conv2(self.relu2(self.conv1(self.relu1(x))))


def block(before: int, after: int) -> nn.Sequential:
    """Convolution, pooling to half the side, and two residual units."""
    return nn.Sequential(
        OrderedDict(
            conv=nn.Conv2d(before, after, 3, padding=1),
            pool=nn.MaxPool2d(3, stride=2, padding=1),
            residual1=Residual(after),
            residual2=Residual(after),
        )
    )


class Impala(nn.Module):
    """Images [B, H, W, C] uint8 -> logits [B, actions], values [B].

    scale   multiplies the channels: 1 in the published code, 4 in the paper's sweeps
    widths  channels of the three blocks, before that
    """

    def __init__(
        self,
        shape: tuple[int, int, int],
        actions: int,
        scale: int = 1,
        widths: tuple[int, ...] = WIDTHS,
    ):
        super().__init__()
        height, width, channels = shape
        widths = tuple(scale * w for w in widths)
        self.block1 = block(channels, widths[0])
        self.block2 = block(widths[0], widths[1])
        self.block3 = block(widths[1], widths[2])
        for _ in widths:  # each block's pooling halves the picture, rounding up
            height, width = (height + 1) // 2, (width + 1) // 2
        self.features = nn.Sequential(
            OrderedDict(
                relu_in=nn.ReLU(),
                flatten=nn.Flatten(),
                linear=nn.Linear(widths[2] * height * width, FEATURES),
                relu=nn.ReLU(),
            )
        )
        self.policy = nn.Linear(FEATURES, actions)
        self.value = nn.Linear(FEATURES, 1)
        initialise(self)

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        return self.heads(self.hidden(images))

    def hidden(self, images: Tensor) -> Tensor:
        """All but the heads: what policy and value are linear functions of, [B, FEATURES]."""
        x = images.permute(0, 3, 1, 2).to(self.policy.weight.dtype) / 255
        return self.features(self.block3(self.block2(self.block1(x))))

    def heads(self, features: Tensor) -> tuple[Tensor, Tensor]:
        return self.policy(features), self.value(features).squeeze(-1)


@torch.no_grad()
def initialise(network: nn.Module) -> None:
    """The original's: Xavier-uniform, biases 0, a near-uniform policy, an orthogonal value."""
    for name, module in network.named_modules():
        if isinstance(module, nn.Conv2d | nn.Linear):
            if name == "policy":
                nn.init.orthogonal_(module.weight, gain=0.01)
            elif name == "value":
                nn.init.orthogonal_(module.weight, gain=1.0)
            else:
                nn.init.xavier_uniform_(module.weight)
            assert module.bias is not None
            nn.init.zeros_(module.bias)
