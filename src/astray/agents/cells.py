"""Iterative network for mazes drawn small, whose cells are two or three pixels.

The picture is cut into 25 x 25 windows of 3 x 3 pixels, one for each cell of the paper's mazes,
and these into 13 x 13 places of 2 x 2 cells. Only the grid is built in; what is a wall, where the
mouse is and what to look for are learned. One residual unit is applied repeatedly and sees the
picture each time, so that information spreads between places (Schwarzschild et al. 2021, Bansal et
al. 2022). Policy and value see the places with salient colours, wherever these are. A dense layer
over all places learns the smallest mazes as fast, but then learns nothing about larger ones.
"""

from collections import OrderedDict

import torch
from torch import Tensor, nn

from astray.agents.actor_critic import Pixels

SIDE, WINDOW = 25, 3  # cells a side, and pixels a side of what is seen of each
BLOCK = 2  # cells a side of a place
TICKS = 8  # the reach of what a place learns from others: two places a tick
SPOTS = 4  # that are attended to at once
HUES = 8  # by which places stand out
FEATURES = 128
STEADY = 0.3  # of the unit's last convolution, at first: so that ticks change little


def first_pixels(pixels: int) -> list[int]:
    """Return the first pixels of windows along a side, each in the middle of its cell."""
    middles = ((k + 0.5) * pixels / SIDE for k in range(SIDE))
    return [min(max(int(middle - WINDOW / 2 + 0.5), 0), pixels - WINDOW) for middle in middles]


class Unit(nn.Module):
    """Residual unit of every iteration, [B, C, h, w]: x + conv2(relu(conv1(relu(x)) + seen))."""

    def __init__(self, channels: int):
        super().__init__()
        self.conv1 = nn.Conv2d(channels, channels, 3, padding=1)
        self.conv2 = nn.Conv2d(channels, channels, 3, padding=1)

    def forward(self, x: Tensor, seen: Tensor) -> Tensor:
        return x + self.conv2(torch.relu(self.conv1(torch.relu(x)) + seen))


class Attention(nn.Module):
    """Attention weights of `SPOTS` heads over places, from the cells' colours alone.

    Colours are compared within the picture, so that rare ones are salient from the start.
    """

    def __init__(self, channels: int):
        super().__init__()
        self.hues = nn.Conv2d(channels, HUES, 1)
        self.score = nn.Linear(HUES, SPOTS)

    def forward(self, cells: Tensor) -> Tensor:
        """Map [B, C, SIDE, SIDE] to [B, SPOTS, places], with sums of 1 over places."""
        hues = self.hues(cells).permute(0, 2, 3, 1).flatten(1, 2).float()  # [B, cells, HUES]
        mean = hues.mean(1, keepdim=True)
        hues = hues - mean
        # var_mean takes ten times as long on this layout.
        spread = (hues * hues).mean(1, keepdim=True)
        odd = torch.relu(hues * torch.rsqrt(spread + 1e-5) - 1)
        weights = self.score(odd).float().transpose(1, 2).softmax(-1).unflatten(2, (SIDE, SIDE))
        pooled = nn.functional.avg_pool2d(weights, BLOCK, padding=SIDE % BLOCK)
        return BLOCK**2 * pooled.flatten(2)


class Cells(Pixels):
    """Images [B, H, W, C] uint8 -> logits [B, actions], values [B].

    Args:
        scale: Multiplies the channels of places.
    """

    def __init__(self, shape: tuple[int, ...], actions: int, scale: int = 1):
        super().__init__()
        height, width, colours = shape
        if min(height, width) < WINDOW:
            raise ValueError(f"pictures must be at least {WINDOW} pixels a side; got {shape}")
        channels, inputs = 16 * scale, WINDOW**2 * colours
        self.stem = nn.Conv2d(inputs, channels, 2 * BLOCK, BLOCK, padding=BLOCK)
        self.seen = nn.Conv2d(channels, channels, 3, padding=1)
        self.unit = Unit(channels)
        self.ticks = nn.ModuleList(nn.Identity() for _ in range(TICKS))  # what each has found
        self.attention = Attention(inputs)
        places = SIDE // BLOCK + 1  # a side
        self.place = nn.Parameter(torch.zeros(1, channels, places, places))  # where each is
        self.features = nn.Sequential(
            OrderedDict[str, nn.Module](
                linear=nn.Linear(2 * SPOTS * channels, FEATURES), relu=nn.ReLU()
            )
        )
        self.rows: Tensor
        self.columns: Tensor
        for name, side in (("rows", height), ("columns", width)):
            pixels = [k + offset for k in first_pixels(side) for offset in range(WINDOW)]
            self.register_buffer(name, torch.tensor(pixels), persistent=False)
        self.add_heads(FEATURES, actions)
        score = self.attention.score.weight
        with torch.no_grad():
            score.copy_(torch.randn(score.shape, device="cpu"))  # on "meta": see `CircleEmbedding`
            self.unit.conv2.weight.mul_(STEADY)

    def cells(self, observations: Tensor) -> Tensor:
        """Cut pictures into windows: [B, H, W, C] -> [B, SIDE, SIDE, pixels of a window]."""
        wide = observations.index_select(1, self.rows).index_select(2, self.columns)
        whole = wide.unflatten(2, (SIDE, -1)).unflatten(1, (SIDE, WINDOW))
        return whole.transpose(2, 3).flatten(3)

    def hidden(self, observations: Tensor) -> Tensor:
        # In place, as it is a copy. From inputs that are all positive it learns far more slowly.
        cells = self.cells(observations).to(self.kind(observations))
        cells = cells.div_(255).sub_(0.5).mul_(4).permute(0, 3, 1, 2)
        stem = torch.relu(self.stem(cells) + self.place)
        seen = self.seen(stem)
        state = seen
        for tick in self.ticks:
            state = tick(self.unit(state, seen))
        attention = self.attention(cells)
        held = torch.cat([state, stem], 1).flatten(2)
        spots = torch.bmm(attention.to(held.dtype), held.transpose(1, 2)).flatten(1)
        return self.features(spots)
