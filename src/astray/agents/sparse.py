"""The small network on a CPU, without the products with the many zeros of symbolic planes.

Of Maze's 294 inputs some 33 are not 0, so that its first layer is a sum of 33 rows of weights.
"""

from __future__ import annotations

import functools
from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from astray.agents.small import Small, Spread
from astray.kernel.jit import entry, one_at_a_time

TOGETHER = 4  # rows of weights added at once, so that the sum is read and written less often


def usable() -> bool:
    """Whether the kernels are compiled; interpreted, they are slower than the zeros."""
    return not numba.config.DISABLE_JIT  # pyright: ignore


def outputs(network: Small, planes: Tensor, between: torch.dtype = torch.float32) -> Tensor:
    """Logits, and in the last column values [B, actions + 1], but for rounding the network's own.

    planes   [B, C, H, W] uint8, on a CPU
    between  of the products between the two hidden layers; most of the time goes there
    """
    one, two = network.features.linear1, network.features.linear2
    heads = [
        torch.cat(both) for both in zip(*map(_linear, (network.policy, network.value)), strict=True)
    ]
    return Forward.apply(  # pyright: ignore
        planes, network.spread, between, *_linear(one), *_linear(two), *heads
    )


def _linear(layer: Any) -> tuple[Tensor, Tensor]:
    return layer.weight, layer.bias


class Forward(torch.autograd.Function):
    """`Small`, its two heads as one layer [actions + 1, width]: planes -> [B, actions + 1]."""

    @staticmethod
    def forward(
        ctx: Any, planes: Tensor, spread: Spread, between: torch.dtype,
        w1: Tensor, b1: Tensor, w2: Tensor, b2: Tensor, w3: Tensor, b3: Tensor,
    ) -> Tensor:  # fmt: skip
        ctx.found = ends, rows, values = _found(planes, spread)
        h1 = planes.new_empty((len(planes), len(w1)), dtype=torch.float32)
        weight, bias = w1.detach().T.contiguous().numpy(), b1.detach().numpy()
        add_rows(ends, rows, values, weight, bias, h1.numpy())
        rounded, w2 = h1.to(between), w2.to(between)
        h2 = torch.addmm(b2.to(between), rounded, w2.T).float().relu_()
        ctx.save_for_backward(w1, h1, rounded, w2, h2, w3)
        return torch.addmm(b3, h2, w3.T)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, slope: Tensor) -> tuple[Tensor | None, ...]:  # pyright: ignore
        w1, h1, rounded, w2, h2, w3 = ctx.saved_tensors
        slope2 = torch.ops.aten.threshold_backward(slope @ w3, h2, 0)  # through the ReLU
        rounded2 = slope2.to(w2.dtype)
        slope1, grad2 = (rounded2 @ w2).float(), (rounded2.T @ rounded).float()
        grad1, bias1 = w1.new_zeros(w1.shape[::-1]), w1.new_zeros(len(w1))
        ends, rows, values = ctx.found
        add_to_rows(ends, rows, values, h1.numpy(), slope1.numpy(), grad1.numpy(), bias1.numpy())
        return (
            None, None, None, grad1.T, bias1, grad2, slope2.sum(0), slope.T @ h2, slope.sum(0),
        )  # fmt: skip


def _found(planes: Tensor, spread: Spread) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """What `find` finds in `planes` [B, C, H, W]."""
    given = planes.flatten(2).numpy()
    most = 2 * np.count_nonzero(given) + TOGETHER * len(given)
    ends = np.empty(len(given) + 1, np.int64)
    rows, values = np.empty(most, np.int64), np.empty(most, np.float32)
    compiled()
    find(given, spread.flags, spread.circle.numpy(), ends, rows, values)
    return ends, rows, values


@functools.cache
def compiled() -> None:
    """Compile the kernels for the types to come, or take them from the cache."""
    with one_at_a_time():
        ends, rows = np.zeros(1, np.int64), np.empty(0, np.int64)
        values, table = np.empty(0, np.float32), np.empty((0, 1), np.float32)
        find(np.empty((0, 1, 1), np.uint8), 0, np.empty((2, 256), np.float32), ends, rows, values)
        add_rows(ends, rows, values, table, values, table)
        add_to_rows(ends, rows, values, table, table, table, values)


@entry
def find(planes, flags, circle, ends, rows, values):
    """Fill `rows`, `values` with the inputs that are not 0; sample i's are ends[i]:ends[i + 1].

    planes  [B, C, cells] uint8; `flags` of 0 and 1 come first, the others become two inputs a
            cell each, as in `Spread`
    Each sample's are filled up with zeros to a multiple of `TOGETHER`.
    """
    _, count, cells = planes.shape
    second = (count - flags) * cells  # from a category's first input to its second
    n = 0
    ends[0] = 0
    for i in range(len(planes)):
        for k in range(flags):
            for cell in range(cells):  # no branch: half of Maze's walls would be predicted wrong
                rows[n] = k * cells + cell
                values[n] = 1
                n += planes[i, k, cell] != 0
        for k in range(flags, count):
            for cell in range(cells):
                category = planes[i, k, cell]
                if category != 0:
                    rows[n] = k * cells + cell
                    values[n] = circle[0, category]
                    rows[n + 1] = k * cells + cell + second
                    values[n + 1] = circle[1, category]
                    n += 2
        while n % TOGETHER:
            rows[n], values[n] = 0, 0
            n += 1
        ends[i + 1] = n


@entry
def add_rows(ends, rows, values, weight, bias, hidden):
    """Fill `hidden` [B, width] with the ReLU of the first layer; `weight` is [inputs, width]."""
    for i in range(len(hidden)):
        for x in range(len(bias)):
            hidden[i, x] = bias[x]
        for n in range(ends[i], ends[i + 1], TOGETHER):
            a, b, c, d = rows[n], rows[n + 1], rows[n + 2], rows[n + 3]
            p, q, r, s = values[n], values[n + 1], values[n + 2], values[n + 3]
            for x in range(len(bias)):
                pair = p * weight[a, x] + q * weight[b, x]
                hidden[i, x] += pair + (r * weight[c, x] + s * weight[d, x])
        for x in range(len(bias)):
            hidden[i, x] = max(hidden[i, x], np.float32(0))


@entry
def add_to_rows(ends, rows, values, hidden, slope, weight, bias):
    """Add to `weight` and `bias` their gradients, given that of `hidden`, `slope` [B, width]."""
    through = np.empty(len(bias), np.float32)
    for i in range(len(hidden)):
        for x in range(len(bias)):
            through[x] = slope[i, x] if hidden[i, x] > 0 else np.float32(0)
            bias[x] += through[x]
        for n in range(ends[i], ends[i + 1]):
            row, value = rows[n], values[n]
            for x in range(len(bias)):
                weight[row, x] += value * through[x]
