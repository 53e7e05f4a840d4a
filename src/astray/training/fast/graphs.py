"""Functions of tensors, replayed as CUDA graphs."""

from collections.abc import Callable, Iterable
from typing import Any

import torch
from torch import Tensor

WARM_UP = 3  # runs before a capture, in which libraries choose and allocate


class Captured:
    """A function of tensors of fixed shapes, replayed as one CUDA graph.

    The next call overwrites its results. Changes to `state` during warm-up are undone, so that
    learning begins unchanged.
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
    """Restore tensors [...] to `before` [...]; new ones (the moments of Adam) become 0."""
    for x in state:
        if id(x) in before:
            x.copy_(before[id(x)])
        else:
            x.zero_()
