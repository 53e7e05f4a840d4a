"""Environments that draw as the original, for each configuration whose frames were recorded."""

import hashlib
from dataclasses import replace

import numpy as np
import pytest

from astray.art import original
from astray.envs import vector
from astray.envs.compiled import loop_of
from astray.envs.vector import GameVectorEnv
from helpers.recorded import COINRUN, KEYS, MAZE, RECORDED

EASY = {"world": 15, "largest": 15}
DRAWN = RECORDED | {
    "maze_memory": MAZE["anywhere-memory"],
    "maze_corner_easy": MAZE["corner-easy"],
    "coinrun_aisc_easy": replace(COINRUN["coin-ledge-aisc"], easy=True),
    "keys_many_chests_easy": KEYS["many-chests-easy"],
    "keys_many_chests_memory": KEYS["many-chests-memory"],
    "keys_many_keys_memory": KEYS["many-keys-memory"],
    "procgen_coinrun": COINRUN["procgen"],
    "procgen_coinrun_easy": COINRUN["procgen-easy"],
    "procgen_maze": MAZE["anywhere"],
    "procgen_maze_easy": MAZE["anywhere-easy"],
}
DRAWN |= {
    f"maze_{name}_easy": replace(RECORDED[f"maze_{name}"], **EASY)
    for name in ("yellow_line", "red_line_yellow_gem", "yellow_star_red_gem")
}
MISSING = set(original.missing())


def environment(variant, n=1, **options):
    """An environment that draws as the original; skips where its pictures are not at hand."""
    game = type(variant).__name__.lower()
    if MISSING - set(original.FORK_ALONE):
        pytest.skip(f"the original's pictures are not in {original.folder()}: astray art import")
    if MISSING and "line" in (getattr(variant, "goal_shape", ""),):
        pytest.skip("the lines are in the paper's fork alone: astray art import CHECKOUT")
    return GameVectorEnv(game, variant, n, art="original", autoreset_mode="Disabled", **options)


def digest(image):
    return hashlib.sha256(image.tobytes()).hexdigest()[:16]


def interpreted(variant, episodes, monkeypatch):
    """Digests of every fourth frame, recorded and drawn by interpreted code, and all ends.

    To compile how a game is drawn takes 8 to 18 seconds, and an interpreted frame 20 to 30 ms. An
    end is the reward of an episode and whether it ended.
    """
    game = type(variant).__name__.lower()
    env = GameVectorEnv(game, variant, 1, observation="symbolic", autoreset_mode="Disabled")
    states, recorded, ends = [], [], []
    for episode in episodes:
        env.reset(seed=0, options={"level": episode["level"]})
        seen, total, over = [env.get_state()], 0.0, False
        for action in episode["actions"]:
            assert not over, "actions after the end"
            _, reward, terminated, truncated, _ = env.step(np.array([int(action)]))
            seen, total = [*seen, env.get_state()], total + reward[0]
            over = bool(terminated[0] or truncated[0])
        some = [*episode["frames"].items()][::4]
        states += [seen[int(step)] for step, _ in some]
        recorded += [frame for _, frame in some]
        ends.append((total, over))
    monkeypatch.setattr(vector, "compiled_loop", lambda *of: loop_of(*of).py_func)
    images = environment(variant, len(states)).set_state(np.concatenate(states))
    return [digest(image) for image in images], recorded, ends
