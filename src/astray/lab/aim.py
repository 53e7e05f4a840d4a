"""The one cell that a script of a grid world goes to, compiled for pages without Python.

`seek` of a world is Python, and returns cells, an action, or nothing. Compiled code returns
things of one kind: the cell, if there is one.
"""

import ast
import inspect
import textwrap
from collections.abc import Callable
from types import CodeType, FunctionType
from typing import Any

from numba.core import types
from numba.extending import overload

from astray import grid
from astray.kernel.jit import kernel


def aim(seek: Any, goal: str) -> FunctionType:
    """Return a function (s) of the one cell (x, y) that `seek` returns for a goal, or (-1, -1).

    Raises:
        ValueError: If there is no `def` of it.
    """
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(seek))).body
    if not isinstance(tree, ast.FunctionDef):
        raise ValueError("the `seek` of a page must be a function of a `def`; got a lambda")
    asked = tree.args.args[-1]
    aimed = _Aimed(asked.arg, goal)
    aimed.generic_visit(tree)
    tree.args.args.pop()
    tree.body += aimed.of(ast.Constant(None))
    names = {**seek.__globals__, **inspect.getclosurevars(seek).nonlocals}
    names |= {_one_cell.__name__: _one_cell, _no_cells.__name__: _no_cells}
    whole = compile(ast.fix_missing_locations(ast.Module([tree], [])), "seek", "exec")
    codes = (one for one in whole.co_consts if isinstance(one, CodeType))
    return FunctionType(next(one for one in codes if one.co_name == tree.name), names)


class _Aimed(ast.NodeTransformer):
    """Writes the goal's name where `seek` asks for it, and one kind of result where it returns."""

    def __init__(self, name: str, goal: str):
        self.name, self.goal = name, goal

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.FunctionDef:
        return node  # within `seek`, which returns something else

    def visit_Name(self, node: ast.Name) -> ast.expr:
        return ast.Constant(self.goal) if node.id == self.name else node

    def visit_Compare(self, node: ast.Compare) -> ast.expr:
        self.generic_visit(node)
        match node:  # of texts, which compiled code need not know
            case ast.Compare(
                ast.Constant(str(one)), [ast.Eq() | ast.NotEq() as op], [ast.Constant(str(two))]
            ):
                return ast.Constant((one == two) == isinstance(op, ast.Eq))
        return node

    def visit_List(self, node: ast.List) -> ast.expr:
        self.generic_visit(node)
        return node if node.elts else ast.Call(ast.Name(_no_cells.__name__, ast.Load()), [], [])

    def visit_Return(self, node: ast.Return) -> Any:
        self.generic_visit(node)
        return self.of(node.value or ast.Constant(None))

    def of(self, value: Any) -> list[ast.stmt]:
        """Return statements that return the one cell of a value, whose kind tests may decide."""
        match value:
            case ast.IfExp(test=ast.Constant(true), body=one, orelse=other):
                return self.of(one if true else other)
            case ast.IfExp(test=test, body=one, orelse=other):
                return [ast.If(test, self.of(one), self.of(other))]
            case ast.BoolOp(op=op, values=[one, *others]):
                rest = others[0] if len(others) == 1 else ast.BoolOp(op, others)
                both = self.of(one), self.of(rest)
                return [ast.If(one, *(both if isinstance(op, ast.Or) else both[::-1]))]
        call = ast.Call(ast.Name(_one_cell.__name__, ast.Load()), [value], [])
        return [ast.Return(call)]


def _one_cell(found: Any) -> Any:
    raise NotImplementedError  # compiled only


@kernel
def _no_cells():
    return [(0, 0) for _ in range(0)]  # which says of what kind they are


@overload(_one_cell, strict=False)
def _compile_one_cell(found: Any) -> Callable:
    of = found.dtype if isinstance(found, types.List | types.UniTuple) else None
    if isinstance(of, types.BaseTuple):
        return lambda found: found[0] if len(found) == 1 else (-1, -1)
    return lambda found: (-1, -1)


@overload(grid.where, strict=False)
def _compile_where(layer: Any, *codes: Any) -> Callable:
    def cells(layer: Any, *codes: Any) -> list:
        found = _no_cells()
        for y in range(layer.shape[0]):
            for x in range(layer.shape[1]):
                if layer[y, x] in codes:
                    found.append((x, y))
        return found

    return cells
