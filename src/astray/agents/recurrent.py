"""Networks with memory: the interface, and a recurrent cell for any of astray's networks."""

import torch
from torch import Tensor, nn

from astray.agents import gru
from astray.agents.actor_critic import ActorCritic

CELLS = {"gru": nn.GRUCell, "lstm": nn.LSTMCell}


class Recurrent(nn.Module):
    """A network whose outputs depend on all observations since the episode began.

    A custom one sets `memory`, the size of its state, and defines `recall`.
    """

    memory: int

    def recall(
        self, observation: Tensor, state: Tensor, begins: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Return logits [N, actions], values [N] and the next state [N, memory].

        Args:
            observation: Observations [N, ...] of N episodes.
            state: Their previous states, [N, memory] float32.
            begins: [N] bool, whether this is the first step; the state then counts as 0.
        """
        raise NotImplementedError(f"{type(self).__name__} must define recall")

    def unroll(
        self, observation: Tensor, state: Tensor, begins: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """Recall step by step: observations [T, N, ...] -> logits [T, N, actions], values [T, N].

        The third result is the state after all steps, [N, memory].
        """
        said = []
        for shown, first in zip(observation, begins, strict=True):
            logits, value, state = self.recall(shown, state, first)
            said.append((logits, value))
        logits, values = (torch.stack(parts) for parts in zip(*said, strict=True))
        return logits, values, state

    def forward(self, observation: Tensor) -> tuple[Tensor, Tensor]:
        """Return logits [N, A] and values [N] for first observations [N, ...] of episodes."""
        state = torch.zeros((len(observation), self.memory), device=observation.device)
        return self.recall(observation, state, torch.ones_like(state[:, 0], dtype=torch.bool))[:2]


class WithCell(Recurrent):
    """One of astray's networks with a recurrent cell and state [N, memory] before its heads.

    `recalled` is a named module whose output is the hidden state [N, width], of which the heads are
    linear functions; a change of it lasts.
    """

    def __init__(self, body: ActorCritic, cell: str):
        super().__init__()
        self.body, self.width = body, body.policy.in_features
        self.cell = CELLS[cell](self.width, self.width)
        self.recalled = nn.Identity()
        self.memory = self.width * (2 if cell == "lstm" else 1)  # an LSTM's cells, too
        for name, weight in self.cell.named_parameters():
            nn.init.zeros_(weight) if "bias" in name else nn.init.orthogonal_(weight)

    def recall(
        self, observation: Tensor, state: Tensor, begins: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        state = self._next(self.body.hidden(observation), state, begins)
        return *self.body.heads(state[:, : self.width]), state

    def unroll(
        self, observation: Tensor, state: Tensor, begins: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        steps = observation.shape[:2]
        seen = self.body.hidden(observation.flatten(0, 1)).unflatten(0, steps)
        changed = self.recalled._forward_hooks  # by analyses, step by step
        if isinstance(self.cell, nn.GRUCell) and seen.requires_grad and not changed:
            after = gru.unroll(self.cell, seen, state, begins)
            state = after[-1]
        else:
            states = []
            for features, first in zip(seen, begins, strict=True):
                state = self._next(features, state, first)
                states.append(state[:, : self.width])
            after = torch.stack(states)
        logits, values = self.body.heads(after.flatten(0, 1))  # hooks see a row per observation
        return logits.unflatten(0, steps), values.unflatten(0, steps), state

    def _next(self, features: Tensor, state: Tensor, begins: Tensor) -> Tensor:
        state = state * ~begins[:, None]
        if isinstance(self.cell, nn.LSTMCell):
            hidden, inner = self.cell(features, tuple(state.chunk(2, 1)))
            return torch.cat([self.recalled(hidden), inner], 1)
        return self.recalled(self.cell(features, state))
