"""What a package of one's own tests."""

from dataclasses import replace

import numpy as np
import pytest
from open_room.game import GAME
from open_room.study import EXPERIMENT, MOUSE

from astray import games, testing
from astray.analysis.adapters import Function
from astray.analysis.runs import evaluate_policies, evaluate_runs
from astray.experiments.run import reproduce
from astray.training.loop import train

TINY = replace(MOUSE, num_envs=16, num_steps=32, minibatches=2, steps=1024)
WRITTEN = pytest.mark.filterwarnings("ignore:.*as it is written")


def test_it_is_a_game():
    testing.check_game(GAME)


def test_it_is_found_by_its_name():
    assert games.find("open-room") is GAME and "open-room" in games.names()


@WRITTEN
def test_network_and_loss_train_and_are_loaded_again(tmp_path):
    train(TINY, tmp_path / "seed-0", progress=False)
    rates, episodes = evaluate_runs([tmp_path / "seed-0"], np.arange(50))
    assert set(episodes["outcome"].unique()) and len(rates)
    assert '"update/size"' in (tmp_path / "seed-0" / "metrics.jsonl").read_text()


def test_a_function_is_a_policy():
    up_and_right = Function(
        lambda planes: np.where(planes[:, 0].any(2).argmax(1) > 0, 4, 2),
        "up, then right",
        "symbolic",
    )
    rates, _ = evaluate_policies([up_and_right], GAME, "corner", np.arange(100))
    assert "up, then right" in rates["policy"].to_list()


@WRITTEN
def test_the_experiment_runs_whole(tmp_path):
    plan = replace(EXPERIMENT.sizes["smoke"], agents={"mouse": TINY}, levels=20)
    small = replace(EXPERIMENT, sizes={"smoke": plan})
    assert reproduce(small, "smoke", tmp_path, workers=1).read_text().count("open room")
