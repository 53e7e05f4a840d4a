"""Asynchronous acting on a GPU, which infers for some environments while others step."""

from collections.abc import Callable

import torch

from astray.acting import Answer, Turn
from astray.training.fast.graphs import Captured
from astray.training.rollout import Rollout, act


class Ahead:
    """Actor like `rollout.Actor` whose `send` never waits.

    Observations go directly from the environments' memory to the rollout's buffers.
    """

    def __init__(self, network: Callable, rollout: Rollout, graphs: bool):
        """Prepare to act; with `graphs` acting is a CUDA graph."""
        self.network, self.rollout, self._graphs = network, rollout, graphs
        groups = rollout.player.groups
        self.chosen = torch.empty(len(rollout.player.images), dtype=torch.int64, pin_memory=True)
        self._sent = [torch.cuda.Event() for _ in groups]
        self._act: Callable | None = None

    @torch.no_grad()
    def send(self, t: int, group: int, turn: Turn) -> None:
        kept = self.rollout
        slot, where = t % (kept.slots + 1), kept.player.groups[group]
        seen = kept.observation[slot, where]
        seen.copy_(turn.observations, non_blocking=True)
        noise = kept.noise[min(t, len(kept.noise) - 1), where]
        if self._act is None:
            self._act = Captured(self._infer, noise, seen) if self._graphs else self._infer
        action, log_probability, value = self._act(noise, seen)
        kept.action[slot, where] = action
        kept.log_probability[slot, where] = log_probability
        kept.value[slot, where] = value
        self.chosen[where].copy_(action, non_blocking=True)
        self._sent[group].record()

    def _infer(self, noise: torch.Tensor, seen: torch.Tensor) -> tuple[torch.Tensor, ...]:
        return act(self.network, noise, seen)

    def receive(self, group: int) -> Answer:
        self._sent[group].synchronize()
        return Answer(self.chosen[self.rollout.player.groups[group]].numpy())
