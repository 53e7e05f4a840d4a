"""Same bytes: levels, observations and episodes are what they were, in every way to run."""

import json
import subprocess
import sys

import pytest

from astray import games
from helpers import golden
from helpers.cases import ALL, FIRST, SHAPES
from helpers.processes import environment
from helpers.thorough import thorough


@pytest.mark.parametrize("game, variant", ALL)
def test_levels_observations_and_episodes_are_what_they_were(game, variant):
    steps = golden.STEPS[-1 if (game, variant) in SHAPES else -2]
    assert golden.differing(game, {variant: golden.golden(game, variant, steps=steps)}) == []


@pytest.mark.parametrize("game, variant", FIRST)
@pytest.mark.parametrize("how", [{"batch": 65, "threads": 2}, *thorough({"batch": 1})])
def test_neither_batch_nor_threads_matter(game, variant, how):
    found = golden.golden(game, variant, steps=100, **how)
    assert golden.differing(game, {variant: found}) == []


@pytest.mark.parametrize("game", games.OWN)
def test_every_variant_is_digested(game):
    kept = golden.kept(game)
    assert set(kept) == set(games.find(game).variants)
    assert all(len(digests) == 15 for digests in kept.values())


@pytest.mark.waits
@pytest.mark.thorough  # `test_contract` interprets a few steps of each game
def test_interpreted_code_does_the_same():
    """In one process, as starting it takes as long as most games."""
    program = "import json; from helpers import golden; print(json.dumps(golden.few_of_all()))"
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        env=environment(NUMBA_DISABLE_JIT="1"),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout) == golden.few_of_all()
