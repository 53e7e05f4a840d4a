"""Kernels as JavaScript, for pages without Python.

Kernels are a small part of Python: numbers, loops, fields of a state. Reals that have 32 bits in
Python are rounded to them after each operation, and integers without a sign are BigInt of 64 bits.
"""

import ast
import builtins
import functools
import inspect
import json
import re
import textwrap
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any

import numpy as np

from astray import grid
from astray.kernel.canvas import copy_flat, fill_flat
from astray.validation import shown

# What the page has itself: Python's functions -> JavaScript's, as "name" or "Math.name".
OWN = {grid.where: "where", copy_flat: "fill", fill_flat: "fill"}
BUILT_IN: dict[Any, str] = {
    abs: "Math.abs", min: "Math.min", max: "Math.max", int: "Math.trunc", bool: "yes",
    np.sign: "Math.sign", np.int64: "Math.trunc", np.floor: "Math.floor", np.ceil: "Math.ceil",
    np.sqrt: "Math.sqrt", np.float32: "Math.fround", np.float64: "Number", np.uint64: "wide",
}  # fmt: skip
SINGLE, WIDE = "float32", "uint64"  # kinds of numbers; the latter are BigInt
NATURAL = {"uint8", "uint16", "uint32"}  # which stay without a sign; the last are of 64 bits, too
TINY = {"bool", "int8", "int16", "uint8"}  # that make no real of 64 bits of one of 32
SIGNS: dict[type, str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Lt: "<", ast.LtE: "<=",
    ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=", ast.USub: "-", ast.UAdd: "+",
    ast.Not: "!",
}  # fmt: skip
CALLS: dict[type, str] = {  # by the page's functions; JavaScript's own bits are 32
    ast.FloorDiv: "floorDiv", ast.Mod: "mod", ast.BitOr: "bitOr", ast.BitAnd: "bitAnd",
    ast.LShift: "shiftLeft", ast.RShift: "shiftRight",
}  # fmt: skip
WHOLE: dict[type, str] = SIGNS | {  # between integers of 64 bits
    ast.FloorDiv: "/", ast.Mod: "%", ast.BitOr: "|", ast.BitAnd: "&", ast.BitXor: "^",
    ast.LShift: "<<", ast.RShift: ">>", ast.Div: "",
}  # fmt: skip
NUMPY = np.ndarray | np.generic
# Of a number (its type's name, or "" for others), of each part of a tuple, or of an array.
Kind = str | tuple["Kind", ...] | np.dtype
# Of `page/rules/python.js`:
NAMES = ["and", "exact", "fill", "from", "isIn", "kept", "natural", "or", "same", "where", "wide"]
NAMES.extend(["yes", *CALLS.values()])
PERHAPS_TUPLE = re.compile(r"[A-Za-z_]\w*(\(|$)")  # a name or a call
LONG = re.compile(r"(?<![\d.])\d{16,}(?![\d.e])")  # integers of a page are exact up to 2 ** 53
WORDS = frozenset(  # that mean something else in a module of JavaScript, and those of ours
    "arguments await case catch class const debugger default delete do enum eval export extends "
    "false finally function implements in instanceof interface let new null package private "
    "protected public static super switch this throw true typeof undefined var void yield "
    f"Array Boolean Math Number String game gridRules rules {' '.join(NAMES)}".split()
)


class Translation:
    """Kernels as JavaScript functions, with the constants that they use."""

    def __init__(self, fields: Mapping[str, np.dtype]):
        self.fields = fields  # of states and variants; arrays have none on a page
        self.functions: list[str] = []
        self.constants: dict[str, str] = {}
        self.names: dict[Any, str] = {}  # JavaScript's, of functions
        self.kinds: dict[str, Kind] = {}  # of what functions return
        self.stored: set[str] = set()  # fields that they write to, and more

    def module(self, about: str, *ends: str) -> str:
        """Return all that was translated as a module that ends with some lines."""
        imported = f'import {{ {", ".join(NAMES)} }} from "../rules/python.js";'
        lines = [*self.constants.values(), *self.functions, *ends]
        return "\n".join([f"// {about}, translated from Python.", imported, *lines, ""])

    def name(self, kernel: Callable, kinds: tuple[Kind, ...] = ()) -> str:
        """Return the JavaScript name of a function, which is translated at its first use.

        Args:
            kernel: The function.
            kinds: Kind of each argument.
        """
        if kernel in OWN:
            return OWN[kernel]
        function = inspect.unwrap(getattr(kernel, "py_func", kernel))
        key = function, kinds if any(kinds) else ()
        if key not in self.names:
            taken = {*self.names.values(), *self.constants}
            name = _word(function.__name__)
            name = self.names[key] = name if name not in taken else f"{name}_{len(taken)}"
            translated = _Function(self, function, name, kinds)
            self.functions.append(translated.text())
            self.kinds[name] = translated.returned or ""
        return self.names[key]

    def constant(self, name: str, value: Any) -> str:
        """Return the JavaScript name of a constant; raise ValueError if it is not plain data."""
        is_plain = type(value) in (int, float, bool, tuple) or isinstance(value, NUMPY)
        told = json.dumps(value, default=lambda array: array.tolist()) if is_plain else ""
        if type(value) is np.uint64:
            told += "n"
        elif not told or LONG.search(told):
            told = "numbers, with integers of up to 15 digits"
            raise ValueError(f"the constant {name} of a page must be {told}; got {shown(value)}")
        line = f"const {name} = {told};"
        while name in self.names.values() or self.constants.setdefault(name, line) != line:
            name += "_"
            line = f"const {name} = {line.partition(' = ')[2]}"
        return name


class _Function:
    """Translation of one function; `of` and `_statement` have a case for each kind of syntax."""

    def __init__(self, made: Translation, function: Any, name: str, kinds: tuple[Kind, ...]):
        self.made, self.function, self.name = made, function, name
        (self.tree,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
        self.arguments = [arg.arg for arg in self.tree.args.args]  # pyright: ignore
        self.kinds: dict[str, Kind] = dict(zip(self.arguments, kinds, strict=False))
        self.returned: Kind | None = None

    def text(self) -> str:
        tree: Any = self.tree
        if usual := [*tree.args.defaults, *tree.args.kw_defaults]:
            raise self._unknown(usual[0])
        names = [node for node in ast.walk(tree) if isinstance(node, ast.Name)]
        stored = [name.id for name in names if isinstance(name.ctx, ast.Store)]
        self.local = {*self.arguments, *stored}
        own = sorted({*stored} - {*self.arguments})
        lines = [f"let {', '.join(map(_word, own))};"] if own else []
        lines += self._block(tree.body)
        head = ", ".join(map(_word, self.arguments))
        return "\n".join([f"function {self.name}({head}) {{", *lines, "}"])

    def _block(self, body: list[ast.stmt]) -> list[str]:
        return [line for statement in body for line in self._statement(statement)]

    def _statement(self, node: Any) -> Iterator[str]:
        match node:
            case ast.Expr(value=ast.Constant()) | ast.Pass():
                pass  # a docstring
            case ast.Expr(value=value):
                yield f"{self.of(value)};"
            case ast.Return(value=value):
                yield f"return {self.of(value) if value else ''};"
                kind = self._lent(value)
                self.returned = self._joined(
                    kind if self.returned is None else self.returned, kind, node
                )
            case ast.Break():
                yield "break;"
            case ast.Continue():
                yield "continue;"
            case ast.Assign([ast.Tuple(targets)], ast.Tuple(values)) if any(
                isinstance(getattr(target, "slice", None), ast.Slice) for target in targets
            ) and not any(isinstance(part, ast.Attribute) for part in ast.walk(node.value)):
                for target, value in zip(targets, values, strict=True):
                    yield from self._statement(ast.Assign([target], value))
            case ast.Assign([ast.Tuple(targets) as names], ast.Attribute(_, "shape") as shape):
                parts = (ast.Subscript(shape, ast.Constant(k)) for k in range(len(targets)))
                yield from self._statement(ast.Assign([names], ast.Tuple([*parts])))
            case ast.Raise(exc=ast.Call(args=[ast.Constant(str(text))])):
                yield f"throw new Error({json.dumps(text)});"
            case ast.Assign([ast.Subscript(whole, ast.Slice(None, None, None))], value):
                yield f"{self._filled(whole, value)};"
            case ast.Assign(targets=[target], value=value):
                yield f"{self.of(target)} = {self._stored(target, value)};"
                self._learn(target, self._lent(value), node)
            case ast.AugAssign(target=target, op=op, value=value) if not _calls(target):
                whole = ast.BinOp(target, op, value)
                yield f"{self.of(target)} = {self._stored(target, whole)};"
                self._learn(target, self._kind(whole), node)
            case ast.If(test=test, body=body, orelse=other):
                yield f"if (yes({self.of(test)})) {{"
                yield from [*self._block(body), "} else {", *self._block(other), "}"]
            case ast.While(test=test, body=body, orelse=[]):
                yield f"while (yes({self.of(test)})) {{"
                yield from [*self._block(body), "}"]
            case ast.For(ast.Name(id=name), ast.Tuple() as several, body, []):
                self._learn(ast.Name(name), self._kind(several.elts[0]), node)
                yield f"for ({_word(name)} of {self.of(several)}) {{"
                yield from [*self._block(body), "}"]
            case ast.For(ast.Name(id=name), ast.Call(ast.Name("range"), args), body, []):
                self._learn(ast.Name(name), "", node)
                yield self._loop(_word(name), [self.of(arg) for arg in args])
                yield from [*self._block(body), "}"]
            case _:
                raise self._unknown(node)

    def _loop(self, name: str, ends: list[str]) -> str:
        """Return the head of a loop; like Python's, its body changes neither course nor end."""
        first, last, by = [*(["0"] if len(ends) == 1 else []), *ends, "1"][:3]
        begin = f"let {name}$ = {first}, {name}$end = {last}, {name}$by = {by}"
        within = f"({name}$end - {name}$) * {name}$by > 0"
        return f"for ({begin}; {within}; {name}$ += {name}$by) {{ {name} = {name}$;"

    def _stored(self, target: Any, value: Any) -> str:
        """Return a value as fields of a state hold it: of 32 bits, an integer, or a truth."""
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            pairs = zip(target.elts, value.elts, strict=True)
            return f"[{', '.join(self._stored(*pair) for pair in pairs)}]"
        text = self.of(value)
        if not any(isinstance(part, ast.Attribute | ast.Subscript) for part in ast.walk(target)):
            return text
        self._store(target)
        field = None if isinstance(target, ast.Tuple) else self._field(target)
        if isinstance(target, ast.Tuple) or (field and field.shape):  # pages have rows of rows
            raise self._unknown(target)
        return _cast(field, self._part(value), text)

    def _filled(self, whole: Any, value: Any) -> str:
        """Return the call that fills an array with a value, or with those of another."""
        self._store(whole)
        kind = getattr(self._kind(value), "base", self._kind(value))
        cast = _cast(self._field(whole), _named(kind) if kind else "", "x")
        return f"fill({self.of(whole)}, {self.of(value)}, (x) => {cast})"

    def _store(self, target: Any) -> None:
        parts = (part for part in ast.walk(target) if isinstance(part, ast.Attribute))
        self.made.stored.update(part.attr for part in parts)

    def _lent(self, value: Any) -> Kind:
        """Return the kind of a value; arrays in it may be written to by another name."""
        kind = self._kind(value)
        if not all(isinstance(part, str) for part in (kind if isinstance(kind, tuple) else [kind])):
            self._store(value)
        return kind

    def _field(self, node: Any) -> np.dtype | None:
        """Return the type of a field, an array, or a part of one; None for anything else."""
        places = 0
        while isinstance(node, ast.Subscript):
            places += len(node.slice.elts) if isinstance(node.slice, ast.Tuple) else 1
            node = node.value
        if isinstance(node, ast.Attribute):
            found = self.made.fields.get(node.attr) or _kind_of(self._value(node))
        else:
            found = self._kind(node)
        is_array = isinstance(found, np.dtype)
        return np.dtype((found.base, found.shape[places:])) if is_array else None

    def _array(self, node: Any) -> np.dtype | None:
        """Return the type of an array that is made, with axes of length 1; None for other nodes."""
        match node:
            case ast.Call(ast.Attribute(ast.Name("np"), "empty" | "full"), [shape, *given]):
                value = self._value(given[-1]) if given else np.float64
                kind = self._part(given[-1]) if value is None else type(value)
                if not kind:  # perhaps of an integer, perhaps of a real number
                    raise self._unknown(node)
                axes = (1,) * len(getattr(shape, "elts", "1"))
                return np.dtype((value if isinstance(value, type) else kind, axes))
        return None

    def _learn(self, target: Any, kind: Kind, node: Any) -> None:
        """Record the kinds of variables; raise ValueError if one has several."""
        if isinstance(target, ast.Tuple):
            parts = kind if isinstance(kind, tuple) else ("",) * len(target.elts)
            for one, part in zip(target.elts, parts, strict=True):
                self._learn(one, part, node)
        elif isinstance(target, ast.Name):
            self.kinds[target.id] = self._joined(self.kinds.get(target.id, kind), kind, node)

    def _joined(self, one: Any, two: Any, node: Any) -> Kind:
        """Return the kind of what has two; raise ValueError if compiled code rounds only one."""
        if tuple in (type(one), type(two)):
            pairs = zip(one or [""] * len(two), two or [""] * len(one), strict=True)
            return tuple(self._joined(*pair, node) for pair in pairs)
        if (found := _alike((one, two))) or one == two:
            return found
        if not all(isinstance(kind, str) and kind not in (SINGLE, WIDE) for kind in (one, two)):
            raise self._unknown(node)
        return ""

    def _kind(self, node: Any) -> Kind:
        """Return the kind of an expression."""
        match node:
            case ast.Name(id=name) if name in self.local:
                return self.kinds.setdefault(name, "")
            case ast.Subscript(slice=at) if isinstance(parts := self._kind(node.value), tuple):
                at = getattr(at, "value", None)
                return parts[at] if isinstance(at, int) else _alike(parts)
            case ast.Tuple(elts=parts):
                return (*map(self._kind, parts),)
            case ast.Compare() | ast.UnaryOp(op=ast.Not()):
                return "bool"
            case ast.UnaryOp(operand=value):
                return kind if (kind := self._part(value)) in (SINGLE, WIDE, *NATURAL) else ""
            case ast.BinOp(left=one, op=op, right=two):
                return _combined(type(op), self._part(one), self._part(two))
            case ast.IfExp(body=one, orelse=two):
                return _alike(map(self._kind, (one, two)))
            case ast.BoolOp(values=several):
                return _alike(map(self._kind, several))
            case ast.Call(func=function, args=args):
                return self._array(node) or self._kind_of_call(self._value(function), args)
        field = self._field(node) if isinstance(node, ast.Subscript | ast.Attribute) else None
        if field:
            return field if field.shape else _named(field).replace(WIDE, "uint32")
        return _kind_of(self._value(node))

    def _kind_of_call(self, function: Any, args: list[Any]) -> Kind:
        """Return the kind of the result of a kernel, a cast, or a function of NumPy's."""
        if _is_kernel(function):
            return self.made.kinds.get(self.made.name(function, (*map(self._kind, args),)), "")
        if isinstance(function, type) and function is not int:  # a cast
            return _named(function)
        if function not in BUILT_IN:
            return ""
        kinds = [*map(self._part, args)]
        if function is np.sqrt:
            return SINGLE if kinds[0] in (SINGLE, "uint16", *TINY) else ""
        kind = functools.reduce(functools.partial(_combined, ast.Add), kinds)
        return "" if function is int and kind == SINGLE else kind

    def _part(self, node: Any) -> str:
        kind = self._kind(node)
        return kind if isinstance(kind, str) else ""

    def of(self, node: Any) -> str:
        """Return an expression."""
        match node:
            case ast.Constant(value=value) if not LONG.search(text := json.dumps(value)):
                return text
            case ast.Name(id=name):
                return _word(name) if name in self.local else self._found(name, self._value(node))
            case ast.Attribute(value=ast.Name(id=name), attr=attribute) if self._is_module(name):
                return self._found(attribute, self._value(node))
            case ast.Attribute(value=value, attr=attribute) if attribute in self.made.fields:
                return f"{self.of(value)}.{attribute}"
            case ast.Subscript(ast.Attribute(array, "shape"), ast.Constant(int(place))):
                return f"{self.of(array)}{'[0]' * place}.length"
            case ast.Subscript(value=value, slice=place):
                whole = array = self.of(value)
                for one in place.elts if isinstance(place, ast.Tuple) else [place]:
                    at = self.of(one)
                    if not at.isdigit() and _calls(value):  # which would be called twice
                        raise self._unknown(node)
                    at = at if at.isdigit() else f"from({at}, {array})"
                    whole, array = f"{whole}[{at}]", f"{array}[0]"
                return whole
            case ast.Tuple(elts=parts) | ast.List(elts=parts):
                return f"[{', '.join(map(self.of, parts))}]"
            case ast.IfExp(test=test, body=body, orelse=other):
                return f"(yes({self.of(test)}) ? {self.of(body)} : {self.of(other)})"
            case ast.BinOp(left=one) | ast.UnaryOp(operand=one) | ast.Compare(left=one) if any(
                isinstance(self._kind(side), np.dtype)
                for side in (one, getattr(node, "right", one))
            ):  # a page cannot calculate with whole arrays
                raise self._unknown(node)
            case ast.UnaryOp(op=ast.Not(), operand=value):
                return f"!yes({self.of(value)})"
            case ast.UnaryOp(op=op, operand=value) if type(op) in SIGNS:
                if isinstance(op, ast.USub) and self._part(value) in NATURAL:
                    raise self._unknown(node)
                rounded = "wide" if self._part(value) == WIDE else ""
                return f"{rounded}({SIGNS[type(op)]}{self.of(value)})"
            case ast.BoolOp(ast.And(), [*tests, last]) if {*map(type, tests)} == {ast.Compare}:
                return f"({' && '.join(map(self.of, [*tests, last]))})"
            case ast.BoolOp(op=op, values=[value, *others]):  # to JavaScript any array is true
                rest = self.of(others[0] if others[1:] == [] else ast.BoolOp(op, others))
                return f"{'or' if type(op) is ast.Or else 'and'}({self.of(value)}, () => {rest})"
            case ast.BinOp(left=left, op=op, right=right) if self._kind(node) == WIDE:
                return f"wide({self.of(left)} {WHOLE[type(op)]} {self.of(right)})"
            case ast.BinOp(left=left, right=right) if WIDE in map(self._part, (left, right)):
                raise self._unknown(node)
            case ast.BinOp(left=left, op=op, right=right) if type(op) in CALLS | SIGNS:
                one, two, how = self.of(left), self.of(right), CALLS.get(type(op))
                text = f"{how}({one}, {two})" if how else f"({one} {SIGNS[type(op)]} {two})"
                if self._kind(node) == SINGLE:
                    return f"Math.fround({text})"
                if isinstance(op, ast.Sub) and self._kind(node):  # of two that are NATURAL
                    return f"natural{text}"
                return f"exact{text}" if isinstance(op, ast.Add | ast.Mult | ast.Sub) else text
            case ast.Compare(ops=ops, comparators=several) if not any(map(_calls, several[:-1])):
                sides = [self.of(side) for side in (node.left, *several)]
                parts = zip(sides, map(type, ops), sides[1:], strict=False)
                return f"({' && '.join(self._compared(*part, node) for part in parts)})"
            case ast.Call(func=function, args=args, keywords=[]):
                return self._call(function, args)
        raise self._unknown(node)

    def _compared(self, one: str, op: type, two: str, node: ast.Compare) -> str:
        if op is ast.In:
            return f"isIn({one}, {two})"
        is_tuple = "[" in (one[0], two[0])  # which JavaScript compares by where it is kept
        equates = op in (ast.Eq, ast.NotEq)
        if op not in SIGNS or (is_tuple and not equates):
            raise self._unknown(node)
        if equates and (is_tuple or (PERHAPS_TUPLE.match(one) and PERHAPS_TUPLE.match(two))):
            return f"{'!' if op is ast.NotEq else ''}same({one}, {two})"
        return f"{one} {SIGNS[op]} {two}"

    def _call(self, function: Any, args: list[Any]) -> str:
        whole = ast.unparse(function)
        if whole == "np.empty" and not isinstance(args[0], ast.Tuple):
            return f"Array({self.of(args[0])}).fill(0)"
        if whole == "np.full" and isinstance(args[0], ast.Tuple) and len(args[0].elts) == 2:
            height, width, value = map(self.of, (*args[0].elts, args[1]))
            value = _cast(self._array(ast.Call(function, args, [])), self._part(args[1]), value)
            return f"Array.from({{ length: {height} }}, () => Array({width}).fill({value}))"
        if whole == "len":
            return f"{self.of(args[0])}.length"
        value, given = self._value(function), ", ".join(map(self.of, args))
        given = f"...[{given}].flat()" if value in (min, max) else given
        if OWN.get(value) == "fill":
            return self._filled(*args)
        if _is_kernel(value):
            return f"{self.made.name(value, (*map(self._lent, args),))}({given})"
        if WIDE in map(self._part, args) and value in (int, np.int64):
            return f"exact(Number({given}))"
        if WIDE in map(self._part, args) and value not in (np.float64, np.uint64, bool):
            raise self._unknown(ast.Call(function, args, []))
        text = f"{self.of(function)}({given})"
        is_single = value is np.sqrt and self._kind_of_call(value, args) == SINGLE
        return f"Math.fround({text})" if is_single else text

    def _is_module(self, name: str) -> bool:
        return name not in self.local and inspect.ismodule(self.function.__globals__.get(name))

    def _value(self, node: Any) -> Any:
        """Return the object that a name stands for outside of the function; None for others."""
        match node:
            case ast.Constant(value=value):
                return value
            case ast.Name(id=name) if name not in self.local:
                return (vars(builtins) | self.function.__globals__).get(name)
            case ast.Attribute(value=ast.Name(id=name), attr=attribute) if self._is_module(name):
                return getattr(self.function.__globals__[name], attribute)
        return None

    def _found(self, name: str, value: Any) -> str:
        """Return the name of a constant or function."""
        if _is_kernel(value):
            return self.made.name(value)
        if value is None or (callable(value) and value not in BUILT_IN):
            raise self._unknown(ast.Name(name))
        return BUILT_IN[value] if callable(value) else self.made.constant(_word(name), value)

    def _unknown(self, node: Any) -> ValueError:
        return ValueError(
            f"{self.function.__qualname__} must be translated for a page without Python, which "
            f"knows no {ast.unparse(node)!r}"
        )


def _calls(node: ast.AST) -> bool:
    """Return whether an expression calls anything, which is done once."""
    return any(isinstance(part, ast.Call) for part in ast.walk(node))


def _is_kernel(value: Any) -> bool:
    function = getattr(value, "py_func", value)
    return inspect.isfunction(function) and not function.__module__.startswith("numpy")


def _named(kind: Any) -> str:
    return name if (name := np.dtype(kind).name) in {SINGLE, WIDE, *NATURAL, *TINY} else ""


def _kind_of(value: Any) -> Kind:
    if isinstance(value, np.ndarray):
        return np.dtype((value.dtype, value.shape))
    if isinstance(value, tuple):
        return (*map(_kind_of, value),)
    return _named(type(value)) if isinstance(value, bool | np.generic) else ""


def _cast(field: np.dtype | None, kind: str, text: str) -> str:
    """Return a number of that kind as a field or an array holds it."""
    of = field.base if field else np.dtype(object)
    if of == np.float32:
        return text if kind == SINGLE else f"Math.fround({text})"
    if of.kind in "iu" and of.itemsize < 8:
        return f"kept({text}, {of.itemsize * (8 if of.kind == 'u' else -8)})"
    casts = {"i": "Math.trunc", "u": "Math.trunc", "b": "yes", "f": "Number"}
    return f"{'Number' if field and kind == WIDE else casts.get(of.kind, '')}({text})"


def _alike(kinds: Iterable[Kind]) -> Kind:
    """Return the kind of what has one of several."""
    found = {*kinds}
    return found.pop() if len(found) == 1 else "uint32" if found <= NATURAL else ""


def _combined(op: type, one: str, two: str) -> str:
    """Return the kind of an operation's result: compiled code's rules, not NumPy's."""
    both = {one, two}
    if both == {WIDE}:
        return WIDE if WHOLE.get(op) else ""
    if both == {"bool"} and op in (ast.BitAnd, ast.BitOr):
        return "bool"
    if SINGLE in both and both <= {SINGLE, *TINY}:
        return SINGLE
    both = {one} if op in (ast.LShift, ast.RShift) else both
    return "uint32" if op is not ast.Div and both <= NATURAL else ""


def _word(name: str) -> str:
    """Return a name that JavaScript may have."""
    return f"{name}_" if name in WORDS else name
