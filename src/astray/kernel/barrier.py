"""A barrier for threads in compiled code, and the work that they share between two barriers.

barrier is [threads, LINE] int64. Row t holds the last generation that thread t finished (thread 0,
the caller: the one that it started), the spin limit (LOOKS) and, in row 0, the number of pieces of
work taken (TAKEN).
"""

import threading
from typing import Any

import numba
import numpy as np
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload

from astray.kernel.jit import kernel

LINE = 8  # int64 of a processor's cache line: threads that share one wait for each other
GENERATION, LOOKS, TAKEN = 0, 1, 2  # columns
# Some 150 us; longer than Python takes between two steps. It never lets go of the interpreter's
# lock where nothing is compiled.
MOST_LOOKS = 0 if numba.config.DISABLE_JIT else 600_000  # pyrefly: ignore


def new_barrier(threads: int, looks: int) -> np.ndarray:
    """Return a barrier without finished generations."""
    barrier = np.zeros((threads, LINE), np.int64)
    barrier[:, LOOKS] = looks
    return barrier


@kernel
def release(barrier, thread, generation):
    """Let the waiting threads start the generation, if the caller is thread 0."""
    if thread == 0:
        store(barrier, thread, generation)


@kernel
def arrive(barrier, thread, generation):
    """Wait for the other threads (thread 0) or for the next generation; up to the spin limit."""
    if thread == 0:
        for other in range(1, barrier.shape[0]):
            wait_for(barrier, other, generation)
    else:
        store(barrier, thread, generation)
        wait_for(barrier, 0, generation + 1)


@kernel
def wait_for(barrier, thread, generation):
    """Spin until a thread's generation is `generation`, up to the spin limit."""
    for _ in range(barrier[thread, LOOKS]):
        if load(barrier, thread) == generation:
            break


def store(barrier: np.ndarray, thread: int, generation: int) -> None:
    """Publish a thread's generation; its earlier writes are then visible too."""
    barrier[thread, GENERATION] = generation


def load(barrier: np.ndarray, thread: int) -> int:
    """Return a thread's generation."""
    return barrier[thread, GENERATION]


def take(barrier: np.ndarray, count: int) -> int:
    """Take the next `count` pieces of work of this generation; return the first of them."""
    with _TAKING:
        first = barrier[0, TAKEN]
        barrier[0, TAKEN] = first + count
    return first


_TAKING = threading.Lock()


# Their compiled forms are atomic. Not strict, as the forms would need the same annotations.
@overload(store, strict=False)
def _store(barrier: Any, thread: Any, generation: Any) -> Any:
    return lambda barrier, thread, generation: _store_atomic(barrier, thread, generation)  # pyrefly: ignore


@overload(load, strict=False)
def _load(barrier: Any, thread: Any) -> Any:
    return lambda barrier, thread: _load_atomic(barrier, thread)  # pyrefly: ignore


@overload(take, strict=False)
def _take(barrier: Any, count: Any) -> Any:
    return lambda barrier, count: _take_atomic(barrier, count)  # pyrefly: ignore


@intrinsic
def _store_atomic(typing: Any, barrier: Any, thread: Any, generation: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], *arguments[:2])
        builder.store_atomic(arguments[2], pointer, "release", 8)
        return context.get_dummy_value()

    return types.void(barrier, types.intp, types.int64), generate


@intrinsic
def _load_atomic(typing: Any, barrier: Any, thread: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        pointer = _pointer(context, builder, signature.args[0], *arguments)
        return builder.load_atomic(pointer, "acquire", 8)

    return types.int64(barrier, types.intp), generate


@intrinsic
def _take_atomic(typing: Any, barrier: Any, count: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        thread = context.get_constant(types.intp, 0)
        pointer = _pointer(context, builder, signature.args[0], arguments[0], thread, column=TAKEN)
        return builder.atomic_rmw("add", pointer, arguments[1], "monotonic")

    return types.int64(barrier, types.int64), generate


def _pointer(
    context: Any, builder: Any, kind: Any, array: Any, thread: Any, column: int = GENERATION
) -> Any:
    made = context.make_array(kind)(context, builder, array)
    place = [thread, context.get_constant(types.intp, column)]
    return cgutils.get_item_pointer(context, builder, kind, made, place)
