"""The tests' own order: folders as in the package, helpers apart, and no test imports a test."""

import ast
import contextlib
import re
import tomllib
from pathlib import Path

import astray

TESTS = Path(__file__).parent
PACKAGE = Path(astray.__file__).parent
FILES = sorted([*TESTS.rglob("*.py"), *PACKAGE.glob("games/*/tests/*.py")])
# Lines of Python, JavaScript, CSS and HTML in the package, without tests. The aim is 44,000, and a
# commit that raises this says what for.
MOST = 55_337
# No part of the package: an attack on it, benchmarks, examples, any input, what tests share.
OTHERS = {"attack", "benchmarks", "examples", "fuzz", "helpers", "reference"}


def imported(path):
    """The modules that a file imports, also within its functions and in programs it starts."""
    trees = [ast.parse(path.read_text())]
    for node in (node for tree in trees for node in ast.walk(tree)):  # programs join the trees
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (f"{node.module or ''}.{alias.name}" for alias in node.names)
        elif (
            isinstance(node, ast.Constant)
            and isinstance(node.value, str)
            and "import" in node.value
        ):
            with contextlib.suppress(SyntaxError):  # no program
                trees.append(ast.parse(node.value))


def test_no_test_imports_a_test():
    for path in FILES:
        parts = {part for name in imported(path) for part in name.split(".")}
        assert not {part for part in parts if part.startswith("test_")}, path
        assert "conftest" not in parts, path


def lines_of_source():
    kinds = ("py", "js", "css", "html")
    paths = (path for kind in kinds for path in PACKAGE.rglob(f"*.{kind}"))
    return sum(path.read_bytes().count(b"\n") for path in paths if "tests" not in path.parts)


def test_the_source_keeps_its_budget_of_lines():
    lines = lines_of_source()
    assert lines <= MOST, (
        f"{lines} lines of source are more than {MOST}: extend a mechanism that is there, "
        "or remove as many lines as were added"
    )
    assert lines > 0.95 * MOST, f"there are {lines} lines of source: set MOST to them"


def test_there_is_a_folder_of_the_package_for_each_folder_of_tests():
    folders = {path.name for path in TESTS.iterdir() if path.is_dir() and path.name[0] not in "._"}
    assert folders - OTHERS <= {path.name for path in PACKAGE.iterdir() if path.is_dir()}


def test_helpers_hold_no_tests():
    for path in (TESTS / "helpers").glob("*.py"):
        tree = ast.parse(path.read_text())
        names = [node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef)]
        assert not [name for name in names if name.startswith("test_")], path


LAYERS = tomllib.loads((TESTS.parent / "pyproject.toml").read_text())["tool"]["importlinter"]
FLOORS = [
    {name.removeprefix("astray.") for name in floor.split(" | ")}
    for floor in LAYERS["contracts"][0]["layers"]
]


def test_each_module_of_the_package_stands_on_a_floor():
    modules = {path.stem for path in PACKAGE.iterdir() if path.suffix == ".py" or path.is_dir()}
    assert set().union(*FLOORS) == {name for name in modules if not name.startswith("__")}


def test_the_map_has_the_floors_that_the_linter_checks():
    page = (TESTS.parent / "docs" / "architecture.md").read_text()
    rows = re.findall(r"^\| (`\w+`(?:, `\w+`)*) \|", page.partition("## One mechanism")[0], re.M)
    assert [set(re.findall(r"`(\w+)`", row)) for row in rows] == FLOORS
