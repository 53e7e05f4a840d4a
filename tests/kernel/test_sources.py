"""Compiled code is of the functions that it is asked for, as they are."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest

from astray.games import maze
from astray.games.coinrun import rules as others
from astray.kernel.sources import digest_of
from helpers.processes import environment

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


@pytest.fixture
def module(tmp_path, monkeypatch):
    (tmp_path / "of_functions.py").write_text(FUNCTIONS)
    monkeypatch.syspath_prepend(tmp_path)
    yield importlib.import_module("of_functions")
    del sys.modules["of_functions"]


def test_two_functions_of_a_module_are_two(module):
    assert digest_of({"step": module.step_one}) == digest_of({"step": module.step_one})
    found = {
        digest_of({"step": module.step_one}),
        digest_of({"step": module.step_two}),
        digest_of({"draw": module.step_one}),
        digest_of({"step": module.step_one}, 9),
        digest_of({"step": maze.GAME.rules.step}),
        digest_of({"step": others.step}),
    }
    assert len(found) == 6 and None not in found


def test_what_another_function_made_is_told_by_nothing(module):
    assert digest_of({"step": module.made(1)}) is None


def test_an_edit_is_another(module, tmp_path):
    before = digest_of({"step": module.step_one})
    (tmp_path / "of_functions.py").write_text(FUNCTIONS + "# edited\n")
    assert digest_of({"step": module.step_one}) != before


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
