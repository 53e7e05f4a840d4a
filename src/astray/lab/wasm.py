"""Kernels as WebAssembly, for pages without Python.

numba infers types and lowers kernels as for this machine; LLVM then emits WebAssembly instead of
machine code, so a page computes the same numbers. JavaScript calls the kernels through
`page/rules/memory.js`, which copies states and arrays into WebAssembly's memory and back.
"""

import base64
import functools
import json
import re
from collections.abc import Callable, Mapping
from types import FunctionType
from typing import Any

import llvmlite
import llvmlite.binding as llvm
import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, target_extension, types
from numba.core.callconv import CPUCallConv, excinfo_ptr_t
from numba.core.codegen import CPUCodegen, CPUCodeLibrary
from numba.core.compiler_lock import global_compiler_lock
from numba.core.cpu import CPUContext, CPUTargetOptions
from numba.core.descriptors import TargetDescriptor
from numba.core.dispatcher import Dispatcher
from numba.core.registry import cpu_target
from numba.core.typing.context import Context

from astray import provenance
from astray.kernel.jit import code_digest, code_folder
from astray.kernel.stored import Stored

NAME = "wasm"  # of the target, in numba
TRIPLE, FEATURES = "wasm32-unknown-unknown", "+bulk-memory,-nontrapping-fptoint,+sign-ext"
# What the page gives to modules, in `page/rules/memory.js`, besides memory and stack.
GIVEN = {
    "__multi3", "fmod", "fmodf", "numba_attempt_nocopy_reshape", "NRT_Allocate", "NRT_Free",
    "NRT_MemInfo_alloc_aligned", "NRT_MemInfo_data_fast", "NRT_MemInfo_new_varsize_dtor",
    "NRT_MemInfo_varsize_realloc",
}  # fmt: skip
# Memory is not counted by references: the page forgets all of it before each call.
UNCOUNTED = """
define void @NRT_incref(ptr %info) alwaysinline { ret void }
define void @NRT_decref(ptr %info) alwaysinline { ret void }
"""
# NumPy's codes of the types of numbers that `page/rules/memory.js` has.
CODES = ("b1", "f4", "f8", "i1", "i2", "i4", "i8", "u1", "u2", "u4", "u8")
LARGEST = 2**20  # bytes; a page keeps as much for constants
IMPORTS, EXPORTS = 2, 7  # sections of a module
LINKING = b"\x07linking"  # begins the section of an object file that has its symbols
COLOURS = re.compile(r"\x1b\[[0-9;]*m")


class _WebAssembly(target_extension.CPU):
    """The target's name in numba's hierarchy: what is for any CPU is for it, too."""


class _Library(CPUCodeLibrary):
    """Code that is optimised once, when all of a module is linked; its integers wrap around."""

    def add_ir_module(self, ir_module: ir.Module) -> None:
        for block in (one for function in ir_module.functions for one in function.blocks):
            for done in block.instructions:
                done.flags = [flag for flag in done.flags if flag != "nsw"]
        super().add_ir_module(ir_module)

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_specific(self) -> None:
        pass


class _Codegen(CPUCodegen):
    _library_class = _Library

    def _init(self, llvm_module: Any) -> None:
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
        target = llvm.Target.from_triple(TRIPLE)
        self._tm = target.create_target_machine(opt=3, features=FEATURES)
        self._tm_features, self._target_data = FEATURES, self._tm.target_data
        self._data_layout = str(self._target_data)
        self._loopvect, self._opt_level = False, 0

    def _create_empty_module(self, name: str) -> Any:
        module = super()._create_empty_module(name)
        module.triple = TRIPLE
        return module

    def _add_module(self, module: Any) -> None:
        pass


class _CallConv(CPUCallConv):
    """Errors are texts: Python's would be pickled, with the paths of the user's files."""

    def set_static_user_exc(self, builder, exc, exc_args=None, loc=None, func_name=None):
        text = ": ".join(map(str, (exc.__name__, *(exc_args or ()))))
        at = builder.bitcast(self.context.insert_const_string(builder.module, text), excinfo_ptr_t)
        builder.store(at, self._get_excinfo_argument(builder.function))

    def set_dynamic_user_exc(self, builder, exc, exc_args, nb_types, loc=None, func_name=None):
        self.set_static_user_exc(builder, exc)


class _Context(CPUContext):
    """Compilation for a machine without Python."""

    allow_dynamic_globals = False  # all arrays are copied into the code

    def init(self) -> None:  # pyrefly: ignore
        self.is32bit = False  # which is of integers, that are as in Python
        self._internal_codegen: Any = _Codegen("astray")

    @property
    def call_conv(self) -> _CallConv:
        return _CallConv(self)

    def post_lowering(self, mod: Any, library: Any) -> None:
        """Do not link numba's own memory, which is of this machine."""

    def get_executable(self, library: Any, fndesc: Any, env: Any) -> object:
        """Return a key by which numba finds the function."""
        return object()

    def make_constant_array(self, builder: Any, typ: Any, ary: Any) -> Any:
        """Keep an array without gaps, as its data are: numba keeps the strides of views."""
        return super().make_constant_array(builder, typ, ary.copy("A"))

    def cast(self, builder: Any, val: Any, fromty: types.Type, toty: types.Type) -> Any:
        """Raise an error in a page where a real number does not fit an integer: machines differ."""
        if isinstance(fromty, types.Float) and isinstance(toty, types.Integer):
            whole = builder.call(builder.module.declare_intrinsic("llvm.trunc", [val.type]), [val])
            least, beyond = map(val.type, (float(toty.minval), float(toty.maxval + 1)))
            low = builder.fcmp_unordered("<", whole, least)  # or NaN
            high = builder.fcmp_unordered(">=", whole, beyond)
            with cgutils.if_unlikely(builder, builder.or_(low, high)):
                said = f"a real number must be one that {toty} can hold"
                self.call_conv.return_user_exc(builder, ValueError, (said,))
        return super().cast(builder, val, fromty, toty)

    def call_unresolved(self, builder: Any, name: str, sig: Any, args: Any) -> Any:
        raise NotImplementedError("a page has no recursion")

    def add_dynamic_addr(self, builder: Any, intaddr: int, info: str) -> Any:
        """Return no address: kernels are called by name, and a page has no other objects."""
        if info not in ("function", "CPUDispatcher", _Dispatcher.__name__):
            raise NotImplementedError(f"a page has no {info}")
        return cgutils.get_null_value(cgutils.voidptr_t)


class _Typing(Context):
    """Types, among which kernels are those that are compiled for this target."""

    def __init__(self) -> None:
        super().__init__()
        self.kernels: dict[Any, types.Dispatcher] = {}

    def resolve_value_type(self, val: Any) -> Any:
        if getattr(val, "__name__", "") == "raise_with_shape_context":
            val = _misshapen  # numba's own writes the shapes, for which it needs logarithms
        try:
            found = super().resolve_value_type(val)
        except ValueError:  # of a function that is not compiled, as where numba is switched off
            if not isinstance(val, FunctionType):
                raise
            return self._kernel(val, val)
        if isinstance(found, types.Dispatcher) and not isinstance(found.dispatcher, _Dispatcher):
            return self._kernel(found.dispatcher, found.dispatcher.py_func)
        return found

    def _kernel(self, one: Any, function: Any) -> types.Dispatcher:
        options = getattr(one, "targetoptions", {})
        if options.get("fastmath"):
            said = "has fastmath, whose results differ between machines"
            raise NotImplementedError(f"{function.__name__} {said}")
        if one not in self.kernels:
            made = _Dispatcher(function, options | {"locals": getattr(one, "locals", None)})
            # also of `made`, which the type alone would not keep
            self.kernels[one] = self.kernels[made] = types.Dispatcher(made)
            if not getattr(one, "_can_compile", True):  # numbers are converted to declared types
                for signature in one.nopython_signatures:
                    made.compile(signature)
                made.disable_compile()
        return self.kernels[one]


def _misshapen(_shapes: Any, _others: Any) -> None:
    raise ValueError("an array must be of the shape of the part that it is assigned to")


class _Target(TargetDescriptor):
    options = CPUTargetOptions

    @functools.cached_property
    def typing_context(self) -> Any:  # pyrefly: ignore
        return _Typing()

    @functools.cached_property
    def target_context(self) -> Any:  # pyrefly: ignore
        return _Context(self.typing_context, NAME)


class _Dispatcher(Dispatcher):
    targetdescr = _Target(NAME)

    def __init__(self, function: Any, options: Mapping[str, Any]):
        # numba's own functions name a target; and here is no cache
        kept = {n: of for n, of in options.items() if n not in ("target", "cache", "locals")}
        alone = {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
        super().__init__(function, options.get("locals"), targetoptions=kept | alone)

    def add_overload(self, cres: Any) -> None:
        self.overloads[tuple(cres.signature.args)] = cres


def _jit(function: Any = None, **options: Any) -> Any:
    """Compile for this target, as numba does with parts of its own."""
    return _Dispatcher(function, options) if function else functools.partial(_jit, **options)


target_extension.target_registry[NAME] = _WebAssembly
target_extension.dispatcher_registry[_WebAssembly] = _Dispatcher
target_extension.jit_registry[_WebAssembly] = _jit


def compiled(kernels: Mapping[str, tuple[Callable, tuple[types.Type, ...]]]) -> str:
    """Return kernels as an expression of JavaScript, an object of functions; it is kept in a file.

    Args:
        kernels: Name on the page -> a function, and the types of its arguments: numbers, arrays in
            C's order, or records.

    Raises:
        ValueError: If one of them cannot be compiled, or needs what a page does not have.
    """
    make = functools.partial(_compiled, kernels)
    told = {name: (code_digest(kernel), takes) for name, (kernel, takes) in kernels.items()}
    digest = provenance.digest(_compiled, data=(llvmlite.__version__, told))
    if not digest or not all(known for known, _ in told.values()):  # as in a notebook
        return make()
    (first, _), *_ = kernels.values()
    return Stored(getattr(first, "py_func", first), digest, code_folder).text(make)


@global_compiler_lock
def _compiled(kernels: Mapping[str, tuple[Callable, tuple[types.Type, ...]]]) -> str:
    machine: Any = cpu_target.target_context
    machine.refresh()  # whose own memory is made first
    context = _Dispatcher.targetdescr.target_context
    context.refresh()
    context.typing_context.kernels.clear()  # the values of their constants may be others by now
    about, exported = {}, {}
    whole = llvm.parse_assembly(UNCOUNTED)
    whole.triple, whole.data_layout = TRIPLE, context.codegen()._data_layout
    for name, (kernel, takes) in kernels.items():
        found = _compile(name, kernel, takes, context)
        about[name] = {"takes": [*map(_told, takes)], "returns": _returned(found, name, context)}
        found.library._ensure_finalized()
        whole.link_in(found.library._final_module, preserve=True)
        exported[found.fndesc.llvm_func_name] = name
    data = _linked(whole, exported, context)
    if len(data) > LARGEST:
        raise ValueError(f"rules of a page must be at most {LARGEST} bytes; got {len(data)}")
    return f"await kernels({json.dumps(base64.b64encode(data).decode())}, {json.dumps(about)})"


def _compile(name: str, kernel: Any, takes: tuple[types.Type, ...], context: Any) -> Any:
    try:
        with target_extension.target_override(NAME):  # also of what numba asks for later
            made: Any = context.typing_context.resolve_value_type(kernel).dispatcher
            if takes not in made.overloads:
                made.compile(takes)
    except Exception as error:  # numba raises nearly anything for what it cannot compile
        said = " ".join(COLOURS.sub("", str(error)).split())[:300]
        raise ValueError(f"{name} must be compiled for a page without Python: {said}") from None
    return made.overloads[takes]


def _told(kind: types.Type) -> Any:
    """Return how the page keeps an argument: the code of a number, an array, or a record."""
    if not isinstance(kind, types.Record):
        return {"of": _code(kind.dtype)} if isinstance(kind, types.Array) else _code(kind)
    fields = []
    for name in kind.fields:
        one: Any = kind.typeof(name)
        code = _code(getattr(one, "dtype", one), f"in the field {name!r}")
        fields.append([name, kind.offset(name), code, getattr(one, "shape", ())])
    return {"size": kind.size, "fields": fields}


def _code(kind: Any, where: str = "as an argument") -> str:
    """Return a type of numbers that JavaScript has, too, as NumPy writes it."""
    found = [code for code in CODES if numba.from_dtype(np.dtype(code)) == types.unliteral(kind)]
    if not found:
        raise ValueError(f"a page must have real numbers {where}; got {kind}")
    return found[0]


def _returned(found: Any, name: str, context: Any) -> Any:
    """Return the record of what a kernel returns: a "value", or the parts of a tuple by number."""
    kind: Any = types.unliteral(found.signature.return_type)
    if kind == types.none:
        return None
    parts = [*getattr(kind, "types", (kind,))]
    codes = [_code(one, f"from {name}, or a tuple of them") for one in parts]
    layout = context.data_model_manager[kind].get_return_type()
    if not isinstance(layout, ir.LiteralStructType):  # a number, or parts of one type
        layout = ir.LiteralStructType([getattr(layout, "element", layout)] * len(parts))
    at = [layout.get_element_offset(context.target_data, k) for k in range(len(parts))]
    names = map(str, range(len(parts))) if isinstance(kind, types.BaseTuple) else ["value"]
    fields = [[*one, []] for one in zip(names, at, codes, strict=True)]
    return {"size": layout.get_abi_size(context.target_data), "fields": fields}


def _linked(whole: Any, exported: Mapping[str, str], context: Any) -> bytes:
    """Optimise a module of LLVM; return that of WebAssembly with the functions `exported`."""
    for one in (*whole.functions, *whole.global_variables):
        if not one.is_declaration and one.name not in exported:
            one.linkage = "internal"  # left out if unused
    machine = context.codegen()._tm
    passes = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    passes.getModulePassManager().run(whole, passes)
    sections = _sections(machine.emit_object(whole))
    if lacking := {*_imported(dict(sections).get(IMPORTS, b""))} - GIVEN:
        told = ", ".join(sorted(lacking))
        raise ValueError(f"{', '.join(exported.values())}: a page without Python has no {told}")
    (symbols,) = (part for kind, part in sections if not kind and part.startswith(LINKING))
    told = (_string(as_) + b"\0" + _index(symbols, name) for name, as_ in exported.items())
    kept = [one for one in sections if one[0]]  # others are for linkers
    first = next(k for k, (kind, _) in enumerate(kept) if kind > EXPORTS)
    kept.insert(first, (EXPORTS, _number(len(exported)) + b"".join(told)))
    return b"\0asm\1\0\0\0" + b"".join(bytes([n]) + _number(len(p)) + p for n, p in kept)


def _number(value: int) -> bytes:
    """Write an integer as WebAssembly does: 7 bits a byte, the lowest first."""
    more, rest = value & 127, value >> 7
    return bytes([more | 128]) + _number(rest) if rest else bytes([more])


def _string(text: str) -> bytes:
    return _number(len(text.encode())) + text.encode()


def _sections(data: bytes) -> list[tuple[int, bytes]]:
    """Return the kind of each section of a module, and its bytes."""
    at, found = 8, []
    while at < len(data):
        kind, size, shift = data[at], 0, 0
        while not shift or data[at] > 127:
            at += 1
            size, shift = size | (data[at] & 127) << shift, shift + 7
        found.append((kind, data[at + 1 : at + 1 + size]))
        at += 1 + size
    return found


def _imported(section: bytes) -> list[str]:
    """Return the names of the functions that a module imports, all of them from "env"."""
    several = section.split(_string("env"))[1:]  # each: a name, 0 of a function, its type
    return [one[1 : 1 + one[0]].decode() for one in several if one[1 + one[0]] == 0]


def _index(symbols: bytes, name: str) -> bytes:
    """Return a function's number, as the symbols of an object file have it in front of its name."""
    begin = end = symbols.index(_string(name))
    while begin == end or symbols[begin - 1] > 127:
        begin -= 1
    return symbols[begin:end]
