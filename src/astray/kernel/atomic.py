"""Numbers by which threads tell each other, in compiled code, how far they are."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

from astray.kernel.jit import kernel

LINE = 8  # int64 of a processor's cache line: threads that share one wait for each other
SPINS = 600_000  # looks at a number that is waited for; some 100 us


def store(numbers: np.ndarray, k: int, value: int) -> None:
    """Write number `k` [K, LINE] int64; who sees it sees all that was written before."""
    numbers[k, 0] = value


def load(numbers: np.ndarray, k: int) -> int:
    """Read number `k` of [K, LINE] int64, and what was written before it."""
    return numbers[k, 0]


@kernel
def wait_for(numbers, k, value):
    """Look at number `k` until it is `value`, but not for long."""
    for _ in range(SPINS):
        if load(numbers, k) == value:
            break


def _pointer(context: Any, builder: Any, kind: Any, array: Any, k: Any) -> Any:
    made = context.make_array(kind)(context, builder, array)
    zero = context.get_constant(types.intp, 0)
    return cgutils.get_item_pointer(context, builder, kind, made, [k, zero])


@intrinsic
def _store(typing: Any, numbers: Any, k: Any, value: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], *arguments[:2])
        builder.store_atomic(arguments[2], pointer, "release", 8)
        return context.get_dummy_value()

    return types.void(numbers, types.intp, types.int64), generate


@intrinsic
def _load(typing: Any, numbers: Any, k: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], *arguments)
        return builder.load_atomic(pointer, "acquire", 8)

    return types.int64(numbers, types.intp), generate


@overload(store, strict=False)
def _compiled_store(numbers: Any, k: Any, value: Any) -> Any:
    return lambda numbers, k, value: _store(numbers, k, value)


@overload(load, strict=False)
def _compiled_load(numbers: Any, k: Any) -> Any:
    return lambda numbers, k: _load(numbers, k)
