"""Importing astray creates nothing and sets nothing, whichever of its modules it is."""

import json
import os
import pkgutil
import subprocess
import sys

import pytest

import astray
from helpers.processes import begin

# Modules that are no part of the public: tests, and what runs a program.
MODULES = sorted(
    module.name
    for module in pkgutil.walk_packages(astray.__path__, "astray.")
    if ".tests" not in module.name and not module.name.endswith("__main__")
)

PROGRAM = """
import importlib, json, os, signal, sys, tempfile, threading

import gymnasium, matplotlib, numba, polars, torch  # what these do when imported is theirs
import torch.distributed

def settings():
    return {
        "numba": {name: repr(getattr(numba.config, name)) for name in dir(numba.config)
                  if name.isupper()},
        "numba threads": numba.get_num_threads(),
        "torch threads": (torch.get_num_threads(), torch.get_num_interop_threads()),
        "torch": repr((
            torch.get_default_dtype(), torch.get_default_device(), torch.is_grad_enabled(),
            torch.are_deterministic_algorithms_enabled(), torch.initial_seed(),
            torch.get_float32_matmul_precision(), torch.is_inference_mode_enabled(),
            torch.backends.cudnn.benchmark, torch.backends.cudnn.deterministic,
            torch.backends.cudnn.allow_tf32, torch.backends.cuda.matmul.allow_tf32,
            torch.multiprocessing.get_sharing_strategy(),
        )),
        "denormals": sys.float_info.min / 2 > 0,
        "matplotlib": repr(sorted(matplotlib.rcParams.items())),
        "signals": [repr(signal.getsignal(number)) for number in (signal.SIGINT, signal.SIGTERM)],
        "threads": threading.active_count(),
        "folder": os.getcwd(),
    }

tempfile.tempdir = None  # as in a process that has not asked for it
before = settings() | os.environ
for name in sys.argv[1:]:
    importlib.import_module(name)
after = settings() | os.environ
print(json.dumps({
    name: [before.get(name), after.get(name)]
    for name in before | after if before.get(name) != after.get(name)
}))
"""


@pytest.fixture(scope="module")
def fresh(tmp_path_factory):
    """What importing all modules changed in a process of its own, and the folder it had for all."""
    home, elsewhere = tmp_path_factory.mktemp("home"), tmp_path_factory.mktemp("elsewhere")
    folders = {"HOME": home, "TMPDIR": home / "tmp", "MPLCONFIGDIR": elsewhere}
    (home / "tmp").mkdir()
    kept = {
        k: v
        for k, v in os.environ.items()
        if not k.startswith(("XDG_", "NUMBA_", "ASTRAY_", "TMPDIR", "COV"))
    }
    known = kept | {name: str(path) for name, path in folders.items()}
    code, out, err = begin(PROGRAM, home, *MODULES, env=known).ended()
    assert code == 0, err
    return json.loads(out), home


def test_there_are_modules_of_every_folder():
    assert {"astray.kernel.jit", "astray.games.maze.rules", "astray.cli.verbs"} <= set(MODULES)


def test_importing_creates_nothing(fresh):
    # But matplotlib's list of fonts, which is where MPLCONFIGDIR says.
    assert [str(path.relative_to(fresh[1])) for path in fresh[1].rglob("*")] == ["tmp"]


def test_importing_sets_nothing(fresh):
    assert fresh[0] == {}


USERS = """
import astray.envs
import users

users.twice(3)
print(users.twice.stats.cache_path)
"""
FUNCTIONS = """
import numba

@numba.njit(cache=True)
def twice(x):
    return 2 * x
"""


def test_functions_of_the_users_own_are_kept_where_numba_keeps_them(tmp_path):
    (tmp_path / "users.py").write_text(FUNCTIONS)
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("XDG_", "NUMBA_"))}
    said = subprocess.run(
        [sys.executable, "-c", USERS],
        cwd=tmp_path,
        capture_output=True,
        text=True,
        check=True,
        env=kept | {"HOME": str(tmp_path)},
    ).stdout
    assert said.strip() == str(tmp_path / "__pycache__")
    assert len(list((tmp_path / "__pycache__").glob("users.*.nbc"))) == 1
    assert not (tmp_path / ".cache").exists()
