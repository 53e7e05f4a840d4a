"""Same bytes: levels, observations and episodes are what they were, in every way to run."""

import json
import os
import subprocess
import sys

import golden
import pytest
from conftest import ALL, FEW

KEPT = json.loads(golden.FILE.read_text())


@pytest.mark.parametrize("game, variant", ALL)
def test_levels_observations_and_episodes_are_what_they_were(game, variant):
    name = f"{game} {variant}"
    assert golden.differing({name: golden.golden(game, variant)}, KEPT) == []


@pytest.mark.parametrize("game, variant", FEW)
@pytest.mark.parametrize("how", [{"batch": 1}, {"batch": 256, "threads": 2}, {"threads": 2}])
def test_neither_batch_nor_threads_matter(game, variant, how):
    name = f"{game} {variant}"
    assert golden.differing({name: golden.golden(game, variant, steps=100, **how)}, KEPT) == []


def test_every_variant_is_digested():
    assert set(KEPT) == {f"{game} {variant}" for game, variant in ALL}
    assert all(len(digests) == 15 for digests in KEPT.values())


@pytest.mark.parametrize("game", sorted({game for game, _ in ALL}))
def test_interpreted_code_does_the_same(game):
    names = [variant for other, variant in FEW if other == game][:2]  # all of them take minutes
    code = f"""
import json, golden
found = {{f"{game} {{v}}": golden.golden("{game}", v, steps=10) for v in {names}}}
print(json.dumps(found))
"""
    env = os.environ | {
        "NUMBA_DISABLE_JIT": "1",
        "PYTHONPATH": os.pathsep.join(filter(None, sys.path)),
    }
    done = subprocess.run([sys.executable, "-c", code], env=env, capture_output=True, check=True)
    found = json.loads(done.stdout)
    assert len(found) == len(names) and golden.differing(found, KEPT) == []
