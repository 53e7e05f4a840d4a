"""The examples in docstrings, which run as they stand."""

import doctest
import inspect

import gymnasium
import numpy as np
import pytest
import torch

import astray
from astray import acting, protocols
from astray.training import levels

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
    names = {"astray": astray, "gymnasium": gymnasium, "np": np, "torch": torch}
    (test,) = doctest.DocTestFinder(recurse=False).find(shown, shown.__name__, globs=names)
    assert test.examples, f"{shown.__name__} shows no example"
    said: list[str] = []
    doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE).run(test, out=said.append)
    assert not said, "".join(said)
