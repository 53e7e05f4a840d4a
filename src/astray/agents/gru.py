"""A GRU over whole sequences, with the derivative of `torch.nn.GRUCell`'s equations by hand.

Products with weights are taken for all steps at once where they can be, and autograd has one
operation to record instead of ten in every step. `patch+gru` trains 1.5 times as fast for it, in
minibatches of 4 environments.
"""

from typing import Any

import torch
from torch import Tensor, nn
from torch.autograd.function import once_differentiable


def unroll(cell: nn.GRUCell, features: Tensor, state: Tensor, begins: Tensor) -> Tensor:
    """Return the states [T, N, W] after each step, given `features` [T, N, F].

    The state [N, W] before them counts as 0 where an episode `begins`, [T, N] bool.
    """
    shown = nn.functional.linear(features, cell.weight_ih, cell.bias_ih)
    return _States.apply(shown, state, ~begins[..., None], cell.weight_hh, cell.bias_hh)


class _States(torch.autograd.Function):
    @staticmethod
    def forward(
        ctx: Any, shown: Tensor, state: Tensor, goes_on: Tensor, weight: Tensor, bias: Tensor
    ) -> Tensor:
        two = 2 * state.shape[1]  # gates: reset and keep, beside the new state
        before, after = shown.new_empty(2, *shown.shape[:2], state.shape[1])
        gates, recalled = torch.empty_like(shown), torch.empty_like(shown)
        for t, said in enumerate(shown):
            old = torch.mul(state, goes_on[t], out=before[t])
            of_old = torch.addmm(bias, old, weight.t(), out=recalled[t])
            both, new = gates[t].tensor_split([two], 1)
            torch.add(said[:, :two], of_old[:, :two], out=both).sigmoid_()
            reset, keep = both.chunk(2, 1)
            torch.addcmul(said[:, two:], reset, of_old[:, two:], out=new).tanh_()
            state = torch.lerp(new, old, keep, out=after[t])
        ctx.save_for_backward(before, gates, recalled[..., two:], goes_on, weight)
        return after

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *by: Tensor) -> tuple[Tensor | None, ...]:  # pyrefly: ignore
        (by_after,), (before, gates, of_old, goes_on, weight) = by, ctx.saved_tensors
        reset, keep, new = gates.chunk(3, 2)
        by_new = (1 - keep) * (1 - new * new)  # of a state, by what enters tanh
        by_keep, by_reset = (before - new) * keep * (1 - keep), of_old * reset * (1 - reset)
        entered, by_old = torch.empty_like(gates), torch.empty_like(gates)
        by_state = torch.zeros_like(before[0])
        for t in reversed(range(len(gates))):
            by_state = by_state + by_after[t]
            (_, _, new), (first, second, third) = entered[t].chunk(3, 1), by_old[t].chunk(3, 1)
            torch.mul(by_state, by_new[t], out=new)
            torch.mul(new, by_reset[t], out=first)
            torch.mul(by_state, by_keep[t], out=second)
            torch.mul(new, reset[t], out=third)
            by_state = torch.addmm(by_state * keep[t], by_old[t], weight) * goes_on[t]
        entered[..., : -before.shape[2]] = by_old[..., : -before.shape[2]]
        together = by_old.flatten(0, 1)
        return entered, by_state, None, together.t() @ before.flatten(0, 1), together.sum(0)
