"""Processes and threads: forked, spawned, started at once, closed twice, created by thousands."""

import gc
import json
import multiprocessing
import os
import subprocess
import sys
import threading
import time

import gymnasium
import numba
import numpy as np
import pytest

from astray.envs.vector import GameVectorEnv
from helpers.anything import MORE
from helpers.processes import begin, environment
from helpers.walks import made, walk, walk_and_send


@pytest.mark.parametrize(
    "method",
    [  # a process of a server is as fresh as one that is spawned
        pytest.param(name, marks=pytest.mark.thorough if name == "forkserver" else ())
        for name in multiprocessing.get_all_start_methods()
    ],
)
def test_a_child_process_plays_as_its_parent(method):
    context = multiprocessing.get_context(method)
    env, (ours, theirs) = made(), context.Pipe()
    expected = walk(env)
    # A fork takes the environment along, without the threads that stepped it.
    given = env if method == "fork" else None
    child = context.Process(target=walk_and_send, args=(theirs, given), daemon=True)
    child.start()
    assert ours.poll(60) and ours.recv_bytes() == expected
    child.join(10)
    assert child.exitcode == 0
    assert walk(env) == expected
    env.close()


@pytest.mark.filterwarnings("ignore:.*multi-threaded.*fork:DeprecationWarning")
def test_gymnasium_runs_it_in_processes():
    # The module's name comes first, as a process may be a fresh one: some libraries see to that.
    name = "astray:astray/maze-corner-small-v0"
    envs = [lambda: gymnasium.make(name, observation="symbolic")] * 2
    parallel = gymnasium.vector.AsyncVectorEnv(envs, shared_memory=True)
    serial = gymnasium.vector.SyncVectorEnv(envs)
    assert np.array_equal(parallel.reset(seed=1)[0], serial.reset(seed=1)[0])
    for action in np.random.default_rng(0).integers(15, size=(20, 2)):
        assert np.array_equal(parallel.step(action)[0], serial.step(action)[0])
    parallel.close()
    serial.close()


def test_two_threads_step_two_environments():
    expected, seen = walk(made()), [b""] * 4
    envs = [made(1 + k % 2) for k in range(4)]

    def play(k):
        seen[k] = b"".join(walk(envs[k]) for _ in range(5))

    threads = [threading.Thread(target=play, args=(k,)) for k in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert seen == [expected * 5] * 4
    for env in envs:
        env.close()


COMPILE = """
import json, os, pathlib, sys, time
from astray.envs import compiled, loops
from astray.kernel.jit import code_folder
from helpers.lava import GAME

sys.path.insert(0, "")
from small import run
loops.run = run  # compiled sooner than the loop of a game
pathlib.Path(f"begun-{os.getpid()}").touch()
while len([*pathlib.Path().glob("begun-*")]) < 2:  # else one may be ready before the other begins
    time.sleep(0.01)
loop = compiled.compiled_loop(GAME)
print(json.dumps({"hits": sum(loop.stats.cache_hits.values()), "folder": code_folder()}))
"""
WARN = """
import json, os, warnings
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    import numpy as np
    from astray.kernel.rng import fill_fractions
    fill_fractions(1, 2, np.zeros(3))
from astray.kernel.jit import code_folder
folder = code_folder()
said = [str(w.message) for w in said if w.category is UserWarning]
print(json.dumps({"said": said, "folder": folder, "there": os.path.exists(folder)}))
"""


def under(home):
    """The environment of a process that keeps its compiled code under `home`."""
    return environment(NUMBA_CACHE_DIR="", XDG_CACHE_HOME=str(home))


def told(code, said, error):
    assert code == 0, error
    return json.loads(said)


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_processes_that_start_at_once_share_what_one_compiles(tmp_path):
    (tmp_path / "work").mkdir()
    (tmp_path / "work" / "small.py").write_text("def run(*given):\n    return 7\n")
    begun = [begin(COMPILE, tmp_path / "work", env=under(tmp_path / "home")) for _ in range(2)]
    both = [told(*one.ended()) for one in begun]
    (folder,) = {one["folder"] for one in both}
    entries = [name for _, _, names in os.walk(folder) for name in names if name.endswith(".nbc")]
    # Each compiled once.
    assert sorted(one["hits"] for one in both) == [0, 1]
    assert [name.partition("_")[0] for name in entries] == ["small.run"]


@pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")
def test_a_home_that_cannot_be_written_is_warned_of_once(tmp_path):
    (tmp_path / "home").write_text("a file, where a folder should be")
    words = [sys.executable, "-c", WARN]  # which ends as Python does
    done = subprocess.run(words, env=under(tmp_path / "home"), capture_output=True, text=True)
    one = told(done.returncode, done.stdout, done.stderr)
    assert len(one["said"]) == 1 and "compiled code is not kept" in one["said"][0]
    assert one["there"] and not os.path.exists(one["folder"])  # a temporary folder, then none


def test_an_environment_is_deleted_in_mid_episode():
    before = threading.active_count()
    for threads in (1, 3):
        env = made(threads)
        env.reset(seed=0)
        env.step(np.zeros(8, int))
        del env
        gc.collect()
    assert wait_for(lambda: threading.active_count() <= before)  # another may have ended


def wait_for(true, seconds=5.0):
    until = time.monotonic() + seconds
    while not true() and time.monotonic() < until:
        time.sleep(0.01)
    return true()


@pytest.mark.thorough  # `test_an_environment_is_deleted_in_mid_episode`
def test_thousands_of_environments_leave_nothing_behind():
    resource = pytest.importorskip("resource")

    def some(count):
        for k in range(count):
            env = GameVectorEnv("maze", "corner-small", 2, threads=1 + (k % 50 == 0))
            env.reset(seed=k)
            env.step(np.zeros(2, int))
            if k % 2:
                env.close()
                env.close()

    before = threading.active_count()
    some(1000)
    gc.collect()
    used = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    some(9000 if MORE > 1 else 2000)
    gc.collect()
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - used < 5_000  # kB
    assert wait_for(lambda: threading.active_count() <= before)  # another may have ended
