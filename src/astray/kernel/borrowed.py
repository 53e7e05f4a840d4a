"""Arrays whose references compiled code does not count, since their owners outlive the call.

Counting them took half of a step of Maze with symbols, and some sixth of one with images.
"""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic, overload


def borrowed(arrays: Any) -> Any:
    """Return arrays, also within tuples, without their owners; no caller may keep them."""
    return arrays


# Not strict, as its compiled form would need the same annotations.
@overload(borrowed, strict=False)
def _borrowed(arrays: Any) -> Any:
    return lambda arrays: _without_owners(arrays)  # pyrefly: ignore


@intrinsic
def _without_owners(typing: Any, arrays: Any) -> Any:
    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return _stripped(context, builder, arrays, arguments[0])

    return arrays(arrays), generate


def _stripped(context: Any, builder: Any, kind: Any, value: Any) -> Any:
    if isinstance(kind, types.BaseTuple):
        parts = zip(kind, cgutils.unpack_tuple(builder, value), strict=True)  # pyrefly: ignore
        return context.make_tuple(builder, kind, [_stripped(context, builder, *x) for x in parts])
    if not isinstance(kind, types.Array):
        return value
    array = context.make_array(kind)(context, builder, value)
    array.meminfo = ir.Constant(array.meminfo.type, None)
    return array._getvalue()
