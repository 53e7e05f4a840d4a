"""Maze is the original's, level by level and step by step."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from astray import games
from astray.envs.vector import GameVectorEnv
from astray.games.maze.rules import EMPTY, GOAL, OTHER, WALL

VARIANTS = games.load("maze").variants
RECORDED = {
    "maze": VARIANTS["anywhere"],
    "maze_easy": VARIANTS["anywhere-easy"],
    "maze_fixed_size": VARIANTS["fixed-size"],
    "maze_corner": VARIANTS["corner"],
    "maze_yellow_line": VARIANTS["yellow-line"],
    "maze_red_line_yellow_gem": VARIANTS["red-line-yellow-gem"],
    "maze_yellow_star_red_gem": VARIANTS["yellow-star-red-gem"],
} | {
    f"maze_region{side}": replace(VARIANTS[f"region-{side}"], strict=True) for side in (1, 3, 8, 16)
}
CELLS = {100: EMPTY, 51: WALL, 2: GOAL, 3: OTHER}


def begin(name, levels):
    env = GameVectorEnv(
        "maze", RECORDED[name], len(levels), observation="symbolic", autoreset_mode="Disabled"
    )
    env.reset(seed=0, options={"level": levels})
    return env


@pytest.mark.parametrize("name", RECORDED)
def test_levels_are_the_originals(name, reference: Path):
    recorded = np.load(reference / f"{name}.levels.npz")
    states = begin(name, recorded["seeds"]).states
    side = RECORDED[name].world
    expected = np.vectorize(CELLS.get)(recorded["grid"])
    assert np.array_equal(states["cell"][:, :side, :side], expected)
    assert np.array_equal(states["background"], recorded["background"])
    assert np.array_equal(states["maze_size"], recorded["maze_size"])
    assert np.array_equal(states["background_offset"], recorded["background_offset"])
    assert np.array_equal(states["x"], recorded["entities"][:, 0, 2])
    assert np.array_equal(states["y"], recorded["entities"][:, 0, 3])


@pytest.mark.parametrize("name", RECORDED)
def test_episodes_go_as_the_originals(name, reference: Path):
    lines = (reference / f"{name}.episodes.jsonl").read_text().splitlines()
    for episode in map(json.loads, lines):
        env = begin(name, [episode["seed"]])
        x, y, rewards, ended = [], [], {}, False
        for t, action in enumerate(episode["actions"]):
            assert not ended, "actions after the end"
            _, reward, terminated, truncated, _ = env.step(np.array([action]))
            ended = bool(terminated[0] or truncated[0])
            if reward[0]:
                rewards[str(t)] = reward[0]
            if t % 5 == 0 and not ended:
                x.append(env.states["x"][0])
                y.append(env.states["y"][0])
        assert (rewards, ended) == (episode["rewards"], episode["done"])
        assert env.states["time"][0] == episode["steps"]
        if ended:
            assert bool(terminated[0]) == bool(episode["complete"])
        np.testing.assert_allclose([x, y], [episode["x"], episode["y"]], atol=0.001)
