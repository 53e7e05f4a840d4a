"""How threads in compiled code share a lap of work, and wait for each other.

laps  [threads, LINE] int64: in its row each thread has the last lap that it has done, and the
      caller of the others, thread 0, the one that it has begun; beside it, in LOOKS, how often
      to look at a number that is waited for, and in TAKEN of row 0 how much of the lap's work
      somebody does or has done
"""

from __future__ import annotations

import threading
from typing import Any

import numba
import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

from astray.kernel.jit import kernel

LINE = 8  # int64 of a processor's cache line: threads that share one wait for each other
LAP, LOOKS, TAKEN = 0, 1, 2  # columns
# Some 150 us; longer than Python takes between two steps. It never lets go of the interpreter's
# lock where nothing is compiled.
MOST_LOOKS = 0 if numba.config.DISABLE_JIT else 600_000  # pyright: ignore


def new_laps(threads: int, looks: int) -> np.ndarray:
    """No lap done yet."""
    laps = np.zeros((threads, LINE), np.int64)
    laps[:, LOOKS] = looks
    return laps


@kernel
def begin_lap(laps, thread, lap):
    """The caller lets those go who wait for the lap."""
    if thread == 0:
        store(laps, thread, lap)


@kernel
def end_lap(laps, thread, lap):
    """The caller waits for the others, and each of them for the next lap; but not for long."""
    if thread == 0:
        for other in range(1, laps.shape[0]):
            wait_for(laps, other, lap)
    else:
        store(laps, thread, lap)
        wait_for(laps, 0, lap + 1)


@kernel
def wait_for(laps, thread, lap):
    """Look at a thread's number until it is `lap`."""
    for _ in range(laps[thread, LOOKS]):
        if load(laps, thread) == lap:
            break


def store(laps: np.ndarray, thread: int, lap: int) -> None:
    """Write a thread's number; who sees it sees all that the thread wrote before."""
    laps[thread, LAP] = lap


def load(laps: np.ndarray, thread: int) -> int:
    """A thread's number."""
    return laps[thread, LAP]


def take(laps: np.ndarray, count: int) -> int:
    """The first of the next `count` pieces of this lap's work, which are the caller's now."""
    with _TAKING:
        first = laps[0, TAKEN]
        laps[0, TAKEN] = first + count
    return first


_TAKING = threading.Lock()


# Their compiled forms are atomic. Not strict, as the forms would need the same annotations.
@overload(store, strict=False)
def _store(laps: Any, thread: Any, lap: Any) -> Any:
    return lambda laps, thread, lap: _store_atomic(laps, thread, lap)  # pyright: ignore


@overload(load, strict=False)
def _load(laps: Any, thread: Any) -> Any:
    return lambda laps, thread: _load_atomic(laps, thread)  # pyright: ignore


@overload(take, strict=False)
def _take(laps: Any, count: Any) -> Any:
    return lambda laps, count: _take_atomic(laps, count)  # pyright: ignore


@intrinsic
def _store_atomic(typing: Any, laps: Any, thread: Any, lap: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], *arguments[:2])
        builder.store_atomic(arguments[2], pointer, "release", 8)
        return context.get_dummy_value()

    return types.void(laps, types.intp, types.int64), generate


@intrinsic
def _load_atomic(typing: Any, laps: Any, thread: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], *arguments)
        return builder.load_atomic(pointer, "acquire", 8)

    return types.int64(laps, types.intp), generate


@intrinsic
def _take_atomic(typing: Any, laps: Any, count: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        thread = context.get_constant(types.intp, 0)
        pointer = _pointer(context, builder, signature.args[0], arguments[0], thread, column=TAKEN)
        return builder.atomic_rmw("add", pointer, arguments[1], "monotonic")

    return types.int64(laps, types.int64), generate


def _pointer(
    context: Any, builder: Any, kind: Any, array: Any, thread: Any, column: int = LAP
) -> Any:
    made = context.make_array(kind)(context, builder, array)
    place = [thread, context.get_constant(types.intp, column)]
    return cgutils.get_item_pointer(context, builder, kind, made, place)
