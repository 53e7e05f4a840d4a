"""Docstrings: examples run as they stand, and the shapes of arrays and all errors are named."""

import ast
import doctest
import inspect
from pathlib import Path

import gymnasium
import numpy as np
import pytest
import torch

import astray
from astray import acting, games, protocols, world
from astray.envs import vector
from astray.envs.compiled import loop_of
from astray.training import levels
from helpers.documented import public

# What is imported or implemented by others: the top-level package, and its protocols.
SHOWN = [getattr(astray, name) for name in dir(astray) if name != "PRESETS"]
SHOWN += [acting.Actor, acting.Policy, acting.Stage, levels.Sampler]
SHOWN += [
    one
    for one in vars(protocols).values()
    if inspect.isclass(one) and one.__module__ == protocols.__name__
]


@pytest.mark.parametrize("shown", SHOWN, ids=lambda shown: shown.__name__)
def test_an_example_runs_and_prints_what_it_says(shown, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for module in (games, world):  # what an example registers is not there for other tests
        monkeypatch.setattr(module, "_registered", {**module._registered})
    if shown is astray.register:  # its game is not played
        monkeypatch.setattr(vector, "compiled_loop", loop_of)
    names = {"astray": astray, "gymnasium": gymnasium, "np": np, "torch": torch}
    (test,) = doctest.DocTestFinder(recurse=False).find(shown, shown.__name__, globs=names)
    assert test.examples, f"{shown.__name__} shows no example"
    said: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(test, out=said.append)
    assert not said, "".join(said)


def undocumented(*sources: str) -> list[str]:
    """Return the public functions that leave out the shape of an array, or an error."""
    return [
        f"{one.name}: {' '.join(left)}"
        for one in public(map(ast.parse, sources))
        if (left := [*(k for k, said in one.arrays().items() if not said), *sorted(one.unsaid())])
    ]


@pytest.mark.parametrize(
    "words, left",
    [
        ("Return the sums [N] of rewards [N, T].", "f: ValueError"),
        ("Return the sums [N].", "f: x ValueError"),
        ("Return the sums; raise ValueError.", "f: x return"),
        ("Return the sums.\n\n    Args:\n        x: [N, T]\n    ", "f: return ValueError"),
        ("Raise ValueError.\n\n    Args:\n        x: [N]\n\n    Returns:\n        [N]\n    ", None),
    ],
)
def test_shapes_and_errors_are_missed_where_a_docstring_leaves_them_out(words, left):
    rest = "    _check(x)\n\n\ndef _check(x):\n    raise ValueError(x)\n"
    source = f'def f(x: np.ndarray) -> np.ndarray:\n    """{words}"""\n{rest}'
    assert undocumented(source) == ([left] if left else [])


def test_an_error_that_is_caught_needs_no_words():
    assert not undocumented(
        "def f():\n    try:\n        raise KeyError\n    except LookupError:\n        return"
    )


def test_public_functions_name_the_shapes_of_arrays_and_their_errors():
    package = Path(astray.__file__).parent
    sources = [p.read_text() for p in package.rglob("*.py") if "tests" not in p.parts]
    assert not undocumented(*sources)
