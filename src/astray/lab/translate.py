"""Rules of games as JavaScript, for pages without Python.

Kernels are a small part of Python: numbers, loops, fields of a state. `module` translates a game's
`step` and symbolic planes, of a grid world `step`, `furnish` and `seek`, and every kernel that
these call; `page/rules` has the rest. Numbers that have 32 bits in Python are rounded to them after
each operation.
"""

import ast
import builtins
import inspect
import json
import re
import textwrap
import typing
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from astray import grid
from astray.game import Game, knobs
from astray.grid.rules import settle
from astray.kernel.canvas import copy_flat
from astray.kernel.rng import below
from astray.lab.worlds import snapshot
from astray.validation import shown

# What the page has itself: Python's functions -> JavaScript's, as "name" or "Math.name".
OWN = {grid.where: "where", settle: "settle", below: "below", copy_flat: "copyFlat"}
BUILT_IN: dict[Any, str] = {
    abs: "Math.abs", min: "Math.min", max: "Math.max", int: "Math.trunc", bool: "Boolean",
    np.sign: "Math.sign", np.int64: "Math.trunc", np.floor: "Math.floor", np.ceil: "Math.ceil",
    np.sqrt: "Math.sqrt", np.float32: "Math.fround", np.float64: "Number",
}  # fmt: skip
WIDE = {int, bool, np.int64, np.float64}  # whose results are never of 32 bits
SIGNS: dict[type, str] = {
    ast.Add: "+", ast.Sub: "-", ast.Mult: "*", ast.Div: "/", ast.Lt: "<", ast.LtE: "<=",
    ast.Gt: ">", ast.GtE: ">=", ast.Eq: "==", ast.NotEq: "!=", ast.USub: "-", ast.UAdd: "+",
    ast.Not: "!", ast.And: "&&", ast.Or: "||",
}  # fmt: skip
CALLS: dict[type, str] = {  # by the page's functions; JavaScript's own bits are 32
    ast.FloorDiv: "floorDiv", ast.Mod: "mod", ast.BitOr: "bitOr", ast.BitAnd: "bitAnd",
    ast.LShift: "shiftLeft", ast.RShift: "shiftRight",
}  # fmt: skip
NUMPY = np.ndarray | np.generic
Single = bool | tuple[bool, ...]  # whether a value, or each part of one, has 32 bits
# Of `page/rules/grid.js`:
NAMES = ["below", "copyFlat", "exact", "fill", "from", "gridRules", "or", "settle", "where", "yes"]
NAMES.extend(CALLS.values())
LONG = re.compile(r"(?<![\d.])\d{16,}(?![\d.e])")  # integers of a page are exact up to 2 ** 53
WORDS = frozenset(  # that mean something else in a module of JavaScript, and those of ours
    "arguments await case catch class const debugger default delete do enum eval export extends "
    "false finally function implements in instanceof interface let new null package private "
    "protected public static super switch this throw true typeof undefined var void yield "
    f"Array Boolean Math Number String rules world {' '.join(NAMES)}".split()
)


def path(game: Game) -> str:
    """Return the path of `module` from the page, which has all but the kernels of some games."""
    return f"rules/{game.name}{'' if grid.world_of(game) else '-kernels'}.js"


def module(game: Game) -> str:
    """Return the module of a game's translated rules: a grid world's, or the kernels of others.

    Raises:
        ValueError: If its rules contain something that cannot be translated.
    """
    world = grid.world_of(game)
    (variant, *_) = game.variants.values()
    fields = {name: game.state[name].base for name in game.state.names or ()}
    made = Translation(dict.fromkeys(knobs(type(variant)), np.dtype(float)) | fields)
    step = made.name(game.rules.step)
    if world:
        ends = _of_world(game, world, variant, made, step)
    else:
        made.name(game.symbols.background_planes)
        made.name(game.symbols.foreground_planes)
        ends = [f"export {{ {', '.join(made.names.values())} }};"]
    lines = [
        f"// The rules of {game.name}, translated from Python.",
        f'import {{ {", ".join(NAMES)} }} from "./grid.js";',
        *made.constants.values(),
        *made.functions,
        *ends,
    ]
    return "\n".join(lines) + "\n"


def _of_world(game: Game, world: Any, variant: Any, made: Any, step: str) -> list[str]:
    """Return the lines that make a grid world's rules of its translated functions."""
    furnish, seek = made.name(world.furnish), made.name(world.seek)
    choices = {name: list(typing.get_args(kind)) for name, kind in knobs(type(variant)).items()}
    told = {
        "LEGEND": game.editing.LEGEND, "STOOD_ON": game.editing.STOOD_ON,
        "objects": {n: game.editing.LEGEND[char] for n, char in game.editing.OBJECTS.items()},
        "side": world.side, "held": world.held, "looks": world.looks,
        "kinds": len(world.things) + len(world.movers), "solid": world.codes(world.solid),
        "seen": game.symbols.planes(variant).shape[-1], "events": list(game.rules.EVENTS),
        "choices": {name: those for name, those in choices.items() if those},
        "agents": list(world.agents), "numbers": _numbers(game),
    }  # fmt: skip
    return [
        f"const world = {json.dumps(told)};",
        f"export const rules = gridRules({{ ...world, step: {step}, furnish: {furnish}, "
        f"seek: {seek} }});",
    ]


def _numbers(game: Game) -> list[str]:
    """Return the names of a state's numbers that a page receives."""
    s = np.zeros(1, game.state).view(np.recarray)[0]
    shown = snapshot(game, s)
    return [name for name, value in shown.items() if isinstance(value, int | float)]


class Translation:
    """Kernels as JavaScript functions, with the constants that they use."""

    def __init__(self, fields: Mapping[str, np.dtype]):
        self.fields = fields  # of states and variants; arrays have none on a page
        self.functions: list[str] = []
        self.constants: dict[str, str] = {}
        self.names: dict[Any, str] = {}  # JavaScript's, of functions
        self.single: dict[str, Single] = {}  # whether a function returns numbers of 32 bits

    def name(self, kernel: Callable, single: tuple[bool, ...] = ()) -> str:
        """Return the JavaScript name of a function, which is translated at its first use.

        Args:
            kernel: The function.
            single: Whether each of its arguments is a number of 32 bits.
        """
        if kernel in OWN:
            return OWN[kernel]
        function = inspect.unwrap(getattr(kernel, "py_func", kernel))
        key = function, single if any(single) else ()
        if key not in self.names:
            taken = {*self.names.values(), *self.constants}
            name = _word(function.__name__)
            name = self.names[key] = name if name not in taken else f"{name}_{len(taken)}"
            translated = _Function(self, function, name, single)
            self.functions.append(translated.text())
            self.single[name] = translated.returned or False
        return self.names[key]

    def constant(self, name: str, value: Any) -> str:
        """Return the JavaScript name of a constant; raise ValueError if it is not plain data."""
        is_plain = type(value) in (int, float, bool, tuple) or isinstance(value, NUMPY)
        told = json.dumps(value, default=lambda array: array.tolist()) if is_plain else ""
        if not told or LONG.search(told):
            told = "numbers, with integers of up to 15 digits"
            raise ValueError(f"the constant {name} of a page must be {told}; got {shown(value)}")
        line = f"const {name} = {told};"
        while name in self.names.values() or self.constants.setdefault(name, line) != line:
            name += "_"
            line = f"const {name} = {line.partition(' = ')[2]}"
        return name


class _Function:
    """Translation of one function; `of` and `_statement` have a case for each kind of syntax."""

    def __init__(self, made: Translation, function: Any, name: str, single: tuple[bool, ...]):
        self.made, self.function, self.name = made, function, name
        (self.tree,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
        self.arguments = [arg.arg for arg in self.tree.args.args]  # pyright: ignore
        self.single: dict[str, Single] = dict(zip(self.arguments, single, strict=False))
        self.returned: Single | None = None

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
                single = self._single(value)
                if self.returned not in (None, single):
                    raise self._unknown(node)
                self.returned = single
            case ast.Break():
                yield "break;"
            case ast.Continue():
                yield "continue;"
            case ast.Assign([ast.Subscript(whole, ast.Slice(None, None, None))], value):
                yield f"fill({self.of(whole)}, {self.of(value)});"
            case ast.Assign(targets=[target], value=value):
                yield f"{self.of(target)} = {self._stored(target, value)};"
                self._learn(target, self._single(value), node)
            case ast.AugAssign(target=target, op=op, value=value) if not _calls(target):
                whole = ast.BinOp(target, op, value)
                yield f"{self.of(target)} = {self._stored(target, whole)};"
                self._learn(target, self._single(whole), node)
            case ast.If(test=test, body=body, orelse=other):
                yield f"if (yes({self.of(test)})) {{"
                yield from [*self._block(body), "} else {", *self._block(other), "}"]
            case ast.While(test=test, body=body, orelse=[]):
                yield f"while (yes({self.of(test)})) {{"
                yield from [*self._block(body), "}"]
            case ast.For(ast.Name(id=name), ast.Call(ast.Name("range"), args), body, []):
                self._learn(ast.Name(name), False, node)
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
        """Return a value as fields of a state hold it: of 32 bits, or a truth as a number."""
        if isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple):
            pairs = zip(target.elts, value.elts, strict=True)
            return f"[{', '.join(self._stored(*pair) for pair in pairs)}]"
        field = self._field(target)
        if field == np.float32 and not self._single(value):
            return f"Math.fround({self.of(value)})"
        kind = "" if field is None else field.kind
        cast = {"i": "Math.trunc", "u": "Math.trunc", "b": "Boolean", "f": "Number"}.get(kind, "")
        return f"{cast}({self.of(value)})"

    def _field(self, node: Any) -> np.dtype | None:
        """Return the type of a state's field, or of a part of it; None for anything else."""
        while isinstance(node, ast.Subscript):
            node = node.value
        return self.made.fields.get(node.attr) if isinstance(node, ast.Attribute) else None

    def _learn(self, target: Any, single: Single, node: Any) -> None:
        """Record whether variables have 32 bits; raise ValueError if one sometimes has."""
        if isinstance(target, ast.Tuple):
            parts = single or (False,) * len(target.elts)
            for one, is_single in zip(target.elts, parts, strict=True):  # pyright: ignore
                self._learn(one, is_single, node)
        elif isinstance(target, ast.Name) and self.single.setdefault(target.id, single) != single:
            raise self._unknown(node)

    def _single(self, node: Any) -> Single:
        """Return whether an expression is a number of 32 bits, or which parts of a tuple are."""
        match node:
            case ast.Name(id=name) if name in self.local:
                return self.single.setdefault(name, False)
            case ast.Subscript(value=value):
                return self._single(value) is True
            case ast.Tuple(elts=parts):
                singles = tuple(self._single(part) is True for part in parts)
                return any(singles) and singles
            case ast.UnaryOp(op=ast.USub() | ast.UAdd(), operand=value):
                return self._single(value)
            case ast.BinOp(left=one, op=ast.Add() | ast.Sub() | ast.Mult() | ast.Div(), right=two):
                return self._single(one) is self._single(two) is True
            case ast.IfExp(body=one, orelse=two):
                return self._single(one) == self._single(two) and self._single(one)
            case ast.Call(func=function, args=args):
                return self._single_call(self._value(function), args)
        return self._field(node) == np.float32 or type(self._value(node)) is np.float32

    def _single_call(self, function: Any, args: list[Any]) -> Single:
        """Return whether a call gives a number of 32 bits: a kernel, a cast, or NumPy's of such."""
        if _is_kernel(function):
            return self.made.single.get(self.made.name(function, self._singles(args)), False)
        if function is np.float32 or function not in BUILT_IN or function in WIDE:
            return function is np.float32
        return all(self._singles(args))

    def _singles(self, args: list[Any]) -> tuple[bool, ...]:
        return tuple(self._single(arg) is True for arg in args)

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
            case ast.UnaryOp(op=ast.Not(), operand=value):
                return f"!yes({self.of(value)})"
            case ast.UnaryOp(op=op, operand=value) if type(op) in SIGNS:
                return f"({SIGNS[type(op)]}{self.of(value)})"
            case ast.BoolOp(op=ast.Or(), values=[value, other]):
                return f"or({self.of(value)}, () => {self.of(other)})"
            case ast.BoolOp(op=op, values=values):
                return f"({f' {SIGNS[type(op)]} '.join(map(self.of, values))})"
            case ast.BinOp(left=left, op=op, right=right) if type(op) in CALLS:
                return f"{CALLS[type(op)]}({self.of(left)}, {self.of(right)})"
            case ast.BinOp(left=left, op=op, right=right) if type(op) in SIGNS:
                rounded = "exact" if isinstance(op, ast.Mult) else ""
                rounded = "Math.fround" if self._single(node) else rounded
                return f"{rounded}({self.of(left)} {SIGNS[type(op)]} {self.of(right)})"
            case ast.Compare(ops=ops, comparators=several) if not any(map(_calls, several[:-1])):
                sides = [self.of(side) for side in (node.left, *several)]
                parts = zip(sides, map(type, ops), sides[1:], strict=False)
                return f"({' && '.join(self._compared(*part, node) for part in parts)})"
            case ast.Call(func=function, args=args, keywords=[]):
                return self._call(function, args)
        raise self._unknown(node)

    def _compared(self, one: str, op: type, two: str, node: ast.Compare) -> str:
        if op is ast.In:
            return f"{two}.map(String).includes(String({one}))"
        if op not in SIGNS:
            raise self._unknown(node)
        return f"{one} {SIGNS[op]} {two}"

    def _call(self, function: Any, args: list[Any]) -> str:
        whole = ast.unparse(function)
        if whole == "np.empty" and not isinstance(args[0], ast.Tuple):
            return f"Array({self.of(args[0])}).fill(0)"
        if whole == "len":
            return f"{self.of(args[0])}.length"
        value, given = self._value(function), ", ".join(map(self.of, args))
        given = f"...[{given}].flat()" if value in (min, max) else given
        if _is_kernel(value):
            return f"{self.made.name(value, self._singles(args))}({given})"
        text = f"{self.of(function)}({given})"
        return f"Math.fround({text})" if value is np.sqrt and all(self._singles(args)) else text

    def _is_module(self, name: str) -> bool:
        return name not in self.local and inspect.ismodule(self.function.__globals__.get(name))

    def _value(self, node: Any) -> Any:
        """Return the object that a name stands for outside of the function; None for others."""
        match node:
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
    return inspect.isfunction(getattr(value, "py_func", value))


def _word(name: str) -> str:
    """Return a name that JavaScript may have."""
    return f"{name}_" if name in WORDS else name
