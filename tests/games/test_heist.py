"""Heist is the released program's, frame by frame, to the end of its episodes."""

import json

import numpy as np
import pytest

from astray.envs import vector
from astray.envs.compiled import loop_of
from astray.envs.vector import GameVectorEnv
from helpers.cases import REFERENCE
from helpers.drawn import digest, environment
from helpers.recorded import HEIST

RECORDED = json.loads((REFERENCE / "heist.json").read_text())


@pytest.mark.parametrize("mode", RECORDED)
def test_episodes_end_as_the_originals_and_interpreted_frames_are_theirs(mode, monkeypatch):
    """To compile how the game is drawn takes 18 seconds, and an interpreted frame 30 ms."""
    env = GameVectorEnv("heist", HEIST[mode], 1, observation="symbolic", autoreset_mode="Disabled")
    states, frames = [], []
    for episode in RECORDED[mode]:
        env.reset(seed=0, options={"level": episode["level"]})
        seen, total, over = [env.get_state()], 0.0, False
        for action in episode["actions"]:
            assert not over, "actions after the end"
            _, reward, terminated, truncated, _ = env.step(np.array([int(action)]))
            seen, total = [*seen, env.get_state()], total + reward[0]
            over = bool(terminated[0] or truncated[0])
        assert (total, over) == (episode["reward"], episode["done"])
        states += [seen[int(step)] for step in [*episode["frames"]][::4]]
        frames += [*episode["frames"].values()][::4]
    monkeypatch.setattr(vector, "compiled_loop", lambda *of: loop_of(*of).py_func)
    images = environment(HEIST[mode], len(states)).set_state(np.concatenate(states))
    assert [digest(image) for image in images] == frames


@pytest.mark.thorough  # the test before
@pytest.mark.parametrize("mode", RECORDED)
def test_episodes_and_frames_are_the_originals(mode):
    env = environment(HEIST[mode])
    for episode in RECORDED[mode]:
        images, _ = env.reset(seed=0, options={"level": episode["level"]})
        found, total, over = {"0": digest(images[0])}, 0.0, False
        for t, action in enumerate(episode["actions"], 1):
            assert not over, "actions after the end"
            images, reward, terminated, truncated, _ = env.step(np.array([int(action)]))
            found[str(t)], total = digest(images[0]), total + reward[0]
            over = bool(terminated[0] or truncated[0])
        assert (total, over) == (episode["reward"], episode["done"])
        assert episode["frames"].items() <= found.items(), f"level {episode['level']}"


def test_keys_were_taken_and_gems_reached_in_what_was_recorded():
    for mode, episodes in RECORDED.items():
        assert len(episodes) == 12 and sum(e["done"] for e in episodes) > 9, mode
        assert sum(len(e["frames"]) for e in episodes) > 90
