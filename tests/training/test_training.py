"""Training: it learns, repeats itself, and goes on after a stop as if there had been none."""

import contextlib
import json
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from safetensors.numpy import load_file

from astray import games
from astray.agents.policy import usable
from astray.training import checkpoint, trainer
from astray.training.config import PRESETS
from astray.training.log import Log
from astray.training.loop import iterate, train
from helpers.trainings import TINY, digest, train_to_first_checkpoint


def test_a_run_holds_what_it_should(tmp_path):
    last = train(TINY, tmp_path, progress=False)
    assert last == tmp_path / "checkpoints" / "1024"
    config = json.loads((tmp_path / "config.json").read_text())
    assert config["config"]["training_variant"]["largest"] == 5
    assert checkpoint.read_config(tmp_path) == TINY
    lines = checkpoint.metrics(tmp_path)
    assert [line["steps"] for line in lines] == [256, 512, 768, 1024]
    assert {"training/return", "validation/return", "update/entropy"} <= lines[-1].keys()
    assert list((tmp_path / "tensorboard").iterdir())
    assert not list(tmp_path.rglob(".*safetensors"))


def test_small_numbers_are_flushed_in_training_alone(tmp_path, monkeypatch):
    seen = []
    monkeypatch.setattr(checkpoint, "save", lambda *_: seen.append(sys.float_info.min / 2))
    with contextlib.suppress(FileNotFoundError):  # nothing was saved
        train(TINY, tmp_path, progress=False)
    assert set(seen) == {0.0} and sys.float_info.min / 2 > 0


def test_agents_of_milestones_are_kept_and_the_rest_of_the_last_two(tmp_path):
    config = replace(TINY, validation=None, num_steps=2, steps=40 * 32, checkpoint_every=1)
    train(config, tmp_path, progress=False)
    agents = [s // 32 for s in checkpoint.steps_saved(tmp_path)]
    assert agents == [1, 2, 3, 4, 8, 12, 16, 20, 24, 28, 32, 36, 39, 40]
    there = tmp_path / "checkpoints"
    whole = [int(p.parent.name) // 32 for p in there.glob("*/trainer.safetensors")]
    assert sorted(whole) == [39, 40]


def test_the_same_seed_gives_the_same_run_and_another_another(tmp_path):
    for name, seed in (("a", 0), ("b", 0), ("c", 1)):
        train(replace(TINY, seed=seed), tmp_path / name, progress=False)
    assert digest(tmp_path / "a") == digest(tmp_path / "b")
    assert digest(tmp_path / "a") != digest(tmp_path / "c")


def test_a_resumed_run_is_the_one_that_was_not_stopped(tmp_path, monkeypatch):
    train(TINY, tmp_path / "whole", progress=False)
    train_to_first_checkpoint(TINY, tmp_path / "parts", monkeypatch)
    metrics = tmp_path / "parts" / "metrics.jsonl"
    metrics.write_text(metrics.read_text() + '{"steps": 768, "lost": 1}\n{"steps": 10')
    train(TINY, tmp_path / "parts", progress=False)
    assert digest(tmp_path / "parts") == digest(tmp_path / "whole")
    assert checkpoint.metrics(tmp_path / "parts") == checkpoint.metrics(tmp_path / "whole")


@pytest.mark.parametrize("steps, said", [(20, True), (32, False), (64, False), (65, True)])
def test_a_training_longer_than_asked_for_is_told_before_it_begins(tmp_path, capsys, steps, said):
    config = replace(TINY, steps=steps, num_envs=4, num_steps=8, validation=None)
    Log(tmp_path, 0, config, progress=True).__exit__()
    told = f"{steps // 32 * 32 + 32} steps, as rollouts of 32 are whole\n"
    assert capsys.readouterr().err.endswith(told) == said


def test_progress_is_told_in_lines_where_nobody_sees_a_bar(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr("astray.training.log.EVERY", 0)
    train(TINY, tmp_path)
    told = capsys.readouterr()
    lines = [line for line in told.err.splitlines() if line.startswith("maze corner-small seed 0:")]
    assert [line.split()[4] for line in lines] == ["256", "512", "768", "1,024"]
    assert not told.out and told.err.count("\n") == len(lines)


def test_a_training_learns_as_by_torchs_optimizer_without_loading_its_compiler(
    tmp_path, monkeypatch
):
    with monkeypatch.context() as plain:
        plain.setattr(trainer, "Adam", torch.optim.Adam)
        train(TINY, tmp_path / "plain", progress=False)
    monkeypatch.setitem(sys.modules, "torch._dynamo", None)  # an import of it fails
    train_to_first_checkpoint(TINY, tmp_path / "run", monkeypatch)
    train(TINY, tmp_path / "run", progress=False)
    assert digest(tmp_path / "run") == digest(tmp_path / "plain")


def test_validation_never_touches_learning(tmp_path):
    train(TINY, tmp_path / "with", progress=False)
    train(replace(TINY, validation=None), tmp_path / "without", progress=False)
    one, two = (checkpoint.latest(tmp_path / n) / "agent.safetensors" for n in ("with", "without"))
    assert one.read_bytes() == two.read_bytes()


def test_short_episodes_that_end_first_are_not_all_that_the_validation_tells(tmp_path):
    # Of 20 steps an episode: after two rollouts of 8 there are only goals that were near.
    config = TINY.changed(num_steps=8, validation_every=2, steps=8 * 16 * 8)
    early, told = [], []
    for iteration in iterate(config, tmp_path):
        if iteration.number == 5:
            break
        early.append([row[1] for row in iteration.trainer.validation.recent])
        told.append("validation/return" in iteration.metrics)
    assert not any(told) and max(early[3]) < 20  # no episode that ran out of time
    for iteration in iterate(config, tmp_path):
        lengths = [row[1] for row in iteration.trainer.validation.recent]
        assert iteration.metrics["validation/length"] == np.mean(lengths)
        assert max(lengths) == 20
    assert iteration.number == 8


def test_validation_levels_are_not_training_levels():
    assert not set(TINY.training_levels) & set(TINY.unseen_levels[:1000])
    assert TINY.training_levels.stop == TINY.unseen_levels.start


@pytest.mark.thorough  # `test_an_agent_learns_the_proxy_of_a_world` learns by the same loop
def test_an_agent_learns_the_way_to_the_corner(tmp_path):
    config = replace(
        TINY,
        validation=None,
        steps=90_000,
        num_envs=64,
        num_steps=32,
        minibatches=8,
        width=64,
        gamma=0.95,
        learning_rate=2e-3,
        knobs={"world": 5, "largest": 3, "time_limit": 30},
    )
    train(config, tmp_path, progress=False)
    lines = checkpoint.metrics(tmp_path)
    first, last = lines[2]["training/length"], lines[-1]["training/length"]
    assert last < 4 < 8 < first  # the mean shortest way is 2.9 steps


@pytest.mark.skipif(usable("cuda"), reason="there is a CUDA device")
def test_a_device_that_is_not_there_is_explained(tmp_path):
    with pytest.raises(ValueError, match="no device 'cuda'"):
        train(replace(TINY, device="cuda"), tmp_path, progress=False)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "change, message",
    [
        ({"steps": 0}, "steps must be from 1 to 1000000000000000; got 0"),
        ({"clip": 1e39}, r"clip must be from 0 to 1e\+38; got 1e\+39"),
        ({"num_envs": 1, "num_steps": 1, "minibatches": 1}, "must have 2 samples, .* got 1 of 1"),
        ({"minibatches": 7}, "are not divided by 7 minibatches"),
        ({"variant": "cornr"}, "unknown variant 'cornr'"),
        ({"knobs": {"colour": "red"}}, "unknown knob 'colour'; there are"),
        ({"knobs": {"region": "five"}}, "region must be of type int; got 'five'"),
        ({"seed": -1}, "seed must be from 0 to"),
        ({"validation": "nowhere"}, "unknown variant 'nowhere'"),
    ],
)
def test_bad_settings_are_explained(change, message):
    with pytest.raises(ValueError, match=message):
        TINY.changed(**change)


def test_a_folder_with_another_run_is_refused(tmp_path):
    train(TINY, tmp_path, progress=False)
    before = digest(tmp_path)
    with pytest.raises(ValueError, match="seed is 0 there, 5 here"):
        train(replace(TINY, seed=5), tmp_path, progress=False)
    assert digest(tmp_path) == before


def test_two_processes_cannot_train_in_one_folder(tmp_path):
    with (
        checkpoint.claim(tmp_path, TINY),
        pytest.raises(RuntimeError, match="another process is training"),
    ):
        train(TINY, tmp_path, progress=False)


def test_a_truncated_checkpoint_is_explained_and_kept(tmp_path):
    train(TINY, tmp_path, progress=False)
    path = checkpoint.latest(tmp_path) / "trainer.safetensors"
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(ValueError, match="cannot be resumed from"):
        train(TINY, tmp_path, progress=False)
    assert path.stat().st_size == 1000


def test_a_timeout_is_bootstrapped_by_default_and_terminates_on_request(tmp_path):
    from astray.training.loop import collect
    from astray.training.trainer import Trainer

    advantages = {}
    for timeouts in ("bootstrap", "terminate"):
        config = replace(
            TINY,
            timeouts=timeouts,
            normalise_advantage=False,
            num_steps=32,
            gamma=0.5,
            validation=None,
        )
        trainer = Trainer(config)
        for weight in trainer.network.parameters():
            weight.data.zero_()
        trainer.network.value.bias.data.fill_(8.0)  # the critic says 8 everywhere
        rollout = collect(trainer)
        advantages[timeouts] = rollout.advantage.numpy()
        trainer.close()
    differ = advantages["bootstrap"] - advantages["terminate"]
    assert differ.max() == pytest.approx(0.5 * 8, abs=1e-5)  # gamma times the value cut off
    assert (differ[20:] == 0).any() and (differ >= -1e-6).all()  # episodes of 20 steps are cut


def test_a_knob_as_text_is_the_same_setting():
    text, value = ({"time_limit": t, "shift_probability": p} for t, p in (("9", "0"), (9, 0.0)))
    assert replace(TINY, knobs=text) == replace(TINY, knobs=value)
    assert replace(TINY, knobs=text).to_json()["knobs"] == value


def test_validation_and_shifted_levels_follow_the_knobs_that_make_no_shift():
    config = replace(TINY, variant="corner", validation="anywhere", knobs={"goal_colour": "red"})
    assert config.variant_for(config.validation).goal_colour == "red"
    assert config.variant_for(config.validation).placement == "anywhere"
    changed = (
        games.find("maze")
        .variant("corner")
        .with_knobs({"world": 15, "largest": 15, "shift_probability": 0.5})
    )
    assert (changed.shifted.world, changed.shifted.placement) == (15, "anywhere")


def test_the_papers_network_is_trained_on_pictures(tmp_path):
    config = replace(
        PRESETS["paper"],
        variant="corner",
        validation="anywhere",
        num_envs=8,
        num_steps=8,
        minibatches=2,
        epochs=1,
        steps=128,
        checkpoint_every=1,
    )
    train(config, tmp_path, progress=False)
    one, two = (
        load_file(tmp_path / "checkpoints" / s / "agent.safetensors") for s in ("64", "128")
    )
    assert all(not np.array_equal(one[name], two[name]) for name in one)
    lines = checkpoint.metrics(tmp_path)
    assert np.isfinite([line["update/loss"] for line in lines]).all()
    assert lines[1]["update/learning_rate"] == pytest.approx(5e-4 / 2)


def test_a_scale_that_a_network_does_not_have_is_refused():
    with pytest.raises(ValueError, match="network mlp has no scale; got 3"):
        next(iterate(TINY.changed(scale=3)))
