"""The page has its constants from Python, and repeats none by hand."""

import base64
import importlib
import json
import re
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from astray import games, record
from astray.acting import initial_states
from astray.agency import measure
from astray.agency.gridworld import World as Gridworld
from astray.agency.measure import CALIBRATED
from astray.agency.online import measure_online
from astray.art import own
from astray.envs.vector import GameVectorEnv
from astray.figures.axes import COLOURS
from astray.figures.style import OTHERS
from astray.kernel import rng, thief
from astray.lab import constants, goals, rules, wasm
from astray.level import Level
from astray.outcome import INTENDED, MISGENERALIZED
from astray.training import ppo
from helpers.browsed import PLAY, knobs, modules_of
from helpers.thorough import thorough


@pytest.mark.parametrize(
    "name, kind, order",  # what each is a plane of, in an order that is not the game's
    [
        ("maze", "anywhere-small", "SHAPE MOUSE COLOUR WALL"),
        # `test_rules_are_those_of_python_state_by_state` compares the planes of all games.
        *thorough(
            ("keys", "many-keys-small", "X HAND CHEST KEY WALL Y THIEF"),
            ("heist", "small", "X GEM Y KEY WALL HAND DOOR THIEF"),
            ("coinrun", "coin-anywhere", "COIN CRATE HAZARD WALL GAUGE LEFT RIGHT"),
        ),
    ],
)
def test_planes_have_the_order_of_python(chrome, static, exported, monkeypatch, name, kind, order):
    game, draw = games.find(name), importlib.import_module(f"astray.games.{name}.draw")
    variant = game.variant(kind)
    (s,) = initial_states(game, variant, [3])
    env = GameVectorEnv(name, kind, 1, observation="symbolic")
    seen, _ = env.reset(options={"state": s[None]})
    places = [getattr(draw, f"{plane}_PLANE") for plane in order.split()]
    for place, plane in enumerate(order.split()):
        monkeypatch.setattr(draw, f"{plane}_PLANE", place)
    words = [f"rules/{name}.js", Level.of(game, variant, s).to_json(), knobs(variant), []]
    with now(exported, name), modules_of(chrome, static) as page:
        (told,) = json.loads(page.evaluate(PLAY, words))
    assert base64.b64decode(told[1]) == seen[0][places].tobytes()


@contextmanager
def now(exported, *names):
    """The exported page has the constants that Python has now, also in the planes of some games."""
    made = {constants.PATH: constants.module(), rules.SHARED: rules.shared()}
    for game in map(games.find, names):
        text = (exported / rules.path(game)).read_text()
        made[rules.path(game)] = with_planes(game, *re.findall(r"await kernels\(.*\)", text))
    before = {path: (exported / path).read_bytes() for path in made}
    for texts in (made, before):
        for path, text in texts.items():
            (exported / path).write_bytes(text)
        if texts is made:
            yield


def with_planes(game, kernels):
    """The module of a game with `kernels` and, in place of theirs, those of planes as of now."""

    def compiled(called):
        planes = {name: one for name, one in called.items() if "planes" in name}
        return f"{kernels}, ...{wasm.compiled(planes)}"

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(rules, "compiled", compiled)
        return rules.module(game).encode()


def test_the_page_has_the_number_of_levels_and_the_size_of_the_thief_from_python(
    chrome, static, exported, monkeypatch
):
    monkeypatch.setattr(record, "MOST", 100)
    monkeypatch.setattr(thief, "HALF", np.float32(2))
    with now(exported), modules_of(chrome, static) as page:
        wrong, drawn = page.evaluate(
            """async () => {
              const take = (path) => import(new URL(path, location.href));
              const { fromLink } = await take("link.js");
              const { look } = await take("games/thief.js");
              const { Brush } = await take("games/common.js");
              const about = { games: { keys: { variants: { hard: 0 } } }, agents: {} };
              const { wrong } = await fromLink("#game=keys&variant=hard&level=100", about);
              const drawn = [];
              const paint = new Proxy({}, { get: (_, name) => (image, ...where) => {
                if (name === "drawImage") drawn.push(...where);
              } });
              const s = { x: 0, y: 0, objects: 0, facing: 7 };
              const brush = new Brush(paint, 10, 0);
              look(null, () => []).moving(brush, null, s, { get: () => "a picture" });
              return [wrong, drawn];
            }"""
        )
    assert wrong.startswith("A level must be a number from 0 to 99; the link has '100'.")
    assert drawn == [-20, -20, 40, 40]


def test_the_page_s_prior_of_errors_is_python_s(chrome, static, exported, monkeypatch):
    monkeypatch.setattr(goals, "BETA", 3.0)
    free = np.ones((5, 5), bool)
    way = [(0, 0), (1, 0), (1, 1), (0, 1), (0, 2), (1, 2)]
    world = Gridworld(free)
    episode = measure.Episode(world, world.path(way), (4, 4))
    options = replace(CALIBRATED, goals="accessible", beta=3.0)
    with now(exported), modules_of(chrome, static) as page:
        told = page.evaluate(
            """async (way) => {
              const { posterior } = await import(new URL("agent/agency.js", location.href));
              return posterior(Array.from({ length: 5 }, () => Array(5).fill(true)), way);
            }""",
            way,
        )
    growth = measure_online(episode, options)
    assert [tuple(cell) for cell in told["cells"]] == list(growth.goals)
    assert np.allclose(told["rates"], growth.posterior, atol=1e-9)


def test_the_page_repeats_no_constant_of_python():
    """It would stay as it is when Python's is changed."""
    parts = ", ".join(constants.TABLES.values()).split(", ")
    modules = [importlib.import_module(f"astray.{part.split()[0]}") for part in parts]
    numbers = {
        (name, float(value))
        for module in modules
        for name, value in vars(module).items()
        if isinstance(value, int | float)
    }
    for file in Path(constants.__file__).with_name("page").rglob("*.js"):
        for name, value in re.findall(r"const ([A-Z_]+) = ([\d.]+);", file.read_text("utf-8")):
            assert (name, float(value)) not in numbers, (file.name, name)


def test_the_page_repeats_no_number_of_the_generators():
    numbers = {int(value) for value in vars(rng).values() if isinstance(value, np.uint64)}
    for file in Path(constants.__file__).with_name("page").rglob("*.js"):
        for literal in re.findall(r"\b(?:0x[0-9a-f]{6,}|\d{7,})", file.read_text("utf-8")):
            assert int(literal, 0) not in numbers - {0xFFFFFFFF}, (file.name, literal)


def test_the_page_draws_by_the_constants_that_python_has_now(chrome, static, exported, monkeypatch):
    program = """async () => {
      const { noise, sample } = await import(new URL("agent/noise.js", location.href));
      return [noise(3, 7, 2, 4), sample([0.5, 0.5], [0.6, 0.9])];
    }"""
    told = []
    for unit, below_one in ((2.0**-53, 1 - 1e-7), (2.0**-54, 0.5)):
        monkeypatch.setattr(rng, "TO_UNIT", unit)
        monkeypatch.setattr(ppo, "BELOW_ONE", below_one)
        with now(exported), modules_of(chrome, static) as page:
            told.append(page.evaluate(program))
    drawn = np.zeros((1, 4), np.float32)
    rng.fill_noise(3, np.array([7]), np.array([2]), drawn)
    assert told == [[drawn[0].tolist(), 1], [(drawn[0] / 2).tolist(), 0]]


def test_the_page_repeats_no_word_or_colour_of_python():
    """It would show no goal, or another colour, when Python's is changed."""
    repeated = {
        *(f'"{word}"' for word in (goals.NEITHER, goals.OTHER)),
        f"{goals.NEITHER}:",
        *("#" + bytes(colour).hex() for colour in own.COLOURS.values()),
    }
    for file in Path(constants.__file__).with_name("page").rglob("*.js"):
        lines = [line.partition("//")[0] for line in file.read_text("utf-8").split("\n")]
        assert not [(file.name, one) for one in repeated for line in lines if one in line]


def test_the_colours_of_goals_are_those_of_figures():
    page = Path(constants.__file__).with_name("page")
    text = (page / "draw" / "colours.js").read_text("utf-8")
    told = dict(re.findall(r"const ([A-Z]+) = (.+);", text))
    expected = {
        "INTENDED": COLOURS[INTENDED],
        "PROXY": COLOURS[MISGENERALIZED],
        "OTHERS": [*OTHERS],
    }
    assert {name: json.loads(told[name]) for name in expected} == expected
