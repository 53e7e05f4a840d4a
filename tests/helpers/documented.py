"""Which arrays and errors of public functions their docstrings leave out."""

from __future__ import annotations

import ast
import builtins
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field

from astray import world

ARRAY = re.compile(r"\b(NDArray|ndarray|Tensor)\b")
# Tensors of a checkpoint, each of its own shape; functions; lists of numbers, or arrays of these.
OTHERS = re.compile(r"(dict|Mapping)\[str, Tensor\]|list\[Tensor\]|Callable\[.*\]|"
                    r".*(Sequence\[int\]|range).*")  # fmt: skip
SHAPE = r"\[[^\[\]]*\]|\bscalars?\b|\b(?:shapes?|sizes?)\b"
MADE = dict.fromkeys(["imports.missing", "imports.needed_by", "imports.extra"], "ImportError")
OURS = {"AssertionError", "NotImplementedError", "StopIteration"}  # no caller is to expect them


Functions = dict[str, ast.FunctionDef]


@dataclass
class Function:
    """A public function or method: its node, its words, and what it calls in its module."""

    name: str
    node: ast.FunctionDef
    own: str  # its docstring, or that of the method that it implements
    of_class: str
    of_module: str
    near: Functions = field(default_factory=dict)

    def arrays(self) -> dict[str, bool]:
        """Return whether a shape is documented, for each array taken and for "return"."""
        args, found = self.node.args, {}
        for one in [*args.posonlyargs, *args.args, *args.kwonlyargs]:
            if _is_array(one.annotation):
                entry = rf"^ +{one.arg}: (?:.|\n +(?!\w+: ))*?(?:{SHAPE})"
                beside = rf"\b{one.arg}\b`?:?(?: is| are)? \[|\ball (?:are )?\["
                how = re.MULTILINE | re.IGNORECASE
                found[one.arg] = bool(re.search(f"{entry}|{beside}", self.words, how))
        said = self.own.partition("Args:")[0]
        if _is_array(self.node.returns):
            back = self.own.partition("Returns:")[2] or said
            found["return"] = bool(re.search(SHAPE, f"{back}\n{self.of_module}"))
        if len(re.findall(SHAPE, said)) >= len(found):  # "Return the sums [N] of rewards [N, T]."
            return dict.fromkeys(found, True)
        if not self.own and re.search(SHAPE, self.of_class):  # as `forward` of a layer
            return dict.fromkeys(found, True)
        return found

    @property
    def words(self) -> str:
        return f"{self.own}\n{self.of_class}\n{self.of_module}"

    def unsaid(self) -> set[str]:
        """Return the errors that are raised, here or in private functions, and not named."""
        said = f"{self.own}\n{self.of_class}"
        found = errors(self.node, self.near, set())
        return {one for one in found if not any(name in said for name in _names(one))}


def _names(error: str) -> list[str]:
    """Return an error's name, and those of the errors that it is a kind of."""
    kinds = getattr(builtins, error, getattr(world, error, Exception)).__mro__
    return [error, *(kind.__name__ for kind in kinds[: -len(Exception.__mro__)])]


def _is_array(annotation: ast.expr | None) -> bool:
    said = OTHERS.sub("", ast.unparse(annotation)) if annotation else ""
    return bool(ARRAY.search(said))


def errors(node: ast.AST, near: Functions, seen: set[str]) -> set[str]:
    """Return the names of the errors that a piece of code raises and does not catch itself."""
    found = set()
    for part in ast.iter_child_nodes(node):
        inner = errors(part, near, seen)
        if isinstance(part, ast.Raise) and part.exc:
            raised = part.exc.func if isinstance(part.exc, ast.Call) else part.exc
            name = ast.unparse(raised).split(".")[-1]
            inner |= {name} if name[0].isupper() and name not in OURS else set()
        if isinstance(part, ast.Call):
            called = ast.unparse(part.func)
            inner |= {MADE[called]} if called in MADE else set()
            if called.removeprefix("self.").startswith("_") and called in near.keys() - seen:
                inner |= errors(near[called], near, seen | {called})
        if isinstance(part, ast.Try):
            caught = " ".join(ast.unparse(one.type) for one in part.handlers if one.type)
            again = set().union(*(errors(one, near, seen) for one in part.handlers))
            inner = {
                one for one in inner if not any(name in caught for name in _names(one))
            } | again
        found |= inner
    return found


def public(trees: Iterable[ast.Module]) -> Iterator[Function]:
    """Yield the public functions and methods of modules."""
    trees = list(trees)
    classes = {
        one.name: one for tree in trees for one in tree.body if isinstance(one, ast.ClassDef)
    }
    for tree in trees:
        about, here = ast.get_docstring(tree) or "", _functions(tree.body)
        for name, node in here.items():
            if not name.startswith("_"):
                yield Function(name, node, ast.get_docstring(node) or "", "", about, here)
        for parent in tree.body:
            if isinstance(parent, ast.ClassDef) and not parent.name.startswith("_"):
                yield from _methods(parent, classes, about, here)


def _methods(
    parent: ast.ClassDef, classes: dict[str, ast.ClassDef], about: str, here: Functions
) -> Iterator[Function]:
    methods, said = _functions(parent.body), ast.get_docstring(parent) or ""
    near = here | {f"self.{name}": node for name, node in methods.items()}
    if any(ast.unparse(base).endswith("autograd.Function") for base in parent.bases):
        return  # torch alone calls them
    for name, node in methods.items():
        if not name.startswith("_"):
            own = _own(name, parent, classes)
            yield Function(f"{parent.name}.{name}", node, own, said, about, near)


def _functions(body: list[ast.stmt]) -> Functions:
    return {one.name: one for one in body if isinstance(one, ast.FunctionDef)}


def _own(name: str, parent: ast.ClassDef, classes: dict[str, ast.ClassDef]) -> str:
    """Return a method's docstring, or one of a base class or a protocol that it implements."""
    method = _functions(parent.body).get(name)
    if method and (said := ast.get_docstring(method)):
        return said
    bases = [ast.unparse(base).partition("[")[0].split(".")[-1] for base in parent.bases]
    above = [classes[base] for base in bases if base in classes]
    found = [_own(name, one, classes) for one in above]
    if "Protocol" not in bases:
        found += [_own(name, one, {}) for one in classes.values() if _is_protocol(one)]
    return "\n".join(filter(None, found))


def _is_protocol(one: ast.ClassDef) -> bool:
    return any("Protocol" in ast.unparse(base) for base in one.bases)
