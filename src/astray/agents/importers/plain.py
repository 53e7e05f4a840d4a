"""Reader of plain data in pickles that executes nothing: arrays, numbers, text, containers.

A pickle is a program for a small machine, and Python's own imports and calls what the program asks
for. This reader supports only the instructions that build plain data, looks up no names, calls
nothing, and refuses everything else. It also reads joblib files, whose arrays lie as raw bytes
between the instructions.

Data may share parts, so 200 bytes can describe a tuple of 2**60 numbers. No code here walks
through a value from a file, and the number of created values is bounded.
"""

import io
import math
import pickletools
import re
import struct
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from astray.validation import brief, shown

WRAPPER = "joblib.numpy_pickle NumpyArrayWrapper"
NDARRAY, DTYPE = "numpy ndarray", "numpy dtype"
BYTES = "_codecs encode"  # as protocol 2 has them: text, and "latin1"
SCALARS = ("numpy.core.multiarray scalar", "numpy._core.multiarray scalar")
DICTS = ("collections OrderedDict", "collections defaultdict")
FACTORIES = tuple(
    f"{m} {kind}" for m in ("builtins", "__builtin__") for kind in ("list", "dict", "int", "float")
)
TENSOR, PARAMETER = "torch._utils _rebuild_tensor_v2", "torch._utils _rebuild_parameter"
NAMES = (WRAPPER, NDARRAY, DTYPE, BYTES, *SCALARS, *DICTS, *FACTORIES)  # that a file may mention
KINDS = re.compile(r"b1|[iu][1248]|f[248]")  # of numbers in arrays
NODES = 100_000  # that a file may make; those of RL-Clarity take a few hundred
BITS = 1024  # of an integer
DIMENSIONS = 32  # of an array
KEYS = (str, int, float, bool, type(None))  # of a dict: whose hash is soon found
KEY_BITS = 60  # of an integer as a key; larger ones can all have one hash, which takes minutes
PUSHED = (  # instructions that carry the value that they push
    "BINUNICODE", "SHORT_BINUNICODE", "BINUNICODE8", "BINBYTES", "SHORT_BINBYTES", "BINBYTES8",
    "BININT", "BININT1", "BININT2", "LONG1", "LONG4", "BINFLOAT", "SHORT_BINSTRING",
)  # fmt: skip


Storage = Callable[[str, str, int], np.ndarray | None]


def read(
    data: bytes | io.BytesIO, storage: Storage | None = None, names: re.Pattern[str] | None = None
) -> Any:
    """Return the plain data in a pickle or uncompressed joblib file; otherwise raise ValueError.

    Args:
        data: The bytes of a file, or a file, of which one pickle is read.
        storage: Function (kind, key, count) -> numbers [count] of a tensor, or None to leave it
            out, for the pickle in a file of torch. Objects of other classes are then read as
            `Foreign`, and the classes are not imported.
        names: Names that the pickle in a file of torch may mention, by default any.
    """
    file = io.BytesIO(data) if isinstance(data, bytes) else data
    machine = _Machine(file, file.getbuffer().nbytes, storage, names)
    try:
        for instruction, argument, _ in pickletools.genops(machine.file):
            machine.spend(1)
            if instruction.name == "STOP":
                (value,) = machine.stack
                return value
            machine.do(instruction.name, argument)
    except Refused:
        raise
    except (
        ValueError, TypeError, LookupError, AttributeError, OverflowError, MemoryError,
        RecursionError, struct.error,
    ) as error:  # fmt: skip
        raise ValueError(f"it is damaged, or no pickle: {brief(error)}") from error
    raise AssertionError("pickletools ends with STOP or an error")


class Refused(ValueError):
    """Error for a file that holds more than plain data."""


@dataclass(frozen=True)
class _Name:
    """An importable name in the file, which is never imported."""

    path: str  # "module name"


@dataclass(eq=False, repr=False)  # it may hold shared tuples
class Foreign:
    """An object of a class that is not imported: its name, and what the file says is in it."""

    path: str  # "module name"
    state: Any = None


@dataclass
class _Dtype:
    """A number type in the file's description."""

    kind: str
    order: str = "="

    def numpy(self) -> np.dtype:
        if not KINDS.fullmatch(self.kind) or self.order not in "<>=|":
            raise Refused(f"it has an array of {shown(self.kind)}; only arrays of numbers are read")
        return np.dtype(self.order + self.kind)


@dataclass
class _Pending:
    """An array whose bytes follow the instruction that describes it."""

    numbers: list[int] = field(default_factory=list)  # under which it is in the memo


@dataclass
class _Machine:
    file: io.BytesIO
    size: int  # bytes of the file
    storage: Storage | None = None  # if given, objects of any class are read
    names: re.Pattern[str] | None = None
    stack: list[Any] = field(default_factory=list)
    below: list[list[Any]] = field(default_factory=list)  # stacks under the marks
    memo: dict[int, Any] = field(default_factory=dict)
    left: int = NODES

    def spend(self, nodes: int) -> None:
        """Count created values, because a few bytes could create any number of them."""
        self.left -= nodes
        if self.left < 0:
            raise Refused(f"it has more than {NODES:,} parts; no agent known has a tenth of that")

    def do(self, name: str, argument: Any) -> None:
        if name in PUSHED:
            if type(argument) is int and argument.bit_length() > BITS:
                raise Refused(f"it has an integer of {argument.bit_length():,} bits")
            self.stack.append(argument)
        elif name in ("BINPUT", "LONG_BINPUT"):
            self.note(argument)
        elif name in ("BINGET", "LONG_BINGET"):
            self.stack.append(self.memo[argument])
        elif name == "GLOBAL":
            self.stack.append(self.named(argument))
        elif name in DONE:
            DONE[name](self)
        elif name == "BINPERSID" and self.storage:
            self.stack.append(_stored(self.storage, self.stack.pop()))
        elif name not in ("PROTO", "FRAME"):
            raise Refused(f"it has the instruction {name}, which plain data does not need")

    def note(self, number: int) -> None:
        """Store the last value under a number by which the file refers to it later."""
        value = self.memo[number] = self.stack[-1]
        if isinstance(value, _Pending):
            value.numbers.append(number)

    def named(self, argument: str) -> _Name:
        known = argument in NAMES if self.storage is None else not self.names
        if not known and not (self.names and self.names.fullmatch(argument)):
            asked = shown(argument.replace(" ", "."))[1:-1]
            raise Refused(
                f"it asks for {asked}; only arrays and plain containers are read, and nothing in a "
                "file is run"
            )
        return _Name(argument)

    def popped_to_mark(self) -> list[Any]:
        popped, self.stack = self.stack, self.below.pop()
        return popped

    def array(self, description: Any) -> np.ndarray:
        """Return the array whose bytes come next in the file."""
        shape, dtype = description["shape"], description["dtype"].numpy()
        if description["subclass"] != _Name(NDARRAY):
            other = shown(description["subclass"])
            raise Refused(f"it has an array of the class {other}")
        if (
            type(shape) is not tuple
            or len(shape) > DIMENSIONS
            or any(type(n) is not int or n < 0 for n in shape)
        ):
            raise ValueError(f"an array's shape must be a tuple of integers; got {shown(shape)}")
        if description.get("numpy_array_alignment_bytes") is not None:
            self.file.read(self.file.read(1)[0])  # padding, after its length
        count = math.prod(shape)
        data = self.file.read(min(count * dtype.itemsize, self.size))
        if len(data) < count * dtype.itemsize:
            raise ValueError(f"an array of {shown(shape)} goes beyond the end of the file")
        flat = np.frombuffer(data, dtype).astype(dtype.newbyteorder("="))  # as torch needs it
        if description["order"] == "F":
            return flat.reshape(shape[::-1]).T
        return flat.reshape(shape)


def _stack_global(m: _Machine) -> None:
    name, module = _of(str, m.stack.pop()), _of(str, m.stack.pop())
    m.spend((len(module) + len(name)) // 8)  # as of `BYTES`
    m.stack.append(m.named(f"{module} {name}"))


def _mark(m: _Machine) -> None:
    m.below.append(m.stack)
    m.stack = []


def _tuple(count: int) -> Callable[[_Machine], None]:
    def done(m: _Machine) -> None:
        if len(m.stack) < count:
            raise ValueError("a tuple must be of values that came before; it is of more")
        m.stack[-count:] = [tuple(m.stack[-count:])]

    return done


def _marked_tuple(m: _Machine) -> None:
    popped = m.popped_to_mark()
    m.stack.append(tuple(popped))


def _extend(m: _Machine, values: list[Any]) -> None:
    _of(list, m.stack[-1]).extend(values)


def _update(m: _Machine, pairs: list[Any]) -> None:
    _of(dict, m.stack[-1]).update(zip(map(_key, pairs[::2]), pairs[1::2], strict=True))


def _key(value: Any) -> Any:
    if type(value) not in KEYS or (type(value) is int and value.bit_length() > KEY_BITS):
        raise Refused(f"a {type(value).__name__} is a key of a dict, not text or a small number")
    return value


def _of(kind: type, value: Any) -> Any:
    if type(value) is not kind:
        raise ValueError(f"a {type(value).__name__} where a {kind.__name__} belongs")
    return value


def _reduce(m: _Machine) -> None:
    """Return the result of a call, for the names that stand for plain data."""
    arguments, name = m.stack.pop(), m.stack.pop()
    if name == _Name(DTYPE):
        m.stack.append(_Dtype(_of(str, arguments[0])))
    elif name == _Name(BYTES) and arguments[1:] == ("latin1",):
        text = _of(str, arguments[0])
        m.spend(len(text) // 8)  # as many bytes as numbers that are eight each
        m.stack.append(text.encode("latin1"))
    elif isinstance(name, _Name) and name.path in SCALARS:
        dtype, data = arguments
        m.stack.append(np.frombuffer(data, dtype.numpy())[0].item())
    elif isinstance(name, _Name) and name.path in DICTS:
        if m.storage and arguments:  # which torch copies, whatever it is
            _of(list, arguments[0])
        pairs = arguments[0] if arguments and type(arguments[0]) is list else []
        m.spend(len(pairs))
        m.stack.append({_key(key): value for key, value in pairs})
    elif name == _Name(PARAMETER):
        m.stack.append(arguments[0])
    elif name == _Name(TENSOR):
        m.stack.append(_tensor(*arguments[:4]))
    elif m.storage and isinstance(name, _Name):
        m.stack.append(Foreign(name.path))
    else:
        raise Refused(f"it calls {shown(getattr(name, 'path', name))}")


def _tensor(flat: np.ndarray | None, offset: int, shape: Any, strides: Any) -> np.ndarray | None:
    """Return the part of a storage that a tensor is; its numbers must lie in order."""
    numbers = (offset, *_of(tuple, shape), *_of(tuple, strides))
    if any(type(n) is not int or n < 0 for n in numbers) or len(shape) > DIMENSIONS:
        raise ValueError("a tensor's shape and strides must be integers from 0 on")
    if flat is None:
        return None
    wanted = [math.prod(shape[k + 1 :]) for k in range(len(shape))]
    if list(strides) != wanted:
        raise Refused("it has a tensor whose numbers are not in order")
    return flat[offset : offset + math.prod(shape)].reshape(shape)


def _stored(storage: Storage, described: Any) -> np.ndarray | None:
    """Return the numbers [n] that a file of torch keeps under a key."""
    kind, name, key, _, count, *views = _of(tuple, described)
    is_named = type(name) is _Name and name.path.endswith("Storage")
    if kind != "storage" or not is_named or _of(int, count) < 0 or views not in ([], [None]):
        raise Refused("it keeps something other than numbers beside its data")
    return storage(name.path, _of(str, key), count)


def _new(m: _Machine) -> None:
    arguments, name = m.stack.pop(), m.stack.pop()
    is_foreign = m.storage and not m.names and isinstance(name, _Name)  # not of weights
    if not is_foreign and (name != _Name(WRAPPER) or arguments != ()):
        raise Refused(f"it makes an object of {shown(getattr(name, 'path', name))}")
    m.stack.append(Foreign(name.path) if is_foreign else _Pending())


def _build(m: _Machine) -> None:
    state, built = m.stack.pop(), m.stack[-1]
    if isinstance(built, Foreign):
        built.state = state
    elif m.storage and type(built) is dict:
        if _of(dict, state).keys() - {"_metadata"}:  # a name could hide one of its methods
            raise Refused("it has a dictionary with more than torch notes of a state's modules")
    elif isinstance(built, _Dtype):
        built.order = _of(str, state[1])
    elif isinstance(built, _Pending):
        m.stack[-1] = m.array(state)
        while built.numbers:  # each once: a file may fill the same one many times
            if m.memo[number := built.numbers.pop()] is built:
                m.memo[number] = m.stack[-1]
    else:
        raise Refused(f"it sets what is inside a {type(built).__name__}")


DONE: dict[str, Callable[[_Machine], None]] = {
    "STACK_GLOBAL": _stack_global, "REDUCE": _reduce, "NEWOBJ": _new, "BUILD": _build,
    "MARK": _mark, "MEMOIZE": lambda m: m.note(len(m.memo)),
    "NONE": lambda m: m.stack.append(None),
    "NEWTRUE": lambda m: m.stack.append(True), "NEWFALSE": lambda m: m.stack.append(False),
    "EMPTY_DICT": lambda m: m.stack.append({}), "EMPTY_LIST": lambda m: m.stack.append([]),
    "EMPTY_TUPLE": lambda m: m.stack.append(()),
    "TUPLE": _marked_tuple, "TUPLE1": _tuple(1), "TUPLE2": _tuple(2), "TUPLE3": _tuple(3),
    "APPEND": lambda m: _extend(m, [m.stack.pop()]),
    "APPENDS": lambda m: _extend(m, m.popped_to_mark()),
    "SETITEM": lambda m: _update(m, [m.stack.pop(), m.stack.pop()][::-1]),
    "SETITEMS": lambda m: _update(m, m.popped_to_mark()),
}  # fmt: skip
