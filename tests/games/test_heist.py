"""Heist is the released program's, frame by frame, to the end of its episodes."""

import json

import numpy as np
import pytest

from helpers.cases import REFERENCE
from helpers.drawn import digest, environment, interpreted
from helpers.recorded import HEIST

RECORDED = json.loads((REFERENCE / "heist.json").read_text())


@pytest.mark.parametrize("mode", RECORDED)
def test_episodes_end_as_the_originals_and_interpreted_frames_are_theirs(mode, monkeypatch):
    drawn, recorded, ends = interpreted(HEIST[mode], RECORDED[mode], monkeypatch)
    assert ends == [(episode["reward"], episode["done"]) for episode in RECORDED[mode]]
    assert drawn == recorded


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
