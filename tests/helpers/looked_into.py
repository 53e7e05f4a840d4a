"""Agents of every kind of network, untrained, to be looked into."""

import numpy as np
import torch
from torch import nn

from astray.agents.policy import Architecture, weights
from astray.analysis.trained import Agent

# A way up, and one to the right: they part where the mouse begins.
ROOM = """
    .....#G
    .###.#.
    .#...#.
    .#.###.
    .#.....
    .####.#
    @......
"""


class Guest(nn.Module):
    """A network of somebody's own: one module is used twice."""

    def __init__(self, architecture):
        super().__init__()
        size = int(np.prod(architecture.shape))
        self.first, self.relu = nn.Linear(size, 24), nn.ReLU()
        self.second, self.heads = nn.Linear(24, 24), nn.Linear(24, architecture.actions + 1)

    def forward(self, seen):
        x = self.relu(self.first(seen.flatten(1).float()))
        found = self.heads(self.relu(self.second(x)))
        return found[:, :-1], found[:, -1]


ARCHITECTURES = {
    "impala": Architecture("impala", (64, 64, 3), (), 15, widths=(4, 6, 8)),
    "clear": Architecture("clear", (64, 64, 3), (), 15),
    "small": Architecture("mlp", (4, 7, 7), (1, 1, 6, 6), 15, width=16),
    "guest": Architecture("helpers.looked_into:Guest", (4, 7, 7), (1, 1, 6, 6), 15),
}
LAYERS = {
    "impala": "block2.residual1",
    "clear": "block2.relu1",
    "small": "features.relu1",
    "guest": "second",
}


def make_agent(kind, folder):
    """An agent of Maze with a fresh network of that kind."""
    torch.manual_seed(1)
    network = ARCHITECTURES[kind].build()
    with torch.no_grad():  # policies begin near uniform, on which changes are hard to see
        for parameter in network.parameters():
            parameter.mul_(1.5)
    path = folder / f"{kind}.safetensors"
    path.write_bytes(weights(network, ARCHITECTURES[kind], "maze"))
    return Agent(path, "maze")
