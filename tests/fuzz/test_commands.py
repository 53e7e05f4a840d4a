"""Any words do something, or are told what is wrong with them."""

import contextlib
import io
import string
import sys
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from astray import cli
from astray.cli import arguments, verbs
from helpers.anything import tried, tries

WORDS = st.sampled_from([
    "maze", "coinrun", "keys", "chess", "corner", "anywhere-small", "corner-xs", "--levels",
    "--set", "--json", "--text", "--level", "--level-file", "--actions", "--levels", "--variant",
    "--shift", "--mode", "--batch", "--preset", "--seeds", "--out", "--size", "--workers", "0",
    "5:8", "-1", "3", "1e9", "99999999999999999999", "a=b", "time_limit=5", "world=x", "smoke",
    "paper", "small", "greedy", "/nowhere", "", "-", "--", "\x00", "é", "--help", "--no-json",
    "--pixels", "--out", "x.gif", "--unsolvable", "--num-envs", "--num-steps", "--steps",
])  # fmt: skip
# Those of which some words would open a window, serve a page, ask the network, measure for minutes,
# or add to the package.
LEFT_OUT = {"play", "lab", "art", "import", "agents", "bench", "keep", "push", "pull"}
VERBS = (*sorted(verbs.VERBS.keys() - LEFT_OUT), "levels", "")


@tries(8)
@given(st.sampled_from(VERBS), st.lists(WORDS, max_size=6))
def test_a_command_does_something_or_says_what_is_wrong(verb, words):
    with pytest.MonkeyPatch.context() as patch:
        # What they would do takes long, and is tested elsewhere.
        patch.setattr("astray.training.track.train_tracked", lambda *a, **k: Path("trained"))
        patch.setattr("astray.experiments.sweep.run.run_sweep", lambda *a, **k: Path("swept"))
        patch.setattr("astray.experiments.run.reproduce", lambda *a, **k: Path("reported"))
        patch.setattr(sys, "argv", ["astray", *([verb] if verb else []), *words])
        patch.setattr(sys, "stdin", io.StringIO("left right"))
        said, failed = io.StringIO(), io.StringIO()
        code = 0
        with contextlib.redirect_stdout(said), contextlib.redirect_stderr(failed):
            try:
                cli.main()
            except SystemExit as exit_:
                code = exit_.code or 0
    assert code in (0, 2), (verb, words, code)
    assert (said.getvalue() if code == 0 else failed.getvalue()).strip() or verb == "list"
    tried("commands", code == 2)


@tries(30)
@given(st.text(string.digits + ",:- x", max_size=12))
def test_level_numbers_are_refused_or_in_range(text):
    try:
        found = arguments.level_numbers(text)
    except ValueError as error:
        assert "level" in str(error)
        tried("level numbers", 1)
        return
    assert found.size and found.min() >= 0 and found.max() < 2**31 - 1
    tried("level numbers", 0)
