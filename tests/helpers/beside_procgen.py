"""Play Procgen as released and our variants side by side; exit with 1 where anything differs.

    pip install --no-deps gym3 cffi pycparser
    astray art import
    python tests/helpers/beside_procgen.py WHEEL [--levels 60] [--steps 150]

WHEEL is procgen-0.10.7-cp310-...whl, whose program is no part of Python. Gym3, which
drives it, asks for an older NumPy than it needs. Compared are all pixels of all frames, rewards and
ends, with the same random held actions in the same levels.
"""

import argparse
import sys
import tempfile
import types
import zipfile
from pathlib import Path

import numpy as np

from astray.envs.vector import GameVectorEnv

TWINS = {
    ("coinrun", "hard"): "procgen",
    ("coinrun", "easy"): "procgen-easy",
    ("maze", "hard"): "anywhere",
    ("maze", "easy"): "anywhere-easy",
    ("heist", "hard"): "hard",
    ("heist", "easy"): "easy",
    ("heist", "memory"): "memory",
}
LIKELY = {  # actions
    "coinrun": [7, 7, 8, 8, 1, 2, 4, 5, 0, 3],
    "maze": list(range(9)),
    "heist": list(range(9)),
}
HELD = {"coinrun": 7, "maze": 3, "heist": 7}  # steps, at most


def held_actions(game: str, steps: int, random: np.random.Generator) -> np.ndarray:
    """Actions [steps], each held for a while."""
    actions = [
        action
        for action in random.choice(LIKELY[game], steps)
        for _ in range(random.integers(1, HELD[game] + 1))
    ]
    return np.array(actions[:steps])


def differences(theirs, ours: GameVectorEnv, level: int, actions: np.ndarray) -> tuple[int, int]:
    """Frames compared in one episode, and frames or steps that differ."""
    _, seen, _ = theirs.observe()
    images, _ = ours.reset(seed=0, options={"level": level})
    frames, different = 1, int(not np.array_equal(seen["rgb"], images))
    for action in actions:
        theirs.act(np.array([action]))
        reward, seen, first = theirs.observe()
        images, own, terminated, truncated, _ = ours.step(np.array([action]))
        over = bool(terminated[0] or truncated[0])
        different += reward[0] != own[0] or bool(first[0]) != over
        if over or first[0]:
            break
        frames, different = frames + 1, different + int(not np.array_equal(seen["rgb"], images))
    return frames, different


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("wheel", type=Path)
    parser.add_argument("--levels", type=int, default=60)
    parser.add_argument("--steps", type=int, default=150)
    given, wrong = parser.parse_args(), 0
    with tempfile.TemporaryDirectory() as folder:
        zipfile.ZipFile(given.wheel).extractall(folder)
        sys.path.insert(0, folder)
        # Its environments are to be registered with Gym, which is not needed here.
        registration = types.ModuleType("procgen.gym_registration")
        registration.register_environments = lambda: None  # pyrefly: ignore
        sys.modules["procgen.gym_registration"] = registration
        from procgen import ProcgenGym3Env  # pyrefly: ignore

        for (game, mode), variant in TWINS.items():
            random, frames, different = np.random.default_rng(0), 0, 0
            ours = GameVectorEnv(game, variant, art="original", autoreset_mode="Disabled")
            for level in random.integers(2**31 - 1, size=given.levels):
                theirs = ProcgenGym3Env(
                    num=1,
                    env_name=game,
                    start_level=int(level),
                    num_levels=1,
                    distribution_mode=mode,
                )
                actions = held_actions(game, given.steps, random)
                found = differences(theirs, ours, int(level), actions)
                frames, different = frames + found[0], different + found[1]
                theirs.close()
            print(f"{game} {mode}, {variant}: {frames:,} frames, {different} differ")
            wrong += different
    sys.exit(1 if wrong else 0)


if __name__ == "__main__":
    main()
