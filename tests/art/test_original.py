"""With the original's pictures, images are the original's in every pixel."""

import json
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from astray import games
from astray.acting import Turn
from astray.agents.policy import Architecture, weights
from astray.analysis.runs import open_run
from astray.analysis.trained import Agent
from astray.envs.pictures import picture
from astray.envs.vector import GameVectorEnv
from astray.games.maze.variants import Maze
from astray.training.config import Config
from helpers import processes
from helpers.cases import REFERENCE
from helpers.drawn import DRAWN, digest, environment, interpreted
from helpers.recorded import RECORDED
from helpers.thorough import thorough

FRAMES = json.loads((REFERENCE / "frames.json").read_text())


OF_KEYS = [name for name in FRAMES if name.startswith("keys")]


@pytest.mark.parametrize("name", OF_KEYS)
def test_interpreted_frames_are_the_originals(name, monkeypatch):
    drawn, recorded, _ = interpreted(DRAWN[name], FRAMES[name], monkeypatch)
    assert drawn == recorded


@pytest.mark.parametrize("name", [*sorted(FRAMES.keys() - OF_KEYS), *thorough(*OF_KEYS)])
def test_frames_are_the_originals(name):
    for episode in FRAMES[name]:
        env = environment(DRAWN[name])
        images, _ = env.reset(seed=0, options={"level": episode["level"]})
        found = {"0": digest(images[0])}
        for t, action in enumerate(episode["actions"], 1):
            images, *_ = env.step(np.array([int(action)]))
            found[str(t)] = digest(images[0])
        differ = [t for t, frame in episode["frames"].items() if found[t] != frame]
        assert not differ, f"level {episode['level']}, steps {differ}"


def test_every_configuration_was_recorded():
    assert set(FRAMES) >= {name for name in RECORDED if "region" not in name} - {
        "coinrun_random50",
        "keys_many_chests_penalties",
    }
    assert all(sum(len(e["frames"]) for e in episodes) >= 72 for episodes in FRAMES.values())


INTERPRETED = """
import sys, numpy as np
from helpers.drawn import DRAWN, digest, environment
for name in ("coinrun", "maze_memory", "keys_many_keys"):
    env = environment(DRAWN[name])
    images, _ = env.reset(seed=0, options={"level": 7})
    print(digest(images[0]))
    for action in (8, 8, 1, 1):
        images, *_ = env.step(np.array([action]))
    print(digest(images[0]))
"""


@pytest.mark.thorough  # `test_contract` interprets a few steps of each shape
def test_interpreted_code_draws_the_same():
    environment(DRAWN["coinrun"])
    said = [
        subprocess.run(
            [sys.executable, "-c", INTERPRETED],
            env=processes.environment(NUMBA_DISABLE_JIT=disabled),
            capture_output=True,
            check=True,
        ).stdout
        for disabled in ("0", "1")
    ]
    assert said[0] == said[1] and len(said[0].split()) == 6


@pytest.mark.parametrize("name", ["coinrun", "maze_memory", *thorough("keys_many_keys")])
@pytest.mark.parametrize("pixels", [64, 63, 130, 512])
def test_pictures_for_people_have_the_same_things_at_any_scale(pixels, name):
    env = environment(DRAWN[name], 2)
    images, _ = env.reset(seed=0, options={"level": [3, 4]})
    shown = env.picture(pixels)
    assert shown.shape == (2, pixels, pixels, 3)
    assert pixels != 64 or np.array_equal(shown, images)
    small = [
        np.array(Image.fromarray(one).resize((8, 8), Image.Resampling.BOX), int)
        for one in (*shown, *images)
    ]
    # Nearest pixels of fine pictures are speckled at 64 pixels; their means are alike.
    assert np.abs(small[0] - small[2]).mean() < 16 and np.abs(small[1] - small[3]).mean() < 16


def test_versions_of_qt_differ_in_a_few_pixels():
    """Since 5.13 backgrounds are found by another formula."""
    shown = []
    for art in ("original", "original-5.12"):
        environment(DRAWN["coinrun"])
        env = GameVectorEnv("coinrun", "coin-end", 64, art=art)
        shown.append(env.reset(seed=0, options={"level": np.arange(64)})[0])
    different = (shown[0] != shown[1]).any(-1)
    assert 0 < different.any((1, 2)).mean() < 0.5 and different.mean() < 0.01


def test_a_goal_that_was_reached_is_gone_and_what_is_next_is_painted():
    for name in ("maze", "maze_memory"):
        env = environment(DRAWN[name])
        env.reset(seed=0, options={"level": 5})
        states = env.get_state()
        x, y = int(states["goal_x"][0]), int(states["goal_y"][0])
        states["x"], states["y"] = x + 0.5, y + 0.5
        on_goal = env.set_state(states)
        states["reached_goal"], states["cell"][0, y, x] = states["time"], 0
        assert not np.array_equal(env.set_state(states), on_goal)


def test_symbols_need_no_pictures(tmp_path, monkeypatch):
    monkeypatch.setenv("ASTRAY_ART", str(tmp_path))
    env = GameVectorEnv("coinrun", "coin-end", 2, observation="symbolic", art="original")
    env.reset(seed=0)


EARLY = """
import sys

import astray
from astray.analysis import video
from astray.analysis.policies import Random
from astray.analysis.runs import open_run
from astray.cli import verbs
from astray.experiments import catalogue, run
from astray.experiments.compare import compare

MAZE = "--game maze --variant corner-small --observation symbolic --art original"


def verb(words):
    sys.argv = ["astray", *words.split()]
    verbs.run()


symbols = astray.Function(len, "right", "symbolic", "original")
for ask in (
    lambda: open_run("maze-corner", art="original"),  # which sees symbols
    lambda: astray.audit(symbols, "maze", "corner-small"),
    lambda: video.play(symbols, "maze", "corner-small", 5),
    lambda: compare([symbols, Random()], "maze", "corner-small", range(9), "compared"),
    lambda: verb(f"explain --policy random --shift corner-small {MAZE} --level 5"),
    lambda: verb(f"record --policy random {MAZE} --level 5"),
    lambda: run.reproduce_each(["maze-corner", "maze-region"], "smoke", "reports", art="original"),
    lambda: catalogue.load("maze-corner").sizes["smoke"].drawn_with("original"),
):
    try:
        ask()
    except FileNotFoundError as error:
        print(error)
"""


def test_pictures_of_videos_are_missed_before_the_work(tmp_path):
    """In a process of its own: this one may have read the pictures."""
    (there := tmp_path / "there").mkdir()
    env = processes.environment(ASTRAY_ART=str(tmp_path / "none"))
    code, told, _ = processes.begin(EARLY, there, env=env).ended()
    assert code == 0 and told.count("the original's pictures are not in") == 8


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"goal_shape": "ring", "goal_colour": "blue"}, "the original has no blue ring; it"),
        ({"walls": "hedge"}, "the original has walls of sand alone; these are of hedge"),
    ],
)
def test_what_the_original_never_drew_is_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        games.find("maze").drawn("original").art(replace(Maze(about=""), **changes), 64)


def test_unknown_art_is_refused():
    with pytest.raises(ValueError, match="unknown art 'stock' of maze; there are: own, original"):
        GameVectorEnv("maze", "corner", art="stock")


def test_an_agent_is_shown_what_it_was_trained_on(tmp_path):
    architecture = Architecture("impala", (64, 64, 3), (), 15)
    (tmp_path / "agent.safetensors").write_bytes(
        weights(architecture.build(), architecture, "maze")
    )
    agent = Agent(tmp_path / "agent.safetensors", "maze", art="original")
    env = GameVectorEnv("maze", "anywhere-small", 2)
    images, _ = env.reset(seed=0)
    with pytest.raises(
        ValueError, match="is to see art 'original'; these images are drawn with 'own'"
    ):
        agent.actions(Turn.of(env, images))
    agent.art = "own"
    assert agent.actions(Turn.of(env, images)).actions.shape == (2,)


def test_runs_say_what_they_were_trained_on_and_another_is_shown_where_asked_for(tmp_path):
    from astray.training import checkpoint

    config = Config(
        observation="symbolic", network="mlp", art="original", num_envs=8, minibatches=1
    )
    folder = tmp_path / "checkpoints" / "8"
    folder.mkdir(parents=True)
    written = {"config": config.to_json()}
    (tmp_path / "config.json").write_text(json.dumps(written))
    architecture = Architecture("mlp", (4, 25, 25), (1, 1, 6, 6), 15, width=config.width)
    network = architecture.build()
    (folder / checkpoint.AGENT).write_bytes(weights(network, architecture, "maze"))
    assert open_run(tmp_path)[0].art == "original"
    assert open_run(tmp_path, art="own")[0].art == "own"
    with pytest.raises(ValueError, match="unknown art 'stock' of maze"):
        open_run(tmp_path, art="stock")
    del written["config"]["art"]  # of a run older than the setting
    (tmp_path / "config.json").write_text(json.dumps(written))
    assert open_run(tmp_path)[0].art == "own"


def test_states_are_pictured_with_the_art_that_is_asked_for():
    env = environment(DRAWN["maze"])
    images, _ = env.reset(seed=0)
    assert np.array_equal(picture("maze", env.variant, env.states, 64, "original"), images)
    assert not np.array_equal(picture("maze", env.variant, env.states, 64), images)
