"""Compiled code is of the functions that it is asked for, as they are."""

import ctypes
import functools
import importlib
import json
import os
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numba
import pytest

import astray
from astray.envs import loops
from astray.envs.compiled import loop_of
from astray.games import maze
from astray.games.coinrun import rules as others
from astray.kernel.jit import code_digest, entry, one_at_a_time, specialise
from astray.kernel.stored import Stored
from helpers import lava
from helpers.processes import begin, environment

ROOM = Path(__file__).parents[2] / "examples/open-room/src"
FUNCTIONS = """
from PIL import Image  # whose modules are not all of Python

def step_one(s): return 1
def step_two(s): return 2
same, also = (lambda s: s), (lambda s: s)
def made(reward):
    def step(s): return reward
    return step
"""


def ran(program, *words, **changes):
    """Return the words that a program prints, run from its file in a process of its own."""
    run = f"import runpy; runpy.run_path({os.fspath(program)!r})"
    code, out, err = begin(run, program.parent, *words, env=environment(**changes)).ended()
    assert code == 0, err
    return out.split()


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "of_functions.py").write_text(FUNCTIONS)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("of_functions")
    del sys.modules["of_functions"]


def digest_with(step, **names):
    """The digest of a loop in which `step` is bound."""
    return code_digest(specialise(loops.run, "", lambda clone: clone, step=step, **names))


def test_two_functions_of_a_module_are_two(module):
    assert digest_with(module.step_one) == digest_with(module.step_one)
    found = {
        digest_with(module.step_one),
        digest_with(module.step_two),
        digest_with(module.step_one, draw=module.step_one),
        digest_with(module.step_one, ACTIONS=9),
        digest_with(maze.GAME.rules.step),
        digest_with(others.step),
    }
    assert len(found) == 6 and None not in found


def test_code_that_another_function_made_has_what_it_was_made_of_in_its_digest(module):
    one, same, other = (digest_with(module.made(amount)) for amount in (1, 1, 2))
    assert one == same != other


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_types_that_are_declared_are_in_the_digest(module):
    plain, narrow = (numba.njit(locals=x)(module.step_one) for x in ({}, {"x": numba.int8}))
    assert code_digest(plain) != code_digest(narrow) and digest_with(plain) != digest_with(narrow)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_only_its_own_values_keep_code_from_files(module):
    assert not isinstance(entry(module.made(1))._cache, Stored)
    assert isinstance(specialise(loops.run, "", step=module.made(1))._cache, Stored)


def test_an_edit_is_another_digest_once_it_is_loaded(module, tmp_path):
    before = digest_with(module.step_one)
    (tmp_path / "of_functions.py").write_text(FUNCTIONS + "# edited\n")
    assert digest_with(module.step_one) == before
    importlib.reload(module)
    assert digest_with(module.step_one) != before


@pytest.mark.parametrize("edit", [("return 1000", "return 3000"), ("s.cells", "s.floor")])
def test_code_from_before_an_edit_is_not_taken_for_what_the_file_says_by_now(
    edit, tmp_path, monkeypatch
):
    file = tmp_path / "of_edits.py"
    file.write_text("def step(s):\n    if s.cells: return 1000\n    return 2\n")
    monkeypatch.syspath_prepend(tmp_path)
    before = importlib.import_module("of_edits").step
    file.write_text(file.read_text().replace(*edit) + "# and longer, so that Python sees it\n")
    del sys.modules["of_edits"]
    after = importlib.import_module("of_edits").step
    del sys.modules["of_edits"]
    assert before.__code__.co_code == after.__code__.co_code
    assert digest_with(before) != digest_with(after)


NEVER = """
from astray.kernel.jit import entry
from astray.record import NEVER

@entry
def never():
    return NEVER

print(never(), sum(never.stats.cache_hits.values()))
"""


@pytest.mark.thorough  # the next test changes a value that a module reads
@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_compiled_code_is_new_after_an_edit_of_a_constant_that_it_imports(tmp_path):
    package, program = tmp_path / "astray", tmp_path / "program.py"
    leave = shutil.ignore_patterns("__pycache__", "pretrained", "page", "art", "tests")
    shutil.copytree(Path(astray.__file__).parent, package, ignore=leave)
    shutil.copytree(Path(astray.__file__).parent / "art", package / "art")
    program.write_text(NEVER)
    known = environment(NUMBA_CACHE_DIR=str(tmp_path / "cache")) | {"PYTHONPATH": str(tmp_path)}
    told = []
    for edit in ("", "", "NEVER = -2\n"):
        with open(package / "record.py", "a") as file:
            file.write(edit)
        done = subprocess.run([sys.executable, program], env=known, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        told.append(done.stdout.split())
    assert told == [["-1", "0"], ["-1", "1"], ["-2", "0"]]


READ = """
import json, sys
import numpy as np
from astray.kernel import jit

READ = json.load(open(sys.argv[1]))
SPEED, PLACES = READ["speed"], (np.array(READ["places"]), 7)

@jit.kernel
def moved(x):
    return x + SPEED

@jit.entry
def go(x):
    return moved(x) + PLACES[0][1]

print(go(1), sum(go.stats.cache_hits.values()))
"""


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_compiled_code_is_new_after_an_edit_of_a_kernel_further_down_in_its_file(tmp_path):
    program, told = tmp_path / "program.py", []
    for more in (1, 1, 5):
        program.write_text(f"""
from astray.kernel.jit import entry, kernel
@entry
def go(x): return moved(x)
@kernel
def moved(x): return x + {more}
print(go(1), sum(go.stats.cache_hits.values()))
""")
        told.append(ran(program, NUMBA_CACHE_DIR=str(tmp_path / "cache")))
    assert told == [["2", "0"], ["2", "1"], ["6", "0"]]


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_compiled_code_is_new_after_a_change_of_a_value_that_a_module_reads(tmp_path):
    program, values, told = tmp_path / "program.py", tmp_path / "values.json", []
    program.write_text(READ)
    for speed, place in ((1, 10), (2, 20)):
        values.write_text(json.dumps({"speed": speed, "places": [0, place]}))
        told.append(ran(program, values, NUMBA_CACHE_DIR=str(tmp_path / "cache")))
    assert told == [["12", "0"], ["23", "0"]]  # the next but one counts a hit


COMPILED = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
CHOSEN = """
import enum, importlib, json, types
from pathlib import Path
import numba, numba.experimental
import numpy as np
from astray.kernel.jit import entry, kernel

CHOICE = json.loads(Path("choice.json").read_text())
PLACES = np.array([0, CHOICE["speed"]]), 7
SPEED, KIND, ROUND = CHOICE["speed"], np.dtype(CHOICE["kind"]), getattr(np, CHOICE["kind"])
OUTER = types.ModuleType("outer")
OUTER.inner = types.ModuleType("inner")
OUTER.inner.SPEED = SPEED
RATES = enum.Enum("RATES", {"LOW": 0, "TOP": SPEED})
TOP_RATE = RATES.TOP

@kernel
def left(x): return x - 1
@kernel
def right(x): return x + 1
WAY = {"left": left, "right": right}[CHOICE["way"]]
WAYS = (left, right) if CHOICE["way"] == "left" else (right, left)
PART, OTHER = slice(SPEED), importlib.import_module("other")
@numba.vectorize
def each(x): return SPEED * x
@numba.extending.register_jitable
def plainly(x): return SPEED * x
def stub(x): raise NotImplementedError
@numba.extending.overload(stub)
def overloaded(x): return lambda x: SPEED * x
TABLE, LISTED = {"speed": SPEED}, [SPEED]
class Kept: speed = SPEED
def of_table(x): raise NotImplementedError
@numba.extending.overload(of_table)
def _of_table(x):
    by = TABLE["speed"]
    return lambda x: by * x
def of_list(x): raise NotImplementedError
@numba.extending.overload(of_list)
def _of_list(x):
    by = LISTED[0]
    return lambda x: by * x
def of_class(x): raise NotImplementedError
@numba.extending.overload(of_class)
def _of_class(x):
    by = Kept.speed
    return lambda x: by * x
@numba.extending.intrinsic
def within(context, x):
    return x(x), lambda c, builder, s, args: builder.mul(args[0], args[0].type(SPEED))
@numba.experimental.jitclass([("base", numba.int64)])
class Car:
    def __init__(self, base): self.base = base
    def run(self, x): return SPEED * x
@numba.experimental.jitclass([("base", numba.int64)])
class Fixed:
    def __init__(self, base): self.base = base
    @staticmethod
    def fixed(x): return SPEED * x
@numba.experimental.jitclass([("base", numba.int64)])
class Top:
    def __init__(self, base): self.base = base
    @property
    def top(self): return SPEED
@numba.experimental.jitclass([("base", getattr(numba, CHOICE["kind"]))])
class Still:
    def __init__(self, base): self.base = base

FLAGS = {"contract", "nsz", *(("arcp",) if SPEED > 1 else ("ninf",))}
@numba.njit(locals={"y": getattr(numba, CHOICE["kind"])})
def given(x):
    y = x
    return y
@numba.njit(fastmath=FLAGS)
def roughly(x): return x / 3
@numba.njit(f"{CHOICE['kind']}({CHOICE['kind']})")
def converted(x): return x
@numba.vectorize([f"{CHOICE['kind']}({CHOICE['kind']})"])
def each_converted(x): return x

def faster(by):
    @kernel
    def fast(x): return by * x
    return fast
FAST = faster(SPEED)

@kernel
def by_default(x, speed=SPEED): return speed * x

@entry
def default(x): return by_default(x)
@entry
def number(x): return SPEED * x
@entry
def places(x): return PLACES[0][1] * x
@entry
def function(x): return WAY(x)
@entry
def closure(x): return FAST(x)
@entry
def module(x): return OUTER.inner.SPEED * x
@entry
def dtype(x): return np.full(1, x, KIND)
@entry
def kind(x): return ROUND(x)
@entry
def names(x): return RATES.TOP.value * x
@entry
def member(x): return TOP_RATE.value * x
@entry
def one_of_two(x): return WAYS[0](x)
@entry
def part(x): return np.arange(x)[PART].sum()
@entry
def vectorized(x): return each(x)
@entry
def inlined(x): return plainly(x)
@entry
def by_name(x): return OTHER.often(x)
@entry
def stubbed(x): return stub(x)
@entry
def tables(x): return of_table(x)
@entry
def lists(x): return of_list(x)
@entry
def classes(x): return of_class(x)
@entry
def intrinsics(x): return within(x)
@entry
def cars(x): return Car(x).run(x)
@entry
def fixes(x): return Fixed.fixed(x)
@entry
def tops(x): return Top(x).top
@entry
def stills(x): return Still(x).base
@entry
def local(x): return given(x)
@entry
def rough(x): return roughly(x)
@entry
def conversion(x): return converted(x)
@entry
def conversions(x): return each_converted(x)
"""

OTHER = """
from astray.kernel.jit import kernel
@kernel
def often(x): return sum([{} * x for _ in range(2)])
"""


KEPT = {
    "default": {"speed": 2},
    "number": {"speed": 2},
    "places": {"speed": 2},
    "function": {"way": "left"},
    "closure": {"speed": 2},
    "module": {"speed": 2},
    "dtype": {"kind": "float32"},
    "kind": {"kind": "float32"},
    "names": {"speed": 2},
    "member": {"speed": 2},
    "one_of_two": {"way": "left"},
    "part": {"speed": 2},
    "vectorized": {"speed": 2},
    "inlined": {"speed": 2},
    "by_name": {"inner": 2},
    "stubbed": {"speed": 2},
    "tables": {"speed": 2},
    "lists": {"speed": 2},
    "classes": {"speed": 2},
    "intrinsics": {"speed": 2},
    "cars": {"speed": 2},
    "fixes": {"speed": 2},
    "tops": {"speed": 2},
    "stills": {"kind": "float32"},
    "local": {"kind": "float32"},
    "rough": {"speed": 2},
    "conversion": {"kind": "float32"},
    "conversions": {"kind": "float32"},
}
OF_COMPILED = {"cars", "fixes", "tops", "stills", "local", "rough", "conversion", "conversions"}


@pytest.fixture(scope="module")
def digests(tmp_path_factory):
    """Function: imports the module anew with other choices; the digests of all its functions."""
    folder = tmp_path_factory.mktemp("chosen")
    usual = {"speed": 1, "way": "right", "kind": "float64", "inner": 1}

    @functools.cache
    def found(time, **changed):
        choice = usual | changed
        (folder / "chosen.py").write_text(CHOSEN)
        (folder / "choice.json").write_text(json.dumps(choice))
        (folder / "other.py").write_text(OTHER.format(choice["inner"]))
        with pytest.MonkeyPatch.context() as patched:
            patched.chdir(folder)
            patched.syspath_prepend(folder)
            chosen = importlib.import_module("chosen")
            told = {of: code_digest(getattr(chosen, of)) for of in KEPT}
            del sys.modules["chosen"], sys.modules["other"]
        return told

    return found


@pytest.mark.parametrize(
    "of", [pytest.param(of, marks=COMPILED if of in OF_COMPILED else ()) for of in KEPT]
)
def test_what_compiled_code_keeps_is_in_its_digest(of, digests):
    choices = ({"time": 1}, {"time": 2}, {"time": 1, "unused": 1}, {"time": 1} | KEPT[of])
    *same, other = (digests(**choice)[of] for choice in choices)
    assert same == same[:1] * 3 and other != same[0] and None not in (*same, other)


OVERLOADED = """
import operator, sys
import numba, numba.extending
import numpy as np
from astray.kernel.jit import code_digest, entry

SPEED = int(sys.argv[1])
@numba.extending.overload(np.setxor1d)
def of_numpy(x, y): return lambda x, y: SPEED * x
@numba.extending.overload(oct)
def of_python(x): return lambda x: SPEED * x
@numba.extending.overload_method(numba.types.Integer, "sped")
def method(x): return lambda x: SPEED * x
@numba.extending.overload_attribute(numba.types.Integer, "top")
def attribute(x): return lambda x: SPEED * x
class Pair(numba.types.StructRef): pass
@numba.extending.overload(operator.add)
def summed(a, b):
    if isinstance(a, Pair): return lambda a, b: SPEED
@entry
def numpys(x): return np.setxor1d(x, x)
@entry
def builtins(x): return oct(x)
@entry
def methods(x): return x.sped()
@entry
def attributes(x): return x.top
@entry
def sums(x): return x + x
print(*map(code_digest, (numpys, builtins, methods, attributes, sums)))
"""


@COMPILED
def test_what_is_overloaded_for_all_code_is_in_its_digest(tmp_path):
    (tmp_path / "program.py").write_text(OVERLOADED)  # each alone: a process keeps overloads
    told = [ran(tmp_path / "program.py", speed) for speed in "112"]
    assert told[0] == told[1]
    assert all(one != other != "None" for one, other in zip(told[1], told[2], strict=True))


DISTANCES = """
from pathlib import Path
import numpy as np
import astray
from astray.kernel.grid import distances

distances(np.ones((1, 1), bool), 0, 0)
print(Path(astray.__file__).parents[1], sum(distances.stats.cache_hits.values()))
"""


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_another_installation_of_the_same_code_does_not_compile_it_again(tmp_path):
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "astray").symlink_to(Path(astray.__file__).parent)
    program, known = tmp_path / "program.py", {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    program.write_text(DISTANCES)
    folders = (Path(astray.__file__).parents[1], tmp_path / "elsewhere")
    told = [ran(program, PYTHONPATH=str(folder), **known) for folder in folders]
    assert told == [[str(folders[0]), "0"], [str(folders[1]), "1"]]


PAID = """
import sys
from dataclasses import replace
from types import SimpleNamespace
import numpy as np
from astray.envs.vector import GameVectorEnv
from astray.kernel.jit import kernel
from open_room.game import GAME

@kernel
def one(s, action):
    return 1.0, False

@kernel
def two(s, action):
    return 2.0, False

for step in sys.argv[1:]:
    rules = SimpleNamespace(**vars(GAME.rules) | {"step": globals()[step]})
    env = GameVectorEnv(replace(GAME, rules=rules), "corner", 1)
    env.reset(seed=0)
    print(env.step(np.array([0]))[1][0])
"""


@pytest.mark.thorough  # `test_two_functions_of_a_module_are_two` compares their digests
def test_games_that_differ_in_a_function_are_played_by_their_own(tmp_path):
    program = tmp_path / "paid.py"
    program.write_text(PAID)
    known = environment(NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    known["PYTHONPATH"] = os.pathsep.join([str(ROOM), known["PYTHONPATH"]])
    for words, paid in ((["one", "two"], ["1.0", "2.0"]), (["two", "one"], ["2.0", "1.0"])):
        done = subprocess.run(
            [sys.executable, program, *words], env=known, capture_output=True, text=True
        )
        assert done.returncode == 0, done.stderr
        assert done.stdout.split() == paid


CHANGED = """
from dataclasses import replace
from types import SimpleNamespace
import numba
import numpy as np
from astray.envs.vector import GameVectorEnv
from astray.kernel.jit import kernel
from open_room.game import GAME

PAID = 1.0

@numba.njit("float64()")
def paid():
    return PAID

@kernel
def extra(s):
    return 0.0

@kernel
def step(s, action):
    return paid() + extra(s), False

rules = SimpleNamespace(**vars(GAME.rules) | {"step": step})
mine = replace(GAME, rules=rules)

def pays(game):
    env = GameVectorEnv(game, "corner", 1)
    env.reset(seed=0)
    print(env.step(np.array([0]))[1][0])

pays(mine)
PAID = 2.0
pays(mine)
pays(replace(mine))

@kernel
def extra(s):
    return 5.0

pays(mine)
"""


@pytest.mark.thorough  # the next test asks for such a game's loop, and for what a kernel returns
def test_a_value_or_a_kernel_that_is_changed_after_it_was_compiled_is_compiled_again(tmp_path):
    """Also in the files, which a next process takes."""
    program = tmp_path / "changed.py"
    program.write_text(CHANGED)
    known = environment(NUMBA_CACHE_DIR=str(tmp_path / "cache"))
    known["PYTHONPATH"] = os.pathsep.join([str(ROOM), known["PYTHONPATH"]])
    for _ in range(2):
        done = subprocess.run([sys.executable, program], env=known, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr
        assert done.stdout.split() == ["1.0", "2.0", "2.0", "7.0"]


KEPT_BY_A_GAME = """
import numba
from astray.kernel.jit import kernel

PAID = 1.0

@numba.njit("float64()")
def paid(): return PAID

@kernel
def extra(s): return 0.0

@kernel
def step(s, action): return paid() + extra(s), False

@kernel
def five(s): return 5.0
"""


@COMPILED
def test_a_game_has_another_loop_once_a_value_or_a_kernel_that_it_keeps_is_changed(
    tmp_path, monkeypatch
):
    (tmp_path / "of_a_game.py").write_text(KEPT_BY_A_GAME)
    monkeypatch.syspath_prepend(tmp_path)
    kept = importlib.import_module("of_a_game")
    rules = SimpleNamespace(**vars(lava.GAME.rules) | {"step": kept.step})
    game, found, paid = replace(lava.GAME, rules=rules), [], []
    for changed in ({}, {}, {"PAID": 2.0}, {"extra": kept.five}):
        vars(kept).update(changed)
        found.append((loop_of(game), loop_of(replace(game))))
        paid.append(numba.njit(kept.step)(0, 0)[0])
    assert paid == [1.0, 1.0, 2.0, 7.0]
    assert found[0][0] is found[1][0]
    files = [{loop.__qualname__ for loop in both} for both in found]  # are named so
    assert files[0] == files[1] and [len({*files[k], *files[k + 1]}) for k in (1, 2)] == [2, 2]
    del sys.modules["of_a_game"]


IN_FILES = """
import numba
import of_constants

PAID = of_constants.PAID

@numba.njit(cache=True)
def paid():
    return PAID

@numba.njit("float64()", cache=True)
def declared():
    return 10 * paid()
"""
CALLED = """
import numba, of_kept
from astray.kernel.jit import renewed

@numba.njit
def step():
    return of_kept.paid() + of_kept.declared()

renewed([step])
print(step())
"""


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_code_that_numba_keeps_in_files_is_new_after_an_edit_of_what_it_imports(tmp_path):
    (tmp_path / "program.py").write_text(CALLED)
    (tmp_path / "of_kept.py").write_text(IN_FILES)
    told = []
    for paid in ("1.0", "2.25"):
        (tmp_path / "of_constants.py").write_text(f"PAID = {paid}\n")
        told += ran(
            tmp_path / "program.py",
            NUMBA_CACHE_DIR=str(tmp_path / "cache"),
            PYTHONPATH=f"{tmp_path}{os.pathsep}{Path(astray.__file__).parents[1]}",
        )
    assert told == ["11.0", "24.75"]


def test_an_interrupt_that_python_ignores_amid_llvm_ends_the_compiling():
    @ctypes.CFUNCTYPE(None)
    def called():  # by LLVM, once a module is compiled: an interrupt had to wait until then
        raise KeyboardInterrupt

    hook = sys.unraisablehook
    with pytest.raises(KeyboardInterrupt), one_at_a_time():
        called()
        raise RuntimeError("numba lacks what it was not told of")
    assert sys.unraisablehook is hook


def test_a_thread_that_compiles_leaves_the_hook_of_all_threads():
    def seen():
        with one_at_a_time("other"):
            return sys.unraisablehook

    with ThreadPoolExecutor(1) as pool:
        assert pool.submit(seen).result() is sys.unraisablehook
