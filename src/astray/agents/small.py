"""Small networks for symbolic observations: learning on a CPU in minutes."""

from __future__ import annotations

from collections import OrderedDict

import torch
from torch import Tensor, nn

from astray.agents.impala import initialise


class OneHot(nn.Module):
    """Planes of categories [B, C, H, W] uint8 -> planes of 0 and 1, float.

    largest  the largest category of each plane; 1: the plane is passed on. 0 becomes nothing.
    """

    def __init__(self, largest: list[int]):
        super().__init__()
        planes = [(c, k) for c, top in enumerate(largest) for k in range(1, top + 1)]
        self.channels = len(planes)
        self.register_buffer("plane", torch.tensor([c for c, _ in planes]), persistent=False)
        category = torch.tensor([k for _, k in planes], dtype=torch.uint8)
        self.register_buffer("category", category.view(-1, 1, 1), persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        return (x.index_select(1, self.plane) == self.category).to(torch.float32)


class Small(nn.Module):
    """Symbolic planes [B, C, H, W] uint8 -> logits [B, actions], values [B]."""

    def __init__(
        self, shape: tuple[int, int, int], largest: list[int], actions: int, width: int = 64
    ):
        super().__init__()
        self.one_hot = OneHot(largest)
        _, height, columns = shape
        self.features = nn.Sequential(
            OrderedDict(
                flatten=nn.Flatten(),
                linear1=nn.Linear(self.one_hot.channels * height * columns, width),
                relu1=nn.ReLU(),
                linear2=nn.Linear(width, width),
                relu2=nn.ReLU(),
            )
        )
        self.policy = nn.Linear(width, actions)
        self.value = nn.Linear(width, 1)
        initialise(self)

    def forward(self, planes: Tensor) -> tuple[Tensor, Tensor]:
        features = self.features(self.one_hot(planes))
        return self.policy(features), self.value(features).squeeze(-1)


class SmallConv(nn.Module):
    """Symbolic planes [B, C, H, W] uint8 -> logits [B, actions], values [B]; two convolutions."""

    def __init__(
        self, shape: tuple[int, int, int], largest: list[int], actions: int, width: int = 64
    ):
        super().__init__()
        self.one_hot = OneHot(largest)
        _, height, columns = shape
        h, w = (height + 3) // 4, (columns + 3) // 4
        self.features = nn.Sequential(
            OrderedDict(
                conv1=nn.Conv2d(self.one_hot.channels, 16, 3, stride=2, padding=1),
                relu1=nn.ReLU(),
                conv2=nn.Conv2d(16, 32, 3, stride=2, padding=1),
                relu2=nn.ReLU(),
                flatten=nn.Flatten(),
                linear=nn.Linear(32 * h * w, width),
                relu3=nn.ReLU(),
            )
        )
        self.policy = nn.Linear(width, actions)
        self.value = nn.Linear(width, 1)
        initialise(self)

    def forward(self, planes: Tensor) -> tuple[Tensor, Tensor]:
        features = self.features(self.one_hot(planes))
        return self.policy(features), self.value(features).squeeze(-1)
