"""The games are the originals, level by level and step by step."""

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import zip_longest
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from astray.envs.vector import GameVectorEnv
from astray.games.coinrun import rules as coinrun
from astray.games.keys import rules as keys
from astray.games.maze import rules as maze
from astray.kernel.maze import WALL
from helpers.cases import REFERENCE
from helpers.recorded import RECORDED


@dataclass(frozen=True)
class Translation:
    """How recordings of the original say what a game's state says."""

    cells: Mapping[int, int]  # the original's value -> the game's
    fields: Mapping[str, str]  # recorded for a level -> in the state
    things: Callable[[Any], list] | None = None  # (type, look, x, y, vx) in a state


def coinrun_things(s: Any) -> list:
    saws, crates = np.argwhere(s.thing == coinrun.SAW), np.argwhere(s.thing == coinrun.CRATE)
    w = slice(s.walkers)
    looks = [(x, y, *divmod(s.detail[y, x], 4)) for y, x in crates]
    return sorted(
        [(2, 0, x + 0.5, y + 0.5, 0) for y, x in saws]
        + [(20, look, x + 0.5, y + 0.5, 0) for x, y, _, look in looks]
        + [(20, before - 1, x + 0.5, y + 0.5, 0) for x, y, before, _ in looks if before]
        + [
            (5, *walker)
            for walker in zip(
                s.walker_look[w], s.walker_x[w], s.walker_y[w], s.walker_vx[w], strict=True
            )
        ]
    )


def recorded_things(entities: np.ndarray) -> list:
    """What stands and walks about."""
    return sorted((k, look, x, y, vx) for k, look, x, y, vx in entities[1:, :5] if not np.isnan(k))


TRANSLATIONS = {
    "maze": Translation(
        cells={100: maze.EMPTY, 51: WALL, 2: maze.GOAL, 3: maze.OTHER},
        fields={"maze_size": "maze_size"},
    ),
    "coinrun": Translation(
        cells={
            100: coinrun.EMPTY, 15: coinrun.WALL, 16: coinrun.TOP, 17: coinrun.LAVA,
            18: coinrun.LAVA_TOP, 19: coinrun.BARRIER, 1: coinrun.COIN, -1: coinrun.INVISIBLE,
            -15: coinrun.PERMEABLE,
        },
        fields={"wall_theme": "ground"},
        things=coinrun_things,
    ),
    "keys": Translation(cells={100: keys.EMPTY, 51: WALL}, fields={}),
}  # fmt: skip


def begin(name, levels, autoreset_mode="Disabled"):
    game = name.split("_")[0]
    options = {"observation": "symbolic", "autoreset_mode": autoreset_mode}
    env = GameVectorEnv(game, RECORDED[name], len(levels), **options)
    env.reset(seed=0, options={"level": levels})
    return env, TRANSLATIONS[game]


@pytest.mark.parametrize("name", RECORDED)
def test_levels_are_the_originals(name, reference: Path):
    recorded = np.load(reference / f"{name}.levels.npz")
    env, translation = begin(name, recorded["seeds"])
    states, side = env.states, recorded["grid"].shape[1]
    expected = np.vectorize(translation.cells.get)(recorded["grid"])
    assert np.array_equal(states["cell"][:, :side, :side], expected)
    for theirs, ours in {"background": "background", **translation.fields}.items():
        assert np.array_equal(states[ours], recorded[theirs])
    assert np.array_equal(states["background_offset"], recorded["background_offset"])
    assert np.array_equal(states["x"], recorded["entities"][:, 0, 2])
    assert np.array_equal(states["y"], recorded["entities"][:, 0, 3])
    for s, entities in zip(states, recorded["entities"], strict=True):
        if translation.things:
            assert translation.things(s) == recorded_things(entities)


@pytest.mark.parametrize("name", [name for name in RECORDED if name.startswith("keys")])
def test_objects_are_made_in_the_originals_order_and_places(name, reference: Path):
    recorded = np.load(reference / f"{name}.levels.npz")
    env, _ = begin(name, recorded["seeds"])
    codes = {1: keys.CHEST, 2: keys.KEY}
    for s, entities in zip(env.states, recorded["entities"], strict=True):
        theirs = entities[np.isin(entities[:, 0], list(codes))]
        assert s.what[: s.objects].tolist() == [codes[kind] for kind in theirs[:, 0]]
        assert np.array_equal(s.object_x[: s.objects], theirs[:, 2])
        assert np.array_equal(s.object_y[: s.objects], theirs[:, 3])


def same(reward, recorded):
    """Rewards are equal; a part of them was recorded to 4 digits."""
    return reward == recorded or round(float(reward), 4) == recorded


@pytest.mark.parametrize("name", RECORDED)
def test_episodes_go_as_the_originals(name, reference: Path):
    lines = (reference / f"{name}.episodes.jsonl").read_text().splitlines()
    episodes = [json.loads(line) for line in lines]
    # All at once; one whose recording is over plays on unseen, in another level if it has ended.
    env, _ = begin(name, [episode["seed"] for episode in episodes], autoreset_mode="NextStep")
    actions = zip_longest(*(episode["actions"] for episode in episodes), fillvalue=0)
    fields = [f for f in ("x", "y", "time", "took_invisible") if f in env.states.dtype.names]
    seen = []
    for action in actions:
        _, reward, terminated, truncated, _ = env.step(np.array(action))
        seen.append((env.states[fields].copy(), reward, terminated, terminated | truncated))
    states, rewards, terminated, ended = map(np.array, zip(*seen, strict=True))
    for n, episode in enumerate(episodes):
        last = len(episode["actions"]) - 1
        assert not ended[:last, n].any(), "actions after the end"
        paid = {str(t): rewards[t, n] for t in np.flatnonzero(rewards[: last + 1, n])}
        done, state = ended[last, n], states[last, n]
        assert (paid.keys(), done) == (episode["rewards"].keys(), episode["done"])
        assert all(same(reward, episode["rewards"][t]) for t, reward in paid.items())
        assert state["time"] == episode["steps"]
        if done:  # an end by the rules is a success, or in CoinRun a death, without reward
            success = terminated[last, n] and rewards[last, n] > 0
            assert success == bool(episode["complete"])
        if done and "took_invisible" in fields:
            assert (state["took_invisible"] >= 0) == bool(episode["invisible_coin"])
        recorded = states[: last + (not done) : 5, n]
        np.testing.assert_allclose(recorded["x"], episode["x"], atol=0.001)
        np.testing.assert_allclose(recorded["y"], episode["y"], atol=0.001)


def coinrun_traces() -> dict:
    traces = json.loads((REFERENCE / "physics_traces.json").read_text())
    return {name: trace for name, trace in traces.items() if isinstance(trace, list)}


@pytest.mark.parametrize("name", [n for n in coinrun_traces() if n.startswith("coinrun")])
def test_the_runner_moves_as_the_originals(name):
    env, _ = begin("coinrun", [3])
    for point in coinrun_traces()[name][1:]:
        env.step(np.array([point["action"]]))
        s = env.states[0]
        expected = [point[axis] for axis in ("x", "y", "vx", "vy")]
        np.testing.assert_allclose([s.x, s.y, s.vx, s.vy], expected, atol=1e-6)


def test_walkers_turn_and_slow_down_as_the_originals(reference: Path):
    lines = (reference / "coinrun.walkers.jsonl").read_text().splitlines()
    for episode in map(json.loads, lines):
        env, _ = begin("coinrun", [episode["level"]])
        recorded = iter(zip(episode["runner"], episode["walkers"], strict=True))
        for t, action in enumerate(episode["actions"]):
            _, _, terminated, _, _ = env.step(np.array([action]))
            s, last = env.states[0], t == len(episode["actions"]) - 1
            assert bool(terminated[0]) == (last and episode["done"])
            if t % 10 == 0 and not terminated[0]:
                runner, walkers = next(recorded)
                np.testing.assert_allclose([s.x, s.y], runner, atol=6e-5)  # of 4 digits
                ours = np.stack([s.walker_x, s.walker_vx], 1)[: s.walkers]
                np.testing.assert_allclose(ours, walkers, atol=6e-5)
        assert next(recorded, None) is None


def test_the_thief_speeds_up_turns_and_stops_as_the_originals(reference: Path):
    for trace in json.loads((reference / "keys.traces.json").read_text()):
        env, _ = begin("keys_many_chests", [trace["seed"]])
        for action, place in zip(trace["actions"], trace["places"], strict=True):
            s = env.states[0]
            np.testing.assert_allclose([s.x, s.y, s.vx, s.vy], place, atol=1e-5)
            if action is not None:
                env.step(np.array([action]))
