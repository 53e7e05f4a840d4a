"""What users import from `astray` itself."""

import ast
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import gymnasium
import pytest

import astray
from astray import games


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
    for name in astray.FACE:
        assert callable(getattr(astray, name)) and getattr(astray, name).__doc__, name


def test_what_is_not_there_is_explained():
    with pytest.raises(AttributeError, match=r"has no 'Gmae'; it has: .*Game"):
        astray.Gmae  # noqa: B018


def test_the_face_imports_no_torch_until_it_is_needed():
    code = "import astray, sys; astray.Level; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0


def test_a_registered_game_is_found_by_name_and_by_gymnasium(monkeypatch):
    monkeypatch.setattr(games, "_registered", {})
    maze = games.find("maze")
    mine = replace(maze, name="mine", variants={"one": maze.variants["corner"]})
    astray.register(mine)
    assert games.find("mine") is mine and "mine" in games.names()
    assert gymnasium.make("astray/mine-one-v0").unwrapped.vector.game is mine
    with pytest.raises(ValueError, match="one of astray's"):
        astray.register(replace(maze, name="keys"))
    with pytest.raises(ValueError, match="must be a Game"):
        astray.register(3)
    gymnasium.registry.pop("astray/mine-one-v0")


def test_a_kept_agent_is_loaded_by_its_name():
    assert astray.load_agent("maze-corner").game == "maze"
