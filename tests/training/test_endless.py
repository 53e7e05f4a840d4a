"""A life without end is trained on, and told by the reward of a step."""

import pytest

from astray import games
from astray.training import checkpoint
from astray.training.loop import iterate
from helpers import lava
from helpers.trainings import PLAIN


@pytest.mark.parametrize("groups", [1, 2])
def test_the_reward_of_a_step_is_told_of_a_training_in_which_no_episode_ends(
    groups, tmp_path, monkeypatch
):
    monkeypatch.setattr(games, "_registered", {"lava": lava.GAME})
    config = PLAIN.changed(game="lava", variant="for-ever", knobs={}, steps=512, groups=groups)
    steps = apples = 0
    for iteration in iterate(config, tmp_path, progress=False):
        states = iteration.trainer.player.envs[0].states
        assert not states["ended"].any() and "training/return" not in iteration.metrics
        new = sum(int(env.states["apples"].sum()) for env in iteration.trainer.player.envs)
        by_hand = 0.1 * (new - apples) / (iteration.steps - steps)
        assert iteration.metrics["training/reward_per_step"] == pytest.approx(by_hand, rel=1e-9)
        steps, apples = iteration.steps, new
    assert apples > 0
    assert all("training/reward_per_step" in line for line in checkpoint.metrics(tmp_path))
