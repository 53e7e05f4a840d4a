"""The mlp on a CPU, without multiplications by the many zeros of symbolic planes.

About 33 of Maze's 294 inputs are nonzero, so its first layer is a sum of 33 rows of weights.
"""

from typing import Any

import numba
import numpy as np
import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from astray.agents.mlp import MLP, CircleEmbedding
from astray.kernel.jit import entry, kernel

TOGETHER = 4  # rows of weights added at once, so that the sum is read and written less often


def usable() -> bool:
    """Return whether the kernels are compiled; interpreted ones are slower than dense products."""
    return not numba.config.DISABLE_JIT  # pyrefly: ignore


def outputs(network: MLP, planes: Tensor, between: torch.dtype = torch.float32) -> Tensor:
    """Return logits and, in the last column, values [B, actions + 1], equal up to rounding.

    Args:
        planes: [B, C, H, W] uint8, on a CPU.
        between: dtype of the product between the hidden layers, which takes most of the time.

    Raises:
        ValueError: If the network was built for planes of another shape.
    """
    spread, inputs = network.spread, network.inputs
    cells = planes.shape[2:].numel()
    if (
        planes.dim() != 4
        or planes.dtype != torch.uint8
        or planes.device.type != "cpu"
        or planes.shape[1] != spread.planes
        or spread.channels * cells != inputs
    ):
        raise ValueError(
            f"planes must be [B, {spread.planes}, H, W] uint8 on a CPU, of "
            f"{inputs // spread.channels} cells; got {planes.dtype} of shape {tuple(planes.shape)}"
        )
    return Forward.apply(planes, network.spread, between, *network.parameters())  # pyrefly: ignore


class Forward(torch.autograd.Function):
    """The mlp with both heads as one layer: planes -> [B, actions + 1]."""

    @staticmethod
    def forward(
        ctx: Any, planes: Tensor, spread: CircleEmbedding, between: torch.dtype, *weights: Tensor
    ) -> Tensor:
        w1, b1, w2, b2, policy, policy_bias, value, value_bias = weights
        ctx.found = ends, rows, values = _found(planes, spread)
        h1 = planes.new_empty((len(planes), len(w1)), dtype=between)
        weight, bias = w1.detach().T.contiguous().numpy(), b1.detach().numpy()
        add_rows(ends, rows, values, weight, bias, _bits(h1))
        w2 = w2.to(between)
        h2 = torch.addmm(b2.to(between), h1, w2.T).float().relu_()
        w3 = torch.cat([policy, value])
        ctx.save_for_backward(w1, h1, w2, h2, w3)
        return torch.addmm(torch.cat([policy_bias, value_bias]), h2, w3.T)

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, grad: Tensor) -> tuple[Tensor | None, ...]:  # pyrefly: ignore
        w1, h1, w2, h2, w3 = ctx.saved_tensors
        exact, grad_h2 = grad @ w3, torch.empty_like(h1)
        pass_relu(exact.numpy(), h2.numpy(), _bits(grad_h2))
        grad_h1, grad_w2 = grad_h2 @ w2, (grad_h2.T @ h1).float()
        grad_w1, grad_b1 = w1.new_zeros(w1.shape[::-1]), w1.new_zeros(len(w1))
        add_to_rows(*ctx.found, _bits(h1), _bits(grad_h1), grad_w1.numpy(), grad_b1.numpy())
        grad_w3, grad_b3 = grad.T @ h2, grad.sum(0)
        return (
            None, None, None, grad_w1.T, grad_b1, grad_w2, exact.sum(0),
            grad_w3[:-1], grad_b3[:-1], grad_w3[-1:], grad_b3[-1:],
        )  # fmt: skip


def _bits(x: Tensor) -> np.ndarray:
    """Return `x` as whole numbers: NumPy has no bfloat16, the upper half of a float32."""
    return x.view(torch.int16 if x.dtype == torch.bfloat16 else torch.int32).numpy()


def _found(planes: Tensor, spread: CircleEmbedding) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return the result of `find` for `planes` [B, C, H, W]."""
    given = planes.flatten(2).numpy()
    most = 2 * np.count_nonzero(given) + TOGETHER * len(given)
    ends = np.empty(len(given) + 1, np.int64)
    rows, values = np.empty(most, np.int32), np.empty(most, np.float32)
    find(given, spread.flags, spread.circle.numpy(), ends, rows, values)
    return ends, rows, values


@entry
def find(planes, flags, circle, ends, rows, values):
    """Fill `rows` and `values` with the nonzero inputs; sample i has ends[i]:ends[i + 1].

    Each sample is padded with zeros to a multiple of `TOGETHER`.

    Args:
        planes: [B, C, cells] uint8. Binary `flags` come first; each other plane becomes two inputs
            per cell, as in `CircleEmbedding`.
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
    """Fill `hidden` with the `_bits` [B, width] of the first ReLU; `weight` is [inputs, width]."""
    total = np.empty(len(bias), np.float32)
    bits, half = total.view(np.uint32), hidden.itemsize == 2
    for i in range(len(hidden)):
        for x in range(len(bias)):
            total[x] = bias[x]
        for n in range(ends[i], ends[i + 1], TOGETHER):
            a, b, c, d = rows[n], rows[n + 1], rows[n + 2], rows[n + 3]
            p, q, r, s = values[n], values[n + 1], values[n + 2], values[n + 3]
            for x in range(len(bias)):
                pair = p * weight[a, x] + q * weight[b, x]
                total[x] += pair + (r * weight[c, x] + s * weight[d, x])
        for x in range(len(bias)):
            total[x] = max(total[x], np.float32(0))
            hidden[i, x] = rounded(bits[x], half)


@entry
def pass_relu(grad, output, below):
    """Make 0 of `grad` [B, width] where a ReLU's `output` is; fill `below` with its `_bits`."""
    bits, half = grad.view(np.uint32), below.itemsize == 2
    for i in range(len(grad)):
        for x in range(grad.shape[1]):
            grad[i, x] = grad[i, x] if output[i, x] > 0 else np.float32(0)
            below[i, x] = rounded(bits[i, x], half)


@kernel
def rounded(bits, half):
    """Return a float32's bits, or if `half` the upper 16, rounded, which are a bfloat16's."""
    up = 0x7FFF + (bits >> 16 & 1)  # a remainder of one half rounds to an even number
    return (bits + half * up) >> half * 16


@entry
def add_to_rows(ends, rows, values, hidden, grad, weight, bias):
    """Add the first layer's gradients to `weight` and `bias`.

    Args:
        hidden: `_bits` [B, width] of the ReLU's output, as `grad` are of the gradient there.
    """
    bits, shift = np.empty(len(bias), np.uint32), np.uint32(32 - 8 * grad.itemsize)
    through = bits.view(np.float32)
    for i in range(len(grad)):
        for x in range(len(bias)):
            bits[x] = np.uint32(grad[i, x]) << shift if hidden[i, x] > 0 else np.uint32(0)
            bias[x] += through[x]
        for n in range(ends[i], ends[i + 1]):
            row, value = rows[n], values[n]
            for x in range(len(bias)):
                weight[row, x] += value * through[x]
