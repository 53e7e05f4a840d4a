"""What users import from `astray` itself."""

import ast
import inspect
import subprocess
import sys
import textwrap
from dataclasses import replace
from pathlib import Path

import gymnasium
import pytest

import astray
from astray import games
from astray.envs import vector
from astray.envs.compiled import loop_of

FUNCTIONS = sorted({*astray.FACE} - {"PRESETS"})


def test_every_name_of_the_face_is_there_and_typed():
    tree = ast.parse(Path(astray.__file__).read_text())
    typed = {
        alias.asname or alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.If)
        for part in node.body
        if isinstance(part, ast.ImportFrom)
        for alias in part.names
    }
    assert typed == set(astray.FACE)
    for name in FUNCTIONS:
        assert callable(getattr(astray, name)) and getattr(astray, name).__doc__, name


CHECKS = {"of_kind", "bounded", "finite", "one_of", "check_words"}


def raises(function):
    """Whether it raises by itself, or lets a check of what it is given raise."""
    nodes = list(ast.walk(ast.parse(textwrap.dedent(inspect.getsource(function)))))
    called = {n.func.id for n in nodes if isinstance(n, ast.Call) and isinstance(n.func, ast.Name)}
    return bool(called & CHECKS) or any(isinstance(n, ast.Raise) and n.exc for n in nodes)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_the_face_says_in_a_sentence_what_it_does_and_what_it_raises(name):
    given = getattr(astray, name)
    told = {given: inspect.getdoc(given)}
    for made, function in vars(given).items() if inspect.isclass(given) else ():
        function = getattr(function, "__func__", function)
        if not inspect.isfunction(function) or function.__code__.co_filename == "<string>":
            continue  # none, or a dataclass has made it
        if not made.startswith("_") and function.__name__ == made:
            told[function] = inspect.getdoc(function)
        elif made in ("__init__", "__post_init__"):
            told[function] = told[given]  # a class says what it raises
    for function, text in told.items():
        assert text and text.splitlines()[0].endswith("."), function
        if inspect.isfunction(function) and raises(function):
            assert "Error" in text, f"{function.__qualname__} does not say what it raises"


def test_what_is_not_there_is_explained():
    with pytest.raises(AttributeError, match=r"has no 'Gmae'; it has: .*Game"):
        astray.Gmae  # noqa: B018


def test_the_face_imports_no_torch_until_it_is_needed():
    code = "import astray, sys; astray.Level; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_a_registered_game_is_found_by_name_and_by_gymnasium(monkeypatch):
    monkeypatch.setattr(games, "_registered", {})
    monkeypatch.setattr(vector, "compiled_loop", loop_of)  # which is not compiled
    maze = games.find("maze")
    mine = replace(maze, name="mine", variants={"one": maze.variants["corner"]}, shifts={})
    astray.register(mine)
    assert games.find("mine") is mine and "mine" in games.names()
    assert gymnasium.make("astray/mine-one-v0").unwrapped.vector.game is mine
    with pytest.raises(ValueError, match="one of astray's"):
        astray.register(replace(maze, name="keys"))
    with pytest.raises(ValueError, match=r"must be of letters.*'a mine'"):
        astray.register(replace(mine, name="a mine"))
    with pytest.raises(ValueError, match=r"letters, digits, _, - and \.; got 'mine' with 'a:b'"):
        astray.register(replace(mine, variants={"a:b": maze.variants["corner"]}))  # of a run folder
    assert "a mine" not in games.names()
    astray.register(replace(mine, variants={"two": maze.variants["corner"]}))
    assert [n for n in gymnasium.registry if "mine" in n] == ["astray/mine-two-v0"]
    with pytest.raises(ValueError, match="must be a Game"):
        astray.register(3)
    gymnasium.registry.pop("astray/mine-two-v0")


def test_a_kept_agent_is_loaded_by_its_name():
    assert astray.load_agent("maze-corner").game == "maze"
