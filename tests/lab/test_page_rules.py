"""The rules that a page plays by are Python's, translated."""

import base64
import json
import runpy

import numpy as np
import pytest

from astray import games
from astray.envs.vector import GameVectorEnv
from astray.insight.actions import effects
from astray.lab import rules, translate
from astray.lab.worlds import snapshot
from astray.level import Level
from helpers.browsed import PLAY, knobs, modules_of

STEPS = 150  # of each episode at random, each three times
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
def test_rules_that_are_translated_are_those_of_python_state_by_state(page, exported, name, kind):
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
          return effects({ copy, step }, { time: 0, time_limit: 9, mt_next: 5 }, 3);
        }"""
    )
    assert told == [0, 1, 1]


REFUSED = {
    "return (lambda: s)()": "asks must be translated for .*, which knows no 'lambda",
    "for k in range(3):\n  s.a = k\n else:\n  s.a = 7": "knows no 'for k in range",
    "while s.a < 3:\n  s.a += 1\n else:\n  s.a = 7": "knows no 'while s.a",
    "for k in TABLE:\n  s.a += k": "knows no 'for k in TABLE",
    "for k in other(s):\n  s.a += k": "knows no 'for k in other",
    "s.cell[1:] = 4": "knows no '1:'",
    "return pair(s)[s.a]": r"knows no 'pair\(s\)\[s.a\]'",  # else it is called twice
    "x = np.empty(9)\n x[catch(s)] += 1": r"knows no 'x\[catch\(s\)\] \+= 1'",
    "return 0 <= catch(s) < 4": r"knows no '0 <= catch\(s\) < 4'",
    "return s.a + 9007199254740993": "knows no '9007199254740993'",
    "return BIG[s.a]": r"constant BIG .* integers of up to 15 digits; got \(1, 11529215",
    "return s.cell.shape[-1]": r"knows no 's.cell.shape'",
    "return s.cell.size": "knows no 's.cell.size'",
    "return s.cell.sum()": "knows no 's.cell.sum'",
    "return ~s.a": "knows no '~s.a'",
    "return math.sqrt(s.a)": "knows no 'sqrt'",
    "return np.int32(s.a)": "knows no 'int32'",
    "return float(s.a)": "knows no 'float'",
    "return usual(s)": "usual must be translated .*, which knows no '3'",
    "return Kind.WALL": "knows no 'Kind.WALL'",
    "return NAMES[0]": r"the constant NAMES of a page must be numbers, .*; got \['a'\]",
    "return np.empty((2, 3))[1, 1]": "knows no 'empty'",
    "return unheard": "knows no 'unheard'",
    "return (s.a, 1) < (0, 2)": r"knows no '\(s.a, 1\) < \(0, 2\)'",
    "return np.uint64(1) + s.a": r"knows no 'np.uint64\(1\) \+ s.a'",
    "x = np.float32(s.a)\n x = s.a\n return x": "knows no 'x = s.a'",  # of 32 bits and of 64
    "s.row += 1": r"knows no 's.row \+ 1'",
    "s.row = s.b": "knows no 's.row'",
    "x = s.row + 1\n return x[0]": r"knows no 's.row \+ 1'",
    "x = np.empty(2)\n x += 1\n return x[0]": r"knows no 'x \+ 1'",
    "x = -s.b\n return x[0]": "knows no '-s.b'",
    "return (s.b == s.b)[0]": "knows no 's.b == s.b'",
    "return -s.u": "knows no '-s.u'",  # which compiled code wraps
    "s.a, s.u = pair(s)": r"knows no '\(s.a, s.u\)'",
    "return np.full((2, 2), s.a)[0, 0]": r"knows no 'np.full\(\(2, 2\), s.a\)'",  # of which type?
    "return np.uint64(7) / np.uint64(2)": r"knows no 'np.uint64\(7\) / np.uint64\(2\)'",
    "return max(np.uint64(7), np.uint64(2))": r"knows no 'max\(np.uint64\(7\), np.uint64\(2\)\)'",
}


@pytest.mark.parametrize("body", REFUSED)
def test_what_cannot_be_translated_is_refused_by_its_name(tmp_path, body):
    with pytest.raises(ValueError, match=REFUSED[body]):
        translated(tmp_path, body)


KERNELS = """\
import math
from enum import IntEnum

import numpy as np

TABLE, NAMES, catch_ = (4, 5), ["a"], 9
BIG = 1, 2**60
REALS, REAL = np.array([0.1, 0.7], np.float32), (np.float32(0.1), 3)

class Kind(IntEnum):
    WALL = 5

def usual(s, n=3):
    return n

def catch(s):
    return 3

def game(s):
    return catch(s) + catch_

def pair(s):
    return s.a, s.a

def put(rows, what):
    rows[1] = what

def swap(x, y):
    return y, x

def third(x):
    return x / np.float32(3)

def asks(s):
 """


FIELDS = np.dtype(
    [("a", int), ("t", bool), ("u", np.uint8), ("i", np.int16), ("row", np.uint8, 3), ("b", int, 3),
     ("f", np.float32), ("c", np.float32, 3)]
)  # fmt: skip


def translated(folder, body):
    """A kernel of that body, in Python and in JavaScript with all that it needs."""
    (folder / "kernels.py").write_text(KERNELS + body + "\n")
    found = runpy.run_path(str(folder / "kernels.py"))
    made = translate.Translation({"cell": np.dtype(int), **{n: FIELDS[n] for n in FIELDS.names}})
    assert made.name(found["asks"]) == "asks"
    return found["asks"], "\n".join([*made.constants.values(), *made.functions])


@pytest.mark.parametrize(
    "body",
    [
        "for k in range(4):\n  s.a += k\n return k",  # the last one, after the loop
        "for k in range(6):\n  k += 2\n  s.a += k\n return s.a",
        "for k in range(s.a + 3):\n  s.a += 1\n return s.a",
        "for k in range(5, -1, -2):\n  s.a = 10 * s.a + k\n return s.a",
        "for k in range(3):\n  for k in range(2):\n   s.a += k\n  s.a += 10 * k\n return s.a",
        "return (1 << 40) | (5 & 4) | (2199023255552 >> 1)",
        "typeof, static = 3, 4\n return typeof + static + game(s)",
        "return np.float64(np.float32(0.1) + np.float32(0.2))",  # of 32 bits
        "x = -third(np.float32(s.a + 1))\n return np.float64(np.sqrt(abs(x)) * third(x))",
        "return TABLE[-1] + 10 * TABLE[s.a - 2] + 100 * TABLE[-(s.a + 1)]",  # from the end
        "x = np.empty(3)\n x[:] = 0\n x[s.a - 1] = 7\n x[s.a - 2] += 5\n return x[2] + 9 * x[1]",
        "x = np.uint64(3) << np.uint64(62)\n return np.int64(x >> np.uint64(60))",  # 64 bits
        "return np.int64((np.uint64(9) ^ np.uint64(s.a + 1)) % np.uint64(5))",
        "x = np.full((2, 3), 7)\n h, w = x.shape\n return x[1, 2] + h * w",
        "x = np.full((2, 2), 0)\n x[0, 1] = 7 / 2\n x[1, 0] -= 1.5\n return 9 * x[0, 1] + x[1, 0]",
        "x = np.empty(2, np.float32)\n x[0] = 0.1\n x[1] = x[0] / 3\n return np.float64(x[1])",
        "for k in (4, 5):\n  s.a = 10 * s.a + k\n return s.a",
        "x, y = np.empty(2), np.empty(2)\n x[:], y[:] = 1, 2\n return x[0] + 10 * y[1]",
        "s.a = 7 / 2\n s.a += 0.75\n return s.a",  # a field of integers
        "return ((s.a, 1) == (0, 1)) + 2 * ((s.a, 1) != (0, 1))",
        "x, y = (s.a, 1), (0, 1)\n return (x == y) + 2 * (x != y) + 4 * (y != (s.a, 2))",
        "return 3 if [] and [1] else 4",  # to JavaScript an empty array is true
        "return len([] or [] or [1, 2]) + 10 * len([] and [1])",
        "return 3 if [1] and s.a == 0 and [] and 1 else 4",
        "return min(TABLE) + 10 * max(TABLE) + 100 * max(s.a, 2, 1)",
        "return third(np.float64(s.a + 1)) + np.float64(third(np.float32(1)))",
        "return (1.0 % 0.1) + 10 * (-0.7 % 0.2) + 100 * (5.5 % -2.0)",
        "return (1.0 // 0.1) + 100 * (-1.0 // 0.3) + 10000 * ((-7) // 2) + (7 % -3)",
        "s.t = s.a == 0\n return (s.t in (1, 2)) + 2 * ((s.t, 1) == (1, 1)) + 4 * (s.t in (0, 2))",
        "return pair(s) == (False, False)",
    ],
)
def test_a_kernel_returns_what_it_does_in_python(chrome, static, exported, tmp_path, body):
    s = np.zeros(1, FIELDS).view(np.recarray)[0]
    assert called(chrome, static, exported, tmp_path, body) == translated(tmp_path, body)[0](s)


OF_COMPILED = {  # what integers of few bits are there; interpreted ones are refused
    "s.u = 300\n s.i = 32767\n s.i += 2\n return s.u + 1000 * s.i": 44 - 32767000,
    "s.u -= 1\n s.row[1] = 257\n return s.u + 1000 * s.row[1]": 1255,
    "s.row[:] = s.b\n return s.row[0] + 10 * s.row[2]": 97,
    "s.b[:] = s.a - 4\n return s.b[0] + 10 * s.b[2]": -44,
    "s.row[:] = 257\n s.b[:] = 2.9\n return s.row[0] + 10 * s.b[2]": 21,
    "s.b[1] = -1\n s.row[:] = s.b\n return s.row[1]": 255,
    "put(s.row, 257)\n put(s.b, 2.9)\n return s.row[1] + 10 * s.b[1]": 21,
    "x, y = s.b, swap(s.row, 3)[1]\n x[0], y[0] = 2.9, 257\n return s.row[0] + 10 * s.b[0]": 21,
    "x = np.full((1, 2), 2.9, np.int64)\n y = x[0]\n y[1] = 1.5\n return x[0, 0] + 9 * y[1]": 11,
    "s.u = np.uint64(300)\n s.i = np.uint64(70000)\n return s.u + 1000 * s.i": 4464044,
    "x = s.a + 1e308 * 10\n return (3 if x - x else 4) + bool(x - x)": 4,  # NaN is true
    # of 32 bits
    "put(s.c, 0.1)\n return s.c[1]": 0.10000000149011612,
    "s.c[:] = 0.1\n return s.c[2]": 0.10000000149011612,
    "return s.c[0] * s.f": 0.030000001192092896,
    "x = np.full((1, 2), s.f)\n return x[0, 0] * x[0, 1]": 0.09000000357627869,
    "return (s.f + (s.a == 0)) * s.f": 0.39000001549720764,
    "s.u = 3\n return (s.f + s.u) * s.f": 0.9900000095367432,
    "s.u = 3\n return np.sqrt(s.u) + max(s.f, s.u) / s.f": 11.732050895690918,
    "x, y = (s.f, s.a), swap(s.c[0], s.f)\n return x[0] * x[0] + y[0] * y[1]": 0.12000000476837158,
    "return REALS[0] * REALS[1]": 0.07000000029802322,
    "return REAL[0] * s.f": 0.030000001192092896,
    "return (s.f or s.c[1]) * s.c[0]": 0.030000001192092896,
}


@pytest.mark.parametrize("body", OF_COMPILED)
def test_a_field_holds_what_it_does_in_compiled_code(chrome, static, exported, tmp_path, body):
    assert called(chrome, static, exported, tmp_path, body) == OF_COMPILED[body]


def test_a_page_copies_what_kernels_may_write_to_by_another_name(tmp_path):
    for body in ("put(s.row, 1)", "x = s.row\n x[1] = 1", "return s.a, s.row"):
        (tmp_path / "kernels.py").write_text(KERNELS + body + "\n")
        made = translate.Translation({name: FIELDS[name] for name in FIELDS.names})
        made.name(runpy.run_path(str(tmp_path / "kernels.py"))["asks"])
        assert "row" in made.stored, body


@pytest.mark.parametrize(
    "body",
    [
        "s.a = 3000000000\n return s.a * s.a",
        "return 1 << (s.a + 60)",
        "x = 3\n for k in range(58):\n  x = x + x + 1\n return x",
        "s.u = 1\n return s.row[0] - s.u",  # without a sign
    ],
)
def test_an_integer_that_a_page_would_round_is_told(chrome, static, exported, tmp_path, body):
    with pytest.raises(Exception, match=r"an integer above 2 \*\* 53, which needs Python"):
        called(chrome, static, exported, tmp_path, body)


def called(chrome, static, exported, tmp_path, body):
    """Run the kernel of that body in a page, and return its result."""
    _, there = translated(tmp_path, body)
    imported = f'import {{ {", ".join(translate.NAMES)} }} from "./python.js";\nconst game = 0;'
    (exported / "rules" / "asks.js").write_text(f"{imported}\n{there}\nexport {{ asks }};\n")
    with modules_of(chrome, static) as page:
        return page.evaluate(
            """async () => {
              const { asks } = await import(new URL("rules/asks.js", location.href));
              const [f, ...c] = [0.3, 0.1, 0.2, 0.7].map(Math.fround);
              return asks({ a: 0, t: false, u: 0, i: 0, row: [0, 0, 0], b: [7, 8, 9], f, c });
            }"""
        )
