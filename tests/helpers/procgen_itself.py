"""Play Procgen's program and our face of it side by side; exit with 1 where anything differs.

    pip install --no-deps gym3 cffi pycparser
    astray art import
    python -m helpers.procgen_itself WHEEL [--steps 2000]     # in the folder of tests

Compared are images, rewards, ends and infos of 8 environments with the same `rand_seed`, so also
the order of levels.
"""

import argparse
import sys
import tempfile
import types
import zipfile
from pathlib import Path

import gymnasium
import numpy as np

from astray.compat import ProcgenEnv

CASES = [
    ("coinrun", {}),
    ("coinrun", {"distribution_mode": "easy", "num_levels": 3, "start_level": 5}),
    ("maze", {"distribution_mode": "easy"}),
    ("maze", {"num_levels": 200}),
    ("maze", {"distribution_mode": "memory"}),
    ("maze", {"distribution_mode": "easy", "use_sequential_levels": True}),
    ("coinrun", {"use_sequential_levels": True, "num_levels": 10}),
    ("coinrun", {"distribution_mode": "exploration"}),
    ("heist", {}),
    ("heist", {"distribution_mode": "easy", "num_levels": 5}),
    ("heist", {"distribution_mode": "memory", "use_sequential_levels": True}),
    ("heist", {"distribution_mode": "exploration"}),
]


def unpack(wheel: Path, folder: str) -> type:
    """Procgen's own environments, out of its wheel."""
    zipfile.ZipFile(wheel).extractall(folder)
    sys.path.insert(0, folder)
    # They are to be registered with Gym, and to have its spaces; Gymnasium's are the same.
    sys.modules["gym"], sys.modules["gym.spaces"] = gymnasium, gymnasium.spaces
    registration = types.ModuleType("procgen.gym_registration")
    registration.register_environments = lambda: None  # pyrefly: ignore
    sys.modules["procgen.gym_registration"] = registration
    from procgen import ProcgenEnv as Theirs  # pyrefly: ignore

    return Theirs


def differences(theirs, ours, steps: int, forced: bool) -> tuple[int, int, int]:
    """Episodes ended, levels completed, and steps in which anything differs."""
    random = np.random.default_rng(1)
    one, two = theirs.reset(), ours.reset()
    wrong, ended, complete = int(not np.array_equal(one["rgb"], two["rgb"])), 0, 0
    actions = random.choice([7, 7, 8, 1, 5, 2, 3], ours.num_envs)
    for _ in range(steps):
        held = random.random(ours.num_envs) < 0.7
        actions = np.where(held, actions, random.integers(0, 15, ours.num_envs))
        taken = np.where(random.random(ours.num_envs) < 0.01 * forced, -1, actions)
        one, two = theirs.step(taken), ours.step(taken)
        same = (
            np.array_equal(one[0]["rgb"], two[0]["rgb"])
            and one[1].dtype == two[1].dtype
            and np.array_equal(one[1], two[1])
            and np.array_equal(one[2], two[2])
            and all(a == b for a, b in zip(one[3], two[3], strict=True))
        )
        wrong, ended = wrong + (not same), ended + int(two[2].sum())
        complete += sum(int(info["prev_level_complete"]) for info in two[3])
    return ended, complete, wrong


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--steps", type=int, default=2000)
    given, wrong = parser.parse_args(), 0
    with tempfile.TemporaryDirectory() as folder:
        Theirs = unpack(given.wheel, folder)
        for name, options in CASES:
            for forced in (False, True):
                both = [
                    make(num_envs=8, env_name=name, rand_seed=7, **options)
                    for make in (Theirs, ProcgenEnv)
                ]
                ended, complete, differ = differences(*both, given.steps, forced)
                told = f"{ended} episodes ended, {complete} complete, {differ} steps differ"
                print(f"{name} {options} forced {forced}: {8 * given.steps:,} frames, {told}")
                wrong += differ
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
