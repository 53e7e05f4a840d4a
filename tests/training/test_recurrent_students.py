"""Students and teachers with memory: what is remembered of the student's episodes."""

import contextlib
from dataclasses import replace

import pytest
import torch

from astray.training import checkpoint, teacher
from astray.training.folders import TEACHER
from astray.training.loop import collect, train
from astray.training.trainer import Trainer
from helpers.trainings import TINY, digest, train_to_first_checkpoint

MEMORY = replace(TINY, network="mlp+gru", validation=None)
STUDENT = replace(MEMORY, teacher="tiny", steps=4096, learning_rate=3e-3)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Run folder of a teacher with memory, which was trained for a moment."""
    folder = tmp_path_factory.mktemp("teacher")
    train(replace(MEMORY, steps=256), folder, progress=False)
    return checkpoint.latest(folder) / checkpoint.AGENT


@pytest.fixture
def student(tmp_path, weights):
    teacher.give(weights, tmp_path / "student")
    return tmp_path / "student"


def test_a_teacher_remembers_the_students_episodes_from_one_rollout_to_the_next(student):
    with contextlib.closing(Trainer(STUDENT, teacher=student / TEACHER)) as trainer:
        assert isinstance(trainer.teacher, teacher.Teacher)
        for _ in range(2):
            state = trainer.teacher.state.clone()
            rollout = collect(trainer)
            network = trainer.teacher.network
            with torch.no_grad():
                logits, values, _ = network.unroll(rollout.observation, state, rollout.begins)
            assert torch.allclose(rollout.wanted, logits.log_softmax(-1), atol=1e-5)
            assert torch.allclose(rollout.target, values, atol=1e-5)
        assert state.abs().max() > 0 and not rollout.begins[0].all()


def test_a_student_with_memory_learns_in_sequences_and_comes_nearer(student):
    train(STUDENT, student, progress=False)
    first, *_, last = checkpoint.metrics(student)
    assert last["update/kl"] < 0.8 * first["update/kl"]


def test_the_loss_of_a_student_with_memory_is_that_of_its_sequences(student):
    with contextlib.closing(Trainer(STUDENT, teacher=student / TEACHER)) as trainer:
        with torch.no_grad():  # from near uniform
            trainer.network.get_parameter("body.policy.weight").mul_(100)
        rollout = collect(trainer)
        some = torch.tensor([3, 0])
        found = trainer.fast.loss(rollout.flat().at(some))
        with torch.no_grad():
            logits, _, _ = trainer.network.unroll(
                rollout.observation[:, some], rollout.state[some], rollout.begins[:, some]
            )
        told, wanted = logits.log_softmax(-1), rollout.wanted[:, some]
        kl = (wanted.exp() * (wanted - told)).sum(-1).mean()
        assert torch.allclose(found["kl"], kl, atol=1e-6) and kl > 1e-3


@pytest.mark.parametrize("network", ["mlp", "mlp+lstm"])
def test_a_student_of_a_teacher_with_memory_goes_on_to_the_bit(
    network, tmp_path, student, weights, monkeypatch
):
    config = replace(STUDENT, network=network, steps=1024)
    train_to_first_checkpoint(config, student, monkeypatch)
    train(config, student, progress=False)
    teacher.give(weights, tmp_path / "whole")
    train(config, tmp_path / "whole", progress=False)
    assert digest(student) == digest(tmp_path / "whole")
    assert any(digest(student)["teacher.memory"])
