"""Deep repeated ConvLSTM, the recurrent network of planning-like agents (Guez et al. 2019).

A stack of convolutional LSTMs on a grid of places ticks several times per step. The lowest layer
sees the top layer of the previous tick. Each layer also sees pooled features of itself, so that
information from one place can reach all others within a tick ("An Investigation of Model-Free
Planning", arXiv:1901.03559, section 2).
"""

from collections import OrderedDict
from collections.abc import Callable

import torch
from torch import Tensor, nn

from astray.agents.actor_critic import dense, initialise
from astray.agents.mlp import CircleEmbedding
from astray.agents.recurrent import Recurrent

CHANNELS = 32
FEATURES = 256


class ConvLSTM(nn.Module):
    """Convolutional LSTM with pool-and-inject: each place also sees a summary of all places."""

    def __init__(self, channels: int):
        super().__init__()
        self.pooled = nn.Linear(2 * channels, channels)
        self.gates: nn.Module = nn.Conv2d(4 * channels + 1, 4 * channels, 3, padding=1)
        self.output: Callable[[Tensor], Tensor] = torch.sigmoid  # of the output gate

    def forward(
        self, seen: Tensor, below: Tensor, hidden: Tensor, inner: Tensor, edge: Tensor
    ) -> tuple[Tensor, Tensor]:
        """Return the next hidden and inner states, both [N, C, H, W].

        Args:
            seen: Encoded observation [N, C, H, W].
            below: Hidden state [N, C, H, W] of the layer below.
            hidden: Previous hidden state [N, C, H, W].
            inner: Previous cell state [N, C, H, W].
            edge: [N, 1, H, W], 1 at the border.
        """
        summary = torch.cat([hidden.amax((2, 3)), hidden.mean((2, 3))], 1)
        injected = self.pooled(summary)[:, :, None, None].expand_as(hidden)
        gates = self.gates(torch.cat([seen, below, hidden, injected, edge], 1))
        into, forget, new, out = gates.chunk(4, 1)
        inner = torch.sigmoid(forget) * inner + torch.sigmoid(into) * torch.tanh(new)
        return self.output(out) * torch.tanh(inner), inner


class DRC(Recurrent):
    """Images [N, H, W, C] or planes [N, C, H, W] uint8 -> logits [N, actions], values [N].

    Images are encoded as 8 x 8 places, planes as one place per cell. The state [N, memory] holds
    the hidden states of all layers, then their cell states. `tick1`, `tick2`, ... are named modules
    whose outputs are the top hidden states [N, C, H, W].

    Args:
        shape: Shape of one observation.
        largest: Largest value of each plane; empty for images.
        depth: Number of ConvLSTMs, D in the publication.
        ticks: Number of ticks per step, N in the publication.
        encoder: Module that encodes images, in the place of our own; it gives `channels`.

    Raises:
        ValueError: If observations have no places.
    """

    def __init__(
        self,
        shape: tuple[int, ...],
        largest: list[int],
        actions: int,
        depth: int = 3,
        ticks: int = 3,
        scale: int = 1,
        features: int = FEATURES,
        encoder: nn.Module | None = None,
        channels: int = CHANNELS,
    ):
        super().__init__()
        if len(shape) != 3:
            raise ValueError(f"drc sees images or symbolic planes, of three axes; got {shape}")
        channels *= scale
        if largest:
            self.spread = CircleEmbedding(largest)
            layers = {"conv1": nn.Conv2d(self.spread.channels, channels, 3, padding=1)}
        else:
            layers: dict[str, nn.Module] = {
                "conv1": nn.Conv2d(shape[2], channels, 8, 4, padding=2),
                "relu1": nn.ReLU(),
                "conv2": nn.Conv2d(channels, channels, 4, 2, padding=1),
            }
        self.images = not largest
        self.encoder = encoder or nn.Sequential(OrderedDict(layers))
        self.layers = nn.ModuleList(ConvLSTM(channels) for _ in range(depth))
        self.repeats = ticks
        for k in range(ticks):
            self.add_module(f"tick{k + 1}", nn.Identity())
        with torch.no_grad():
            _, *self.grid = self.encode(torch.zeros((1, *shape), dtype=torch.uint8))[0].shape
        self.channels, places = channels, self.grid[0] * self.grid[1]
        self.memory = 2 * depth * channels * places
        edge = torch.ones(1, 1, *self.grid)
        edge[:, :, 1:-1, 1:-1] = 0
        self.edge: Tensor
        self.register_buffer("edge", edge, persistent=False)
        self.features = dense(2 * channels * places, features)
        self.policy = nn.Linear(features, actions)
        self.value = nn.Linear(features, 1)
        initialise(self)

    def encode(self, observation: Tensor) -> Tensor:
        """Map observations [N, ...] to encoded places [N, C, H, W]."""
        images = self.images
        return self.encoder(
            observation.permute(0, 3, 1, 2) / 255 if images else self.spread(observation)
        )

    def recall(
        self, observation: Tensor, state: Tensor, begins: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        features, state = self._step(self.encode(observation), state, begins)
        return *self._heads(features), state

    def unroll(
        self, observation: Tensor, state: Tensor, begins: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        encoded = self.encode(observation.flatten(0, 1)).unflatten(0, observation.shape[:2])
        tops = []
        for seen, first in zip(encoded, begins, strict=True):
            top, state = self._step(seen, state, first)
            tops.append(top)
        logits, values = self._heads(torch.cat(tops))
        steps = observation.shape[:2]
        return logits.unflatten(0, steps), values.unflatten(0, steps), state

    def _step(self, seen: Tensor, state: Tensor, begins: Tensor) -> tuple[Tensor, Tensor]:
        """Tick on encoded observations; return the top with what is seen, and the next state."""
        state = state * ~begins[:, None]
        parts = state.unflatten(1, (2, len(self.layers), self.channels, *self.grid))
        hidden, inner = (list(part.unbind(1)) for part in parts.unbind(1))
        edge = self.edge.expand(len(seen), -1, -1, -1)
        for k in range(self.repeats):
            below = hidden[-1]
            for d, layer in enumerate(self.layers):
                below, inner[d] = layer(seen, below, hidden[d], inner[d], edge)
                hidden[d] = below
            hidden[-1] = self.get_submodule(f"tick{k + 1}")(below)
        top = torch.cat([hidden[-1], seen], 1)
        return top, torch.cat([torch.stack(hidden, 1), torch.stack(inner, 1)], 1).flatten(1)

    def _heads(self, top: Tensor) -> tuple[Tensor, Tensor]:
        features = self.features(top)
        return self.policy(features), self.value(features).squeeze(-1)
