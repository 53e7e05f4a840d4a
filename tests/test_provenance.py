"""A digest is of all that something is computed from, and of nothing else."""

import ast
import importlib
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest

import astray
from astray import games, provenance
from astray.envs.compiled import compiled_loop
from astray.kernel.jit import code_digest
from helpers.edits import edit

PACKAGE = Path(astray.__file__).parent
SOURCES = sorted(PACKAGE.rglob("*.py"))


def parsed(path):
    """What a source imports, as Python's parser finds it: modules, each with a name from it."""
    for node in ast.walk(ast.parse(path.read_bytes())):
        if isinstance(node, ast.Import):
            yield from ((alias.name, "") for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield from (("." * node.level + (node.module or ""), a.name) for a in node.names)


def test_no_import_is_missed():
    missed = {
        str(path.relative_to(PACKAGE)): left
        for path in SOURCES
        if (left := set(parsed(path)) - provenance._statements(path.read_bytes()))
    }
    assert SOURCES and not missed


STATEMENTS = """
import one, two.three as four; import five
from .six import (  # (all)
    seven as eight,
    nine,  # of them
)
from . import ten
if True: from eleven import *
def lazy():
    from twelve \\
        import thirteen
"""
ODDLY = """from.six import seven
from.import ten
\ffrom .import(one)
from .größe import weiß
from two . three import four; import five . six as nine
from . import \\
    eight
"""


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize(("text", "count"), [(STATEMENTS, 8), ("\ufeff" + ODDLY, 7)])
def test_imports_are_found_however_they_are_written(tmp_path, text, count, end):
    (tmp_path / "written.py").write_text(text, newline=end)
    found = provenance._statements((tmp_path / "written.py").read_bytes())
    assert found == set(parsed(tmp_path / "written.py")) and len(found) == count


@pytest.mark.parametrize("game", games.OWN)
def test_kernels_depend_on_the_constants_that_they_import_and_on_no_more(game, monkeypatch):
    run = compiled_loop(games.find(game))
    before = code_digest(run)
    for module, changes in {
        "astray.record": True,  # where NEVER is
        "astray.kernel.rng": True,
        games.find(game).rules.__name__: True,
        f"astray.games.{game}.measures": False,
        f"astray.games.{'keys' if game == 'maze' else 'maze'}.rules": False,
        "astray.play": False,
    }.items():
        with monkeypatch.context() as context:
            edit(context, module)
            assert (code_digest(run) != before) == changes, module


def test_imports_within_functions_count_without_being_imported(tmp_path, monkeypatch):
    (tmp_path / "pack").mkdir()
    (tmp_path / "pack" / "__init__.py").write_text("raise RuntimeError('imported')\n")
    (tmp_path / "pack" / "deep.py").write_text("ONE = 1\n")
    (tmp_path / "lazy_one.py").write_text("def one():\n    from pack.deep import ONE\n")
    monkeypatch.syspath_prepend(tmp_path)
    one = importlib.import_module("lazy_one").one
    assert set(provenance.sources(one) or {}) == {"lazy_one", "pack.deep"}


def test_modules_that_a_star_brings_count(tmp_path, monkeypatch):
    (tmp_path / "sky").mkdir()
    (tmp_path / "sky" / "__init__.py").write_text("__all__ = ['star', 'MOON']\nMOON = 1\n")
    (tmp_path / "sky" / "star.py").write_text("LIGHT = 1\n")
    (tmp_path / "gazes.py").write_text("from sky import *\ndef one():\n    return star.LIGHT\n")
    monkeypatch.syspath_prepend(tmp_path)
    one = importlib.import_module("gazes").one
    assert set(provenance.sources(one) or {}) == {"gazes", "sky", "sky.star"}


def test_a_package_of_an_imported_module_and_a_module_named_as_pythons_count(tmp_path, monkeypatch):
    (tmp_path / "pack_of_one").mkdir()
    for name, text in {
        "pack_of_one/__init__": "GRAVITY = 1\n",
        "pack_of_one/one": "",
        "antigravity": "SPEED = 1\n",
        "asks_both": "def one():\n    import antigravity, pack_of_one.one, json\n",
    }.items():
        (tmp_path / f"{name}.py").write_text(text)
    monkeypatch.syspath_prepend(tmp_path)
    one = importlib.import_module("asks_both").one
    found = set(provenance.sources(one) or {})
    assert found == {"asks_both", "antigravity", "pack_of_one", "pack_of_one.one"}


def test_a_package_that_is_installed_is_followed_and_what_it_imports_is_read(tmp_path, monkeypatch):
    there = tmp_path / "site-packages"
    for package, text in {
        "guest_game": "from guest_game import numbers\nimport a_library\n\ndef one(): pass\n",
        "guest_game/numbers": "",
        "a_library": "import of_a_library",
        "of_a_library": "",
    }.items():
        (there / package).mkdir(parents=True)
        (there / package / "__init__.py").write_text(text)
    monkeypatch.syspath_prepend(there)
    one = importlib.import_module("guest_game").one
    found = provenance.sources(one, np.zeros(1).view(np.recarray)) or {}
    assert {"guest_game", "guest_game.numbers", "a_library"} == {
        n for n in found if "numpy" not in n
    }
    assert len(found) == 4


def test_sources_are_read_out_of_an_archive(tmp_path, monkeypatch):
    with zipfile.ZipFile(tmp_path / "all.zip", "w") as archive:
        archive.writestr("zipped_one.py", "import zipped_two\n\ndef one():\n    pass\n")
        archive.writestr("zipped_two.py", "")
    monkeypatch.syspath_prepend(tmp_path / "all.zip")
    one = importlib.import_module("zipped_one").one
    assert set(provenance.sources(one) or {}) == {"zipped_one", "zipped_two"}


def test_where_a_source_cannot_be_read_there_is_no_digest():
    there = {"__name__": "typed_in"}
    exec("def one(): pass", there)
    assert provenance.digest(there["one"]) is None


def test_what_a_game_works_out_when_asked_does_not_count():
    game = games.find("lavaland")
    world = game.cells.free.args[0]
    vars(world).pop("is_free", None)
    before = provenance.digest(game)
    assert world.is_free.any() and "is_free" in vars(world)
    assert provenance.digest(game) == before


def test_data_count():
    assert provenance.digest(data=[1]) == provenance.digest(data=[1])
    assert provenance.digest(data=[1]) != provenance.digest(data=[2])


READ = "B = json.loads((pathlib.Path(__file__).parent / 'read.json').read_text())\n"
CARRIED = {
    "module": "import reads\ndef far(s): return reads.B\n",
    "class": f"class C:\n    {READ}def far(s): return C.B\n",
    "enum": f"class C(enum.Enum):\n    {READ}def far(s): return C.B.value\n",
    "base class": f"class A:\n    {READ}class C(A): pass\ndef far(s): return C.B\n",
    "record": f"{READ}@dataclass\nclass C:\n    b: float\nC, B = C(B), 0\ndef far(s): return C.b\n",
    "instance": f"{READ}class C: pass\nC, C.b = C(), B\ndel B\ndef far(s): return C.b\n",
    "shown oddly": f"{READ}class C:\n    def __repr__(self): return 'C'\n"
    "    def __call__(self, s): return self.b\nfar = C()\nfar.b = B\ndel B\n",
    "slots": f"{READ}class C:\n    __slots__ = 'b'\n    def __call__(self, s): return self.b\n"
    "far = C()\nfar.b = B\ndel B\n",
    "helper": "from reads import B, less\ndel B\ndef far(s): return less()\n",
    "call": f"{READ}class C:\n    def __call__(self, s): return B\nfar = C()\n",
    "method": f"{READ}class C:\n    def go(self, s): return B\ndef far(s): return C().go(s)\n",
    "property": f"{READ}class C:\n    @property\n    def b(self): return B\n"
    "def far(s): return C().b\n",
    "cache": f"{READ}@functools.cache\ndef b(): return B\ndef far(s): return b()\n",
    "partial": f"{READ}go = functools.partial(max, B)\ndel B\ndef far(s): return go(0)\n",
    "list": f"{READ}FAR = [lambda b=B: b]\ndel B\ndef far(s): return FAR[0]()\n",
    "attribute": f"{READ}def far(s): return far.b\nfar.b = B\ndel B\n",
    "tensor": f"{READ}T = torch.tensor(B)\ndel B\ndef far(s): return T.item()\n",
    "bfloat16": f"{READ}T = torch.tensor(B, dtype=torch.bfloat16)\ndel B\n"
    "def far(s): return T.item()\n",
    "table": f"{READ}T = polars.DataFrame({{'b': [B], 'c': 'c'}})\ndel B\n"
    "def far(s): return T['b'][0]\n",
    "settings": f"{READ}C = astray.Config('maze', 'corner', learning_rate=B)\ndel B\n"
    "def far(s): return C.learning_rate\n",
    "deque": f"{READ}D = collections.deque([{{'b': B}}])\ndel B\ndef far(s): return D[0]['b']\n",
    "deque of arrays": f"{READ}D = collections.deque([numpy.full(5000, B)])\n"
    "D[0][:9] = D[0][-9:] = 9\ndel B\ndef far(s): return D[0][2500]\n",
    "proxy": f"{READ}P = types.MappingProxyType({{'b': [B]}})\ndel B\n"
    "def far(s): return P['b'][0]\n",
    "long namespace": f"{READ}N = types.SimpleNamespace(b=numpy.full(5000, B))\n"
    "N.b[:9] = N.b[-9:] = 9\ndel B\ndef far(s): return N.b[2500]\n",
    "number": f"{READ}D = fractions.Fraction(B)\ndel B\ndef far(s): return float(D)\n",
}


@pytest.mark.parametrize("how", CARRIED)
def test_what_a_module_reads_counts_however_a_function_names_it(how, tmp_path, monkeypatch):
    names = "astray, collections, enum, fractions, functools, json, numpy, pathlib, polars, torch"
    head = f"import {names}, types\nfrom dataclasses import dataclass\n"
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    (tmp_path / "names.py").write_text(head + CARRIED[how])
    (tmp_path / "reads.py").write_text(f"{head}{READ}def less(): return B\n")
    found = []
    for read in (0.5, 0.5, 0.25):
        (tmp_path / "read.json").write_text(str(read))
        for name in ("names", "reads"):
            monkeypatch.delitem(sys.modules, name, raising=False)
        far = importlib.import_module("names").far
        assert far(0) == read
        found.append([*provenance.values({"far": far})])
    assert found[0] == found[1] != found[2]


ENV = """import gymnasium

class Own(gymnasium.Env):
    steps = 0

    def step(self, action):
        self.steps += 1

env = Own()

def train(seed):
    env.step(seed)
"""


def test_what_an_environment_remembers_is_no_value_of_a_function(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "remembers.py").write_text(ENV)
    module = importlib.import_module("remembers")
    before = [*provenance.values(module.train)]
    module.train(1)
    assert module.env.steps == 1 and [*provenance.values(module.train)] == before


def test_a_function_counts_with_the_module_of_what_stands_before_it(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "before.py").write_text(
        "import functools\n\ndef twice(f):\n"
        "    @functools.wraps(f)\n    def g(s):\n        return 2 * f(s)\n    return g\n"
    )
    (tmp_path / "after.py").write_text("def far(s):\n    return s\n")
    twice, far = (importlib.import_module(n) for n in ("before", "after"))
    assert {*(provenance.sources(twice.twice(far.far)) or ())} == {"before", "after"}


ELSEWHERE = {
    "closed over": "from before import *\nfrom far import far\nput = closing(far)\n",
    "registered": "from before import *\nfrom far import far\nMADE['far'] = far\nput = made\n",
    "by a name": "import importlib\nF = importlib.import_module('far')\n"
    "def put(s): return F.far(s)\n",
    "by a kind": "from types import FunctionType\nfrom far import far\n"
    "def put(s): return far(s) if isinstance(far, FunctionType) else None\n",
    "by a path": "from importlib.util import module_from_spec, spec_from_file_location\n"
    "SPEC = spec_from_file_location('of_path', __file__.replace('after', 'far'))\n"
    "F = module_from_spec(SPEC)\nSPEC.loader.exec_module(F)\ndef put(s): return F.far(s)\n",
}


@pytest.mark.parametrize("how", ELSEWHERE)
def test_a_function_counts_with_the_modules_of_what_it_keeps(how, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "before.py").write_text(
        "MADE = {}\ndef made(s): return MADE['far'](s)\n"
        "def closing(f):\n    def g(s): return f(s)\n    return g\n"
    )
    (tmp_path / "far.py").write_text("def far(s): return s\n")
    (tmp_path / "after.py").write_text(ELSEWHERE[how])
    for name in ("before", "far", "after"):
        monkeypatch.delitem(sys.modules, name, raising=False)
    put = importlib.import_module("after").put
    assert put(1) == 1 and {*(provenance.sources(put) or ())} & {"far", "of_path"}
