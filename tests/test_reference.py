"""The games are the originals, level by level and step by step."""

import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from astray import games
from astray.envs.vector import GameVectorEnv
from astray.game import Variant

MAZE, KEYS = games.load("maze").variants, games.load("keys").variants


@dataclass(frozen=True)
class Recorded:
    """What was recorded as which variant, and how its codes are drawn here."""

    game: str
    variant: Variant
    cells: dict[int, str]
    entities: dict[int, str]


def maze(variant):
    return Recorded("maze", variant, {100: ".", 51: "#", 2: "G", 3: "o"}, {})


def keys(name):
    return Recorded("keys", KEYS[name], {100: ".", 51: "#"}, {1: "C", 2: "k"})


RECORDED = {
    "maze": maze(MAZE["anywhere"]),
    "maze_easy": maze(MAZE["anywhere-easy"]),
    "maze_fixed_size": maze(MAZE["fixed-size"]),
    "maze_corner": maze(MAZE["corner"]),
    "maze_yellow_line": maze(MAZE["yellow-line"]),
    "maze_red_line_yellow_gem": maze(MAZE["red-line-yellow-gem"]),
    "maze_yellow_star_red_gem": maze(MAZE["yellow-star-red-gem"]),
    "keys_many_chests": keys("many-chests"),
    "keys_many_chests_penalties": keys("many-chests-penalties"),
    "keys_many_keys": keys("many-keys"),
    "keys_many_keys_easy": keys("many-keys-easy"),
} | {
    f"maze_region{side}": maze(replace(MAZE[f"region-{side}"], strict=True))
    for side in (1, 3, 8, 16)
}


def begin(name, levels):
    made = RECORDED[name]
    env = GameVectorEnv(
        made.game, made.variant, len(levels), observation="symbolic", autoreset_mode="Disabled"
    )
    env.reset(seed=0, options={"level": levels})
    return env


def recorded_grids(name, recorded):
    """The recorded cells and entities in this game's codes, [n, H, W]."""
    legend = games.load(RECORDED[name].game).legend
    codes = {theirs: legend[char] for theirs, char in RECORDED[name].cells.items()}
    grids = np.vectorize(codes.get)(recorded["grid"])
    for grid, entities in zip(grids, recorded["entities"], strict=True):
        for kind, _, x, y, *_ in entities:
            if kind in RECORDED[name].entities:
                grid[int(y), int(x)] = legend[RECORDED[name].entities[kind]]
    return grids


@pytest.mark.parametrize("name", RECORDED)
def test_levels_are_the_originals(name, reference: Path):
    recorded = np.load(reference / f"{name}.levels.npz")
    env = begin(name, recorded["seeds"])
    states = env.states
    grids = [env.game.describe(s)["grid"] for s in states]
    assert np.array_equal(grids, recorded_grids(name, recorded))
    assert np.array_equal(states["background"], recorded["background"])
    assert np.array_equal(states["background_offset"], recorded["background_offset"])
    assert np.array_equal(states["x"], recorded["entities"][:, 0, 2])
    assert np.array_equal(states["y"], recorded["entities"][:, 0, 3])
    if recorded["maze_size"].any():  # not recorded of keys
        assert np.array_equal(states["maze_size"], recorded["maze_size"])


@pytest.mark.parametrize("name", [name for name in RECORDED if name.startswith("keys")])
def test_objects_are_made_in_the_originals_order_and_places(name, reference: Path):
    recorded = np.load(reference / f"{name}.levels.npz")
    for s, entities in zip(
        begin(name, recorded["seeds"]).states, recorded["entities"], strict=True
    ):
        theirs = entities[np.isin(entities[:, 0], (1, 2))]
        assert np.array_equal(s.object_x[: s.objects], theirs[:, 2])
        assert np.array_equal(s.object_y[: s.objects], theirs[:, 3])


def same(reward, recorded):
    """Rewards are equal; a part of them was recorded to 4 digits."""
    return reward == recorded or round(float(reward), 4) == recorded


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
        assert (rewards.keys(), ended) == (episode["rewards"].keys(), episode["done"])
        assert all(same(reward, episode["rewards"][t]) for t, reward in rewards.items())
        assert env.states["time"][0] == episode["steps"]
        if ended:
            assert bool(terminated[0]) == bool(episode["complete"])
        np.testing.assert_allclose([x, y], [episode["x"], episode["y"]], atol=0.001)


def test_the_thief_speeds_up_turns_and_stops_as_the_originals(reference: Path):
    for trace in json.loads((reference / "keys.traces.json").read_text()):
        env = begin("keys_many_chests", [trace["seed"]])
        for action, place in zip(trace["actions"], trace["places"], strict=True):
            s = env.states[0]
            np.testing.assert_allclose([s.x, s.y, s.vx, s.vy], place, atol=1e-5)
            if action is not None:
                env.step(np.array([action]))
