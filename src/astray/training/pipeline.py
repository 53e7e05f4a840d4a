"""Acting and learning as a device does them best: without waiting, and replayed as graphs."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
import torch
from torch import Tensor

from astray.training.device import Model
from astray.training.player import Player

WARM_UP = 3  # runs before a capture, in which libraries choose and allocate


class Captured:
    """A function of tensors of fixed shapes, replayed as one CUDA graph.

    What it returns is overwritten by the next call. What it changes in `state` while it warms
    up is undone: learning begins where it was.
    """

    def __init__(
        self, function: Callable, *inputs: Tensor, state: Callable[[], Iterable[Tensor]] = list
    ):
        self.inputs = [x.clone() for x in inputs]
        before = {id(x): x.detach().clone() for x in state()}
        side = torch.cuda.Stream()
        side.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(side):
            for _ in range(WARM_UP):
                function(*self.inputs)
        torch.cuda.current_stream().wait_stream(side)
        restore(state(), before)
        self.graph = torch.cuda.CUDAGraph()
        with torch.cuda.graph(self.graph):
            self.outputs = function(*self.inputs)

    def __call__(self, *inputs: Tensor) -> Any:
        for kept, x in zip(self.inputs, inputs, strict=True):
            kept.copy_(x)
        self.graph.replay()
        return self.outputs


@torch.no_grad()
def restore(state: Iterable[Tensor], before: dict[int, Tensor]) -> None:
    """Put back what `state` held; what was not there yet began as 0 (the moments of Adam)."""
    for x in state:
        if id(x) in before:
            x.copy_(before[id(x)])
        else:
            x.zero_()


class Actor:
    """Draws the actions of a player's groups of environments, and keeps what was seen and done.

    `send` waits for nothing: the device infers for one group while the processor steps another.
    Observations go from the memory that the environments draw in straight to where they stay.
    """

    def __init__(self, model: Model, player: Player, slots: int):
        """slots  steps that are kept; then the first is overwritten"""
        self.model, self.player, self.slots = model, player, slots
        self.device = torch.device(model.config.device)
        shape, n = player.images.shape[1:], len(player.images)
        self.observation = torch.empty(
            (slots + 1, n, *shape), dtype=torch.uint8, device=self.device
        )
        self.action = torch.empty((slots + 1, n), dtype=torch.int64, device=self.device)
        self.log_probability = torch.empty((slots + 1, n), device=self.device)
        self.value = torch.empty((slots + 1, n), device=self.device)
        self.advantage, self.target = torch.empty((2, slots, n), device=self.device)
        pinned = self.device.type == "cuda"
        self.chosen = torch.empty(n, dtype=torch.int64, pin_memory=pinned)
        self._sent = [torch.cuda.Event() for _ in player.groups] if pinned else None
        self._act: Callable | None = None

    def begin(self) -> None:
        """Draw the noise of a rollout, and send what the environments show now."""
        player, config = self.player, self.model.config
        shape = (config.rollout, config.environments, player.actions)
        # All of a rollout's at once, so that it does not depend on how they are grouped.
        noise = torch.rand(shape, generator=player.generator, device=self.device)
        self.noise = noise[:, player.here]
        for group in range(len(player.groups)):
            self.send(0, group)

    @torch.no_grad()
    def send(self, t: int, group: int) -> None:
        """Take what the group's environments show at step `t`, and begin to infer for them."""
        where, slot = self.player.groups[group], t % (self.slots + 1)
        seen = self.observation[slot, where]
        later = self._sent is not None  # on other devices than CUDA's nothing says when it is done
        seen.copy_(self.player.images[where], non_blocking=later)
        noise = self.noise[min(t, len(self.noise) - 1), where]
        if self._act is None:
            graphs = self.model.means.graphs
            self._act = Captured(self.model.act, seen, noise) if graphs else self.model.act
        action, log_probability, value = self._act(seen, noise)
        self.action[slot, where] = action
        self.log_probability[slot, where] = log_probability
        self.value[slot, where] = value
        self.chosen[where].copy_(action, non_blocking=later)
        if self._sent:
            self._sent[group].record()

    def actions(self, group: int) -> np.ndarray:
        """The actions that were last sent for; from here on the group may step."""
        if self._sent:
            self._sent[group].synchronize()
        return self.chosen[self.player.groups[group]].numpy()
