"""Same bytes: levels, observations and episodes are what they were, in every way to run."""

import json
import subprocess
import sys

import pytest

from astray import games
from helpers import golden
from helpers.cases import ALL, FEW, SHAPES
from helpers.processes import environment


@pytest.mark.parametrize("game, variant", ALL)
def test_levels_observations_and_episodes_are_what_they_were(game, variant):
    steps = golden.STEPS[-1 if (game, variant) in FEW else -2]
    assert golden.differing(game, {variant: golden.golden(game, variant, steps=steps)}) == []


@pytest.mark.parametrize("game, variant", SHAPES)
@pytest.mark.parametrize("how", [{"batch": 1}, {"batch": 256, "threads": 2}, {"threads": 2}])
def test_neither_batch_nor_threads_matter(game, variant, how):
    found = golden.golden(game, variant, steps=100, **how)
    assert golden.differing(game, {variant: found}) == []


@pytest.mark.parametrize("game", games.OWN)
def test_every_variant_is_digested(game):
    kept = golden.kept(game)
    assert set(kept) == set(games.find(game).variants)
    assert all(len(digests) == 15 for digests in kept.values())


@pytest.mark.parametrize("game", games.OWN)
def test_interpreted_code_does_the_same(game):
    names = [variant for other, variant in SHAPES if other == game][:2]  # all of them take minutes
    program = f"""
import json
from helpers import golden
found = {{v: golden.golden("{game}", v, batch=1, steps=10) for v in {names}}}
print(json.dumps([found, golden.over_an_end("{game}")]))
"""
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", program],
        env=environment(NUMBA_DISABLE_JIT="1"),
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    found, over_an_end = json.loads(done.stdout)
    assert len(found) == len(names) and golden.differing(game, found) == []
    assert over_an_end == golden.over_an_end(game)
