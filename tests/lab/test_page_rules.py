"""The rules that a page plays by are Python's, compiled."""

import base64
import json
import runpy

import numba
import numpy as np
import pytest

from astray import games, grid
from astray.acting import initial_states
from astray.envs.vector import GameVectorEnv
from astray.insight.actions import effects
from astray.kernel.jit import kernel
from astray.lab import rules, wasm
from astray.lab.worlds import snapshot
from astray.level import Level
from helpers.browsed import PLAY, knobs, modules_of

STEPS = 80  # of each episode at random, each three times
PLAYED = [
    ("maze", "anywhere-small"), ("maze", "red-line-yellow-gem"), ("maze", "anywhere-memory"),
    ("maze", "dish-small"), ("maze", "dish-apart-small"),
    ("keys", "many-keys-small"), ("keys", "many-chests"), ("keys", "many-keys-penalties"),
    ("coinrun", "coin-anywhere"), ("coinrun", "coin-end-permeable-continue"), ("heist", "near"),
]  # fmt: skip
WORLDS = [
    ("pottery", "anywhere-picks"), ("monsters", "long"), ("follow", "anti-expert"),
    ("trees", "season"), ("lavaland", "lava"), ("bridge", "up"), ("supervisor", "half"),
    ("box", "boxes"), ("tomatoes", "bucket"), ("boat", "race"),
]  # fmt: skip


@pytest.mark.parametrize("name, kind", PLAYED)
def test_rules_are_those_of_python_state_by_state(page, name, kind):
    random = np.random.default_rng(3)
    # runs of one action, as players make them, mostly to the right
    often = [*[0.03] * 6, 0.1, 0.3, 0.3, *[0.02] * 6]
    episodes = [np.repeat(random.choice(15, STEPS, p=often), 3) for _ in range(4)]
    compare(page, name, kind, episodes)


def test_keys_open_doors_as_in_python(page):
    game, episodes = games.find("heist"), []
    env = GameVectorEnv("heist", "small", 1, observation="symbolic", autoreset_mode="Disabled")
    for level in range(3):
        env.reset(seed=0, options={"level": level})
        if level == 0:  # what would be done with the keys in hand, which a locked door ends
            states = env.get_state()
            states["hand"] = states["keys"]
            env.set_state(states)
        expert, actions = game.solver.expert(env.states[0], "gem"), []
        while not env.states[0].ended:
            actions.append(expert(env.states[0]))
            env.step(np.array(actions[-1:]))
        episodes.append(np.array(actions))
    assert env.states[0].opened_blue > 0
    compare(page, "heist", "small", episodes)


@pytest.mark.parametrize("name, kind", WORLDS)
def test_rules_that_are_compiled_are_those_of_python_state_by_state(page, exported, name, kind):
    game, random = games.find(name), np.random.default_rng(3)
    write_rules(exported, game)
    compare(page, name, kind, random.integers(len(game.actions), size=(2, STEPS)))


def write_rules(exported, game):
    path = exported / rules.path(game)
    path.parent.mkdir(exist_ok=True)
    path.write_text(rules.module(game))


def compare(page, name, kind, episodes):
    game = games.find(name)
    variant = game.variant(kind)
    env = GameVectorEnv(name, kind, 1, observation="symbolic", autoreset_mode="Disabled")
    for number, actions in enumerate(episodes):
        env.reset(seed=0, options={"level": number})
        level = Level.of(game, variant, env.get_state()[0])
        given = [rules.entry(game), level.to_json(), knobs(variant), actions.tolist()]
        told = json.loads(page.evaluate(PLAY, given))
        seen, _ = env.reset(options={"state": level.state(solvable=False)})
        reward = 0.0
        for t, (state, planes, there_reward, ended) in enumerate(told):
            expected = snapshot(game, env.get_state().view(np.recarray)[0])
            assert state == expected, (number, t)
            assert base64.b64decode(planes) == seen.tobytes(), (number, t)
            assert there_reward == reward and ended == expected["ended"]
            if t < len(told) - 1:
                seen, rewards, _, _, _ = env.step(actions[t : t + 1])
                reward = float(rewards[0])
        assert ended or len(told) == len(actions) + 1


@pytest.mark.parametrize("name, kind", [PLAYED[0], PLAYED[5], PLAYED[10]])
def test_a_level_without_looks_has_the_floor_of_its_variant(page, name, kind):
    game = games.find(name)
    variant = game.variant(kind).with_knobs({"background": 4})
    level = Level.of(game, variant, initial_states(game, variant, [1])[0])
    bare = Level.from_text(game, variant, str(level))
    told = page.evaluate(
        """async ([path, { looks, ...level }, variant]) => {
          const { rules } = await import(new URL(path, location.href));
          const s = rules.build(level, variant);
          return [s.background, s.background_offset];
        }""",
        [rules.entry(game), bare.to_json(), knobs(variant)],
    )
    s = bare.state(solvable=False)
    assert told == [s.background, s.background_offset] == [4, 0]


EFFECTS = """async ([path, level, variant, actions, count]) => {
  const { rules } = await import(new URL(path, location.href));
  const { effects, played } = await import(new URL("engine/episodes.js", location.href));
  const { states } = played({ s: rules.build(level, variant), rules }, actions);
  return states.filter((s) => !s.ended).map((s) => effects(rules, s, count));
}"""


@pytest.mark.parametrize("name, kind", [*PLAYED[::5], PLAYED[6], *WORLDS[1:4:2]])
def test_actions_that_do_the_same_are_those_of_python(page, exported, name, kind):
    game, random = games.find(name), np.random.default_rng(5)
    variant, count = game.variant(kind), len(game.actions)
    write_rules(exported, game)
    env = GameVectorEnv(game, kind, 1, observation="symbolic", autoreset_mode="Disabled")
    env.reset(seed=0, options={"level": 3})
    level = Level.of(game, variant, env.get_state()[0])
    env.reset(options={"state": level.state(solvable=False)})
    states, actions = [env.get_state()], []
    while len(actions) < 40 and not env.states["ended"][0]:
        actions += [int(random.integers(count))] * 2
        for action in actions[-2:]:
            env.step(np.array([action]))
            states.append(env.get_state())
            if env.states["ended"][0]:
                del actions[len(states) - 1 :], states[-1]
                break
    told = page.evaluate(
        EFFECTS, [rules.entry(game), level.to_json(), knobs(variant), actions, count]
    )
    assert told[: len(states)] == effects(game, variant, np.concatenate(states)).tolist()


def test_an_action_after_which_chance_decides_otherwise_does_something_else(page):
    told = page.evaluate(
        """async () => {
          const { effects } = await import(new URL("engine/episodes.js", location.href));
          const step = (s, action) => { if (action) s.mt_next += 1; return [0, false]; };
          const copy = (s) => ({ ...s });
          const wide = (s, action) => { s.w += BigInt(action % 3); return [0, false]; };
          const s = { time: 0, time_limit: 9, mt_next: 5, w: 2n ** 60n };
          return [effects({ copy, step }, s, 3), effects({ copy, step: wide }, s, 5)];
        }"""
    )
    assert told == [[0, 1, 1], [0, 1, 2, 0, 1]]


KERNELS = """\
import ctypes
import math
from enum import IntEnum

import numba
import numpy as np

from astray.kernel.jit import kernel

TABLE = (4, 5)
GRID = np.arange(12).reshape(4, 3)
COLUMN, TURNED, ACROSS = GRID[:, 1], GRID[::-1], GRID.T
BIG = 1, 2**60
LARGE = np.random.default_rng(0).integers(256, size=1_050_000).astype(np.uint8)
CALLED = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_double)(abs)
REALS, REAL = np.array([0.1, 0.7], np.float32), (np.float32(0.1), 3)

class Kind(IntEnum):
    WALL = 5

@kernel
def catch(s):
    s.n += 1
    return 1

@kernel
def usual(s, n=3):
    return n

@kernel
def pair(s):
    return s.a, s.a

@kernel
def put(rows, what):
    rows[1] = what

@kernel
def swap(x, y):
    return y, x

@kernel
def third(x):
    return x / np.float32(3)

@numba.njit(locals={"y": numba.int8})
def narrow(x):
    y = x + 1
    return y

@numba.njit("uint8(int64)")
def low(x):
    return x

@numba.njit(["float32(float32)", "int64(int64)"])
def square(x):
    return x * x

@numba.njit
def down(n):
    if n > 0:
        return down(n - 1)
    return 0

"""
FIELDS = np.dtype(
    [("a", int), ("n", int), ("t", bool), ("u", np.uint8), ("i", np.int16), ("row", np.uint8, 3),
     ("b", int, 3), ("f", np.float32), ("c", np.float32, 3), ("w", np.uint64)]
)  # fmt: skip
AS_IN_PYTHON = [
    "for k in range(4):\n  s.a += k\n return k",  # the last one, after the loop
    "for k in range(6):\n  k += 2\n  s.a += k\n return s.a",
    "for k in range(5, -1, -2):\n  s.a = 10 * s.a + k\n return s.a",
    "for k in range(3):\n  s.a = k\n else:\n  s.a = 7\n return s.a",
    "for k in TABLE:\n  s.a += k\n return s.a",
    "for k in pair(s):\n  s.a += k + 1\n return s.a",
    "return pair(s)[s.a]",
    "x = np.full(9, 2)\n x[catch(s)] += 1\n return x[1] + 10 * s.n",  # which is called once
    "return (0 <= catch(s) < 4) + 10 * s.n",
    "return (1 << 40) | (5 & 4) | (2199023255552 >> 1)",
    "return s.a + 9007199254740993",
    "return BIG[s.a + 1]",
    "return COLUMN[s.a + 2] + 100 * TURNED[s.a, 2] + 10000 * ACROSS[2, s.a + 1]",
    "s.a = 3000000000\n return s.a * s.a",
    "x = 3\n for k in range(58):\n  x = x + x + 1\n return x",
    "s.w = np.uint64(1) << np.uint64(63)\n return s.w",
    "return ~s.a + s.b.size + 100 * s.b.sum()",
    "return math.sqrt(s.a + 2.0)",
    "return float(s.a) + np.int32(3) + usual(s) + (Kind.WALL == 5)",
    "typeof, static = 3, 4\n return typeof + static",
    "return np.float64(np.float32(0.1) + np.float32(0.2))",  # of 32 bits
    "return TABLE[-1] + 10 * TABLE[s.a - 2] + 100 * TABLE[-(s.a + 1)]",  # from the end
    "x = np.empty(3)\n x[:] = 0\n x[s.a - 1] = 7\n x[s.a - 2] += 5\n return x[2] + 9 * x[1]",
    "x = np.empty((2, 3))\n x[1:] = 4\n x += 1\n return x[1, 1]",
    "x = np.uint64(3) << np.uint64(62)\n return np.int64(x >> np.uint64(60))",
    "x = np.full((2, 3), 7)\n h, w = x.shape\n return x[1, 2] + h * w + 100 * x.shape[-1]",
    "s.a = 7 / 2\n s.a += 0.75\n return s.a",  # a field of integers
    "return ((s.a, 1) == (0, 1)) + 2 * ((s.a, 1) != (0, 1)) + 4 * ((s.a, 1) < (0, 2))",
    "return 3 if [1] and s.a == 0 and [1][1:] and 1 else 4",
    "return min(TABLE) + 10 * max(TABLE) + 100 * max(s.a, 2, 1)",
    "return (1.0 % 0.1) + 10 * (-0.7 % 0.2) + 100 * (5.5 % -2.0)",
    "return (1.0 // 0.1) + 100 * (-1.0 // 0.3) + 10000 * ((-7) // 2) + (7 % -3)",
    "s.t = s.a == 0\n return (s.t in (1, 2)) + 2 * ((s.t, 1) == (1, 1)) + 4 * (s.t in (0, 2))",
    "s.b[1:] = s.b[:2]\n s.row[:] = s.b\n return s.row[2] + 10 * s.b[2]",
    "x = [s.a, 4]\n x.append(5)\n return len(x) + 10 * x[-1]",
    "s.n = -s.b[0]\n return s.a, s.n < 0, 0.5",
]
AS_COMPILED = {  # of few bits, in which interpreted ones are refused or differ
    "s.u = 300\n s.i = 32767\n s.i += 2\n return s.u + 1000 * s.i": 44 - 32767000,
    "s.u -= 1\n s.row[1] = 257\n return s.u + 1000 * s.row[1]": 1255,
    "s.b[:] = s.a - 4\n return s.b[0] + 10 * s.b[2]": -44,
    "s.row[:] = 257\n s.b[:] = 2.9\n return s.row[0] + 10 * s.b[2]": 21,
    "put(s.row, 257)\n put(s.b, 2.9)\n return s.row[1] + 10 * s.b[1]": 21,
    "x, y = s.b, swap(s.row, 3)[1]\n x[0], y[0] = 2.9, 257\n return s.row[0] + 10 * s.b[0]": 21,
    "s.u = np.uint64(300)\n s.i = np.uint64(70000)\n return s.u + 1000 * s.i": 4464044,
    "s.u = 1\n return -s.u, s.row[0] - s.u": [255, 2**64 - 1],  # without a sign
    "return np.uint64(1) + s.b[0], np.uint64(7) / np.uint64(2)": [8.0, 3.5],
    "return 1 << (s.a + 62), max(np.uint64(7), np.uint64(2))": [2**62, 7],
    # what is no number
    "x = s.a + 1e308 * 10\n return (3 if x - x else 4) + bool(x - x)": 4,  # is true
    "x = s.a + 1e308 * 10\n return min(1.0, x - x), max(x - x, 2.0) != 2.0": [1.0, True],
    # of 32 bits
    "put(s.c, 0.1)\n return s.c[1]": 0.10000000149011612,
    "return s.c[0] * s.f": 0.030000001192092896,
    "x = np.full((1, 2), s.f)\n return x[0, 0] * x[0, 1]": 0.09000000357627869,
    "return (s.f + (s.a == 0)) * s.f": 0.39000001549720764,
    "s.u = 3\n return (s.f + s.u) * s.f": 0.9900000095367432,
    "s.u = 3\n return np.sqrt(s.u) + max(s.f, s.u) / s.f": 11.732050895690918,
    "s.u = 3\n return np.sign(s.u), (s.u or s.f) * s.f": [1, 0.9000000357627869],
    "s.u = 3\n x = s.u if s.a == 0 else s.f\n return x * s.f": 0.9000000357627869,
    "x, y = (s.f, s.a), swap(s.c[0], s.f)\n return x[0] * x[0] + y[0] * y[1]": 0.12000000476837158,
    "return REALS[0] * REALS[1] * third(s.f)": 0.007000000216066837,
    "return REAL[0] * s.f": 0.030000001192092896,
    "x = np.float32(s.a)\n x = s.a + 0.1\n return x": 0.1,
    # which wrap around
    "s.u = s.a + 200\n return max(0.5, 2**56 * s.u)": 0.5,
    # of declared types, to which numbers are converted
    "return low(s.a + 259), narrow(s.a + 2**62)": [3, 1],
    "return square(s.f), square(s.u + 3), square(s.i)": [0.09000000357627869, 9, 0],
}
ENDLESS = numba.njit(error_model="numpy")(lambda s: 1 / s.a)  # Python's model would raise
RUN = """async () => {
  const { asked } = await import(new URL("rules/asked.js", location.href));
  return Object.values(asked).map((ask) => {
    const [f, ...c] = [0.3, 0.1, 0.2, 0.7].map(Math.fround);
    const s = { a: 0, n: 0, t: false, u: 0, i: 0, row: [0, 0, 0], b: [7, 8, 9], f, c, w: 0 };
    const told = (x) => (Array.isArray(x) ? x.map(told) : typeof x === "bigint" ? `${x}` : x);
    try { return { returns: told(ask(s)), s: told(Object.values(s)) }; } catch (error) {
      return { returns: error.message };
    }
  });
}"""


@pytest.fixture(scope="module")
def asked(tmp_path_factory):
    """Function that makes kernels of bodies."""

    def make(*bodies):
        path = tmp_path_factory.mktemp("asked") / "kernels.py"
        kernels = (f"@kernel\ndef ask{k}(s):\n {body}\n" for k, body in enumerate(bodies))
        path.write_text(KERNELS + "\n".join(kernels))
        found = runpy.run_path(str(path))
        return [found[f"ask{k}"] for k in range(len(bodies))]

    return make


def compiled(*kernels):
    state = numba.from_dtype(FIELDS)
    return wasm.compiled({f"ask{k}": (kernel, (state,)) for k, kernel in enumerate(kernels)})


@pytest.fixture(scope="module")
def kernels(asked):
    """Kernels by their bodies."""
    bodies = [*AS_IN_PYTHON, *AS_COMPILED, *RAISES]
    return dict(zip(bodies, asked(*bodies), strict=True))


@pytest.fixture(scope="module")
def there(chrome, static, exported, kernels):
    """Results of kernels in a page, and the states after them, by their bodies."""
    made = f"export const asked = {compiled(*kernels.values(), ENDLESS)};"
    imported = 'import { kernels } from "./memory.js";'
    (exported / "rules" / "asked.js").write_text(f"{imported}\n{made}\n")
    with modules_of(chrome, static) as page:
        return dict(zip([*kernels, ENDLESS], page.evaluate(RUN), strict=True))


def plain(value):
    """A number as a page tells it: as text from 2 ** 53 on."""
    if isinstance(value, tuple | list | np.ndarray):
        return [*map(plain, value)]
    value = value.item() if isinstance(value, np.generic) else value
    return str(value) if isinstance(value, int) and abs(value) >= 2**53 else value


@pytest.mark.parametrize("body", AS_IN_PYTHON)
def test_a_kernel_does_in_a_page_what_it_does_in_python(there, kernels, body):
    s = np.zeros(1, FIELDS).view(np.recarray)[0]
    s.b, s.f, s.c = (7, 8, 9), 0.3, (0.1, 0.2, 0.7)
    assert there[body]["returns"] == plain(kernels[body](s))
    assert there[body]["s"] == [plain(s[name]) for name in FIELDS.names]


@pytest.mark.parametrize("body", AS_COMPILED)
def test_a_kernel_returns_in_a_page_what_compiled_code_does(there, body):
    assert there[body]["returns"] == plain(AS_COMPILED[body])


@pytest.mark.thorough  # the test before has these numbers
@pytest.mark.parametrize("body", AS_COMPILED)
def test_compiled_code_returns_what_is_said_here(kernels, body):
    s = np.zeros(1, FIELDS)
    s["b"], s["f"], s["c"] = (7, 8, 9), 0.3, (0.1, 0.2, 0.7)
    assert plain(numba.njit(kernels[body])(s[0])) == plain(AS_COMPILED[body])


def test_a_kernel_keeps_the_options_that_it_was_compiled_with(there):
    s = np.zeros(1, FIELDS)
    assert there[ENDLESS]["returns"] == ENDLESS(s[0]) == np.inf


RAISES = {
    "if s.a == 0:\n  raise ValueError('no key')\n return 1": "ValueError: no key",
    "return 1 // s.a": "ZeroDivisionError: integer division by zero",
    "raise ValueError('no key', s.b[0])": "ValueError",
    "s.b[:] = np.empty(s.a + 2)\n return 1": "ValueError: an array must be",
    # which machines convert to other numbers
    "s.u = s.a - 1.0\n return 1": "ValueError: a real number must be one that uint8 can hold",
    "return int(s.a + 1e308 * 10)": "ValueError: a real number must be one that int64 can hold",
    "s.row[:] = s.f * 1000\n return 1": "ValueError: a real number must be one that uint8 can hold",
    "x, y = np.empty(2**29), np.empty(3)\n x[4], y[0] = 5, 7\n return x[4]": "WebAssembly.Memory",
}


@pytest.mark.parametrize("body", RAISES)
def test_an_error_of_a_kernel_is_told_in_a_page(there, body):
    assert there[body]["returns"].startswith(RAISES[body])


def test_a_page_has_no_paths_of_its_author(asked):
    told = compiled(*asked(*RAISES))
    assert b"kernels.py" not in base64.b64decode(
        json.loads(told[len("await kernels(") :].split(",")[0])
    )


REFUSED = {
    "return math.sin(s.a)": "ask0: a page without Python has no sin",
    "return s.row": "must have real numbers from ask0, or a tuple of them; got nestedarray",
    "return 2j": "a page must have real numbers from ask0, .*; got complex128",
    "return down(s.a)": "ask0 must be compiled .* a page has no recursion",
    "return unheard": "ask0 must be compiled for a page without Python: .*'unheard'",
    "return len({s.a, 3})": "ask0: a page without Python has no NRT_MemInfo_varsize_alloc",
    "a, *b = TABLE\n return len(b)": "ask0 must be compiled for a page without Python: .*UNPACK_EX",
    "return CALLED(2.0)": "ask0 must be compiled .* of type .ExternalFunction",
    "return LARGE[s.a]": "rules of a page must be at most 1048576 bytes; got [0-9]{7}",
}


@pytest.mark.parametrize("body", REFUSED)
def test_what_a_page_does_not_have_is_refused_by_its_name(asked, body):
    with pytest.raises(ValueError, match=REFUSED[body]):
        compiled(*asked(body))


@pytest.mark.parametrize("flags", [True, {"reassoc"}])
def test_arithmetic_that_differs_between_machines_is_refused_by_its_name(flags):
    @numba.njit(fastmath=flags)
    def roughly(x):
        return x * 0.1 + 0.3

    @numba.njit(fastmath=False)
    def asks(s):
        return roughly(s.f)

    said = "ask0 must be compiled .*: roughly has fastmath, whose results differ between machines"
    with pytest.raises(ValueError, match=said):
        compiled(asks)


@pytest.mark.parametrize("kind", ["c8", "U4", "M8[s]", [("q", int)]])
def test_a_field_that_is_no_number_of_a_page_is_refused_by_its_name(asked, kind):
    state = numba.from_dtype(np.dtype([("z", kind), ("a", int)]))
    with pytest.raises(ValueError, match="must have real numbers in the field 'z'; got"):
        wasm.compiled({"ask": (asked("return 1")[0], (state,))})


def adds(amount):
    @kernel
    def add(s):
        s.a += amount

    return add


def test_compiled_kernels_are_kept_until_their_code_or_the_file_is_another(monkeypatch, tmp_path):
    make, made = wasm._compiled, []
    monkeypatch.setattr(wasm, "code_folder", lambda: str(tmp_path))
    monkeypatch.setattr(wasm, "_compiled", lambda kernels: made.append(1) or make(kernels))
    first = compiled(adds(1))
    assert compiled(adds(1)) == first and len(made) == 1
    assert compiled(adds(2)) != first and len(made) == 2
    for file in tmp_path.rglob("*.nbc"):
        file.write_bytes(file.read_bytes()[:-1])
    assert compiled(adds(1)) == first and len(made) == 3


TARGETS = """async ([path, levels, variant, goals]) => {
  const { rules } = await import(new URL(path, location.href));
  const begun = levels.map((level) => rules.build(level, variant));
  return begun.map((s) => goals.map((goal) => rules.target(s, goal)));
}"""


@pytest.mark.parametrize("name, kind", WORLDS)
def test_the_cell_of_a_goal_is_that_of_python(page, exported, name, kind):
    game = games.find(name)
    variant, goals = game.variant(kind), [*grid.world_of(game).events]
    write_rules(exported, game)
    states = initial_states(game, variant, range(30))
    levels = [Level.of(game, variant, s) for s in states]
    told = page.evaluate(
        TARGETS, [rules.entry(game), [one.to_json() for one in levels], knobs(variant), goals]
    )
    begun = [one.state(solvable=False) for one in levels]
    targets = [[game.cells.target(s, goal) for goal in goals] for s in begun]
    assert told == json.loads(json.dumps(targets))
