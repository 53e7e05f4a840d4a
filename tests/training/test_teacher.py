"""A student learns what its teacher would do, in its own episodes."""

import contextlib
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

import astray
from astray import files
from astray.acting import Answer, initial_states
from astray.agents.policy import Architecture
from astray.cli.distil import distil
from astray.training import checkpoint, loop, ppo, teacher
from astray.training.config import LeftOut
from astray.training.fast import acceleration
from astray.training.folders import TEACHER, AgentFolder
from astray.training.loop import collect, improve, train
from astray.training.teacher import Taught
from astray.training.trainer import Trainer
from helpers.thorough import thorough
from helpers.trainings import TINY, digest, train_to_first_checkpoint

STUDENT = replace(TINY, teacher="tiny", steps=4096, epochs=3, learning_rate=3e-3)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Of an agent that was trained for a moment."""
    folder = tmp_path_factory.mktemp("teacher")
    train(TINY, folder, progress=False)
    return checkpoint.latest(folder) / checkpoint.AGENT


@pytest.fixture
def student(tmp_path, weights):
    teacher.give(weights, tmp_path / "student")
    return tmp_path / "student"


def made_up(n, actions):
    random = torch.Generator().manual_seed(0)
    wanted = torch.randn(n, actions, generator=random).log_softmax(-1)
    zeros = torch.zeros(n)
    target = torch.randn(n, generator=random)
    return Taught(zeros, zeros.long(), zeros, zeros, zeros, target, wanted)


def test_the_loss_is_the_divergence_and_the_error_of_values():
    batch = made_up(64, 9)
    logits, value = torch.randn(64, 9), torch.randn(64)
    losses = teacher.loss(lambda _: (logits, value), batch, STUDENT)
    kl = torch.nn.functional.kl_div(
        logits.log_softmax(-1), batch.wanted, reduction="batchmean", log_target=True
    )
    critic = torch.nn.functional.mse_loss(value, batch.target) / 2
    assert torch.allclose(losses["kl"], kl)
    assert torch.allclose(losses["loss"], kl + STUDENT.value_weight * critic)
    own = teacher.loss(lambda _: (batch.wanted, batch.target), batch, STUDENT)
    assert abs(float(own["loss"])) < 1e-6 and own["agree"] == 1


def test_the_teacher_is_asked_about_what_the_student_sees(student, weights):
    with contextlib.closing(Trainer(STUDENT, teacher=student / TEACHER)) as trainer:
        samples = collect(trainer).flat()
    known = astray.load_agent(weights.parent)
    logits, values = known.outputs(samples.observation.numpy())
    assert torch.allclose(samples.wanted, logits.log_softmax(-1), atol=1e-5)
    assert torch.allclose(samples.target, values, atol=1e-5)


@pytest.mark.parametrize(
    "more", [{}, {"observation": "image", "network": "patch", "steps": 1024}], ids=["mlp", "patch"]
)
def test_a_student_comes_nearer_to_its_teacher(student, more):
    train(STUDENT.changed(**more), student, progress=False)
    first, *_, last = checkpoint.metrics(student)
    assert last["update/kl"] < 0.7 * first["update/kl"]
    assert "update/first_kl" not in last
    agent = astray.load_agent(student)
    assert agent.observation == more.get("observation", "symbolic")


def test_a_student_that_was_stopped_goes_on(tmp_path, student, weights, monkeypatch):
    config = replace(STUDENT, steps=768)
    train_to_first_checkpoint(config, student, monkeypatch)
    train(config, student, progress=False)
    teacher.give(weights, tmp_path / "plain")
    train(config, tmp_path / "plain", progress=False)
    assert digest(student) == digest(tmp_path / "plain")


def test_the_kernels_of_ppo_do_not_run_for_students():
    architecture = Architecture("mlp", (4, 5, 5), (1, 1, 1, 1), 9, width=16)
    fast = acceleration.accelerate(architecture.build(), teacher.loss, STUDENT, architecture)
    assert fast.plain is teacher.loss and not fast.using.fused_cpu


def test_a_student_without_its_teacher_or_with_another_is_refused(tmp_path, student, weights):
    with pytest.raises(FileNotFoundError, match=r"the teacher tiny must be at .*astray distil"):
        train(STUDENT, tmp_path / "alone", progress=False)
    with pytest.raises(ValueError, match="a student of tiny must have a run folder"):
        next(astray.iterate(STUDENT))
    with pytest.raises(ValueError, match="must know observations of"):
        train(replace(STUDENT, knobs={"world": 7, "largest": 7}), student, progress=False)
    other = tmp_path / "other.safetensors"
    other.write_bytes(weights.read_bytes() + b" ")
    with pytest.raises(ValueError, match=r"must be the agent at .*; it is another"):
        teacher.give(other, student)
    assert (student / TEACHER).read_bytes() == weights.read_bytes()


@pytest.mark.parametrize(
    "config, told",
    [(STUDENT, "the teacher tiny must be at"), (replace(TINY, start="nobody"), "unknown agent")],
)
def test_an_agent_that_is_missing_is_told_before_a_game_is_compiled(
    config, told, tmp_path, monkeypatch
):
    monkeypatch.setattr(loop, "Trainer", None)  # which compiles its game
    with pytest.raises((FileNotFoundError, ValueError), match=told):
        train(config, tmp_path / "mouse", progress=False)


def test_a_training_begins_with_the_weights_of_another_agent(tmp_path, weights, monkeypatch):
    other = shutil.copytree(weights.parents[2], tmp_path / "other")
    begun = replace(TINY, start=str(other))
    same = train(replace(begun, learning_rate=0.0), tmp_path / "same", progress=False)
    assert load_file(same / checkpoint.AGENT).keys() == load_file(weights).keys()
    for name, weight in load_file(same / checkpoint.AGENT).items():
        assert torch.equal(weight, load_file(weights)[name])
    train(begun, tmp_path / "whole", progress=False)
    train_to_first_checkpoint(begun, tmp_path / "parts", monkeypatch)
    shutil.rmtree(other)  # a checkpoint is enough to go on
    train(begun, tmp_path / "parts", progress=False)
    assert digest(tmp_path / "parts") == digest(tmp_path / "whole")


@pytest.mark.parametrize(
    "changes, told",
    [
        ({"game": "heist", "variant": "small", "validation": None, "knobs": {}}, "not of 'heist'"),
        ({"network": "patch"}, "it has name mlp, where the settings say patch"),
        ({"width": 8}, "it has width 16, where the settings say 8"),
    ],
)
def test_a_start_of_another_kind_is_told_before_a_game_is_compiled(
    changes, told, weights, monkeypatch
):
    monkeypatch.setattr(loop, "Trainer", None)  # which compiles its game
    with pytest.raises(ValueError, match=told):
        next(astray.iterate(TINY.changed(start=str(weights.parents[2]), **changes)))


def test_a_training_that_cannot_begin_with_an_agent_says_so(tmp_path, weights):
    begun = replace(TINY, start=str(weights.parents[2]))
    with pytest.raises(FileNotFoundError, match="unknown agent 'nobody'"):
        train(replace(begun, start="nobody"), tmp_path / "mouse", progress=False)
    assert not (tmp_path / "mouse" / "config.json").exists()


def test_a_teacher_that_sees_images_is_shown_those_that_it_knows(tmp_path):
    pictures = replace(TINY, observation="image", network="patch", steps=256, validation=None)
    train(pictures, tmp_path / "teacher", progress=False)
    with pytest.raises(ValueError, match=r"the teacher sees art 'own'; .*; got 'original'"):
        distil(tmp_path / "teacher", art="original", out=tmp_path / "students")
    assert not (tmp_path / "students").exists()


def test_knobs_of_a_teacher_that_its_students_variant_cannot_have_are_warned_of(tmp_path):
    its = {"knobs": {**TINY.knobs, "region": 2}, "validation": None}
    train(replace(TINY, variant="region-3", **its), tmp_path / "teacher", progress=False)
    told = "anywhere is played with region=1: the training's region=2 are not for it"
    with pytest.warns(LeftOut, match=told), pytest.raises(ValueError, match="seeds must be"):
        distil(tmp_path / "teacher", variant="anywhere", seeds=0)


def test_students_that_are_refused_leave_no_folder(tmp_path):
    out = tmp_path / "students"
    for variant, message in (("corner", "must be a variant whose obs"), ("", "unknown variant")):
        with pytest.raises(ValueError, match=message):
            distil(Path("maze-corner"), observation="symbolic", variant=variant, out=out)
        assert not list(tmp_path.iterdir())


def test_the_verb_distils_from_an_agent_by_name(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    distil(Path("maze-corner"), observation="symbolic", steps=16_384)
    run = tmp_path / "runs" / "maze-corner-small-of-maze-corner" / "seed-0"
    config = checkpoint.read_config(run)
    assert (config.teacher, config.network, config.variant) == (
        "maze-corner",
        "mlp",
        "corner-small",
    )
    assert checkpoint.finished(run, config)
    # Its values are the teacher's, in another unit than that of the rewards that it met.
    assert AgentFolder.open(run).deviation() is None


def test_students_have_one_teacher_though_it_trains_meanwhile(tmp_path, weights, monkeypatch):
    run, out = tmp_path / "mouse", tmp_path / "students"
    shutil.copytree(weights.parents[2], run)

    def train_on(config, folder, track):
        shutil.rmtree(run / "checkpoints", ignore_errors=True)
        (folder / "config.json").write_text("")

    monkeypatch.setattr("astray.training.track.train_tracked", train_on)
    distil(run, observation="symbolic", steps=16_384, seeds=2, out=out)
    assert len({(out / f"seed-{k}" / TEACHER).read_bytes() for k in range(2)}) == 1


def test_a_second_distillation_leaves_the_first_its_teacher(tmp_path, weights):
    """It is refused, and the first one's next student had no teacher, an hour later."""
    out, run = tmp_path / "students", weights.parents[2]
    with checkpoint.teaching(weights, out / "seed-1"), files.hold(out / "seed-0", "trains in"):
        with pytest.raises(checkpoint.Claimed):
            distil(run, observation="symbolic", steps=16_384, seeds=2, out=out)
        with pytest.raises(KeyboardInterrupt), checkpoint.teaching(weights, out / "seed-1"):
            raise KeyboardInterrupt
        assert all((out / f"seed-{k}" / TEACHER).exists() for k in range(2))
    with pytest.raises(KeyboardInterrupt), checkpoint.teaching(weights, out / "seed-2"):
        raise KeyboardInterrupt
    assert not (out / "seed-2").exists()


def test_a_sampler_that_learns_from_scores_has_no_students():
    for sampler in ("plr", "accel"):
        with pytest.raises(ValueError, match=f"a student needs a sampler.*{sampler}"):
            STUDENT.changed(sampler=sampler)
    with pytest.raises(ValueError, match="one group of environments; got 2 groups"):
        STUDENT.changed(groups=2)


SOLVED = replace(TINY, teacher="solver", steps=4096, epochs=3, learning_rate=3e-3)


def test_the_solver_says_the_way_to_the_intended_goal():
    with contextlib.closing(Trainer(SOLVED)) as trainer:
        player, game = trainer.player, trainer.player.game
        assert trainer.teacher
        for t in range(3):
            states = player.envs[0].get_state()
            wanted = trainer.teacher.says(t, states["time"] == 0)
            for i, s in enumerate(states.view(np.recarray)):
                action = game.actions[int(wanted[i].argmax())]
                assert game.actions[game.solver.expert(s, "cheese")(s)] == action
            torch.testing.assert_close(wanted.exp().sum(-1), torch.ones(len(states)))
            right = np.full(len(states), game.actions.index("right"))
            player.step(t, 0, Answer(right))


@pytest.mark.parametrize("sampler", ["uniform", *thorough("growing")])
def test_lessons_anywhere_begin_new_levels_in_every_rollout(sampler):
    config = SOLVED.changed(sampler=sampler, lessons="anywhere")
    with contextlib.closing(Trainer(config)) as trainer:
        player, begun = trainer.player, []
        for _ in range(2):
            collect(trainer)
            assert trainer.teacher
            trainer.teacher.begin(trainer.steps)
            begun.append(player.envs[0].get_state().view(np.recarray))
            assert player.begins.all() and (begun[-1].time == 0).all()
            shown = player.envs[0].set_state(begun[-1])
            assert np.array_equal(player.images.numpy(), shown)
            trainer.steps += trainer.config.batch
    first = initial_states("maze", trainer.config.training_variant(), begun[1].level)
    places = player.game.places
    moved = 0
    for now, then in zip(begun[1], first.view(np.recarray), strict=True):
        assert places.stand(then)[int(now.y), int(now.x)]
        moved += (now.x, now.y) != (then.x, then.y)
    assert moved > len(first) / 2
    assert (begun[0].level != begun[1].level).mean() > 0.9


@pytest.mark.parametrize("taught", ["solver", "tiny"])
def test_who_will_be_alone_learns_values_from_its_own_rewards(taught, student):
    alone = replace(SOLVED, teacher=None)
    with contextlib.closing(Trainer(alone)) as trainer:
        expected = collect(trainer)
    config = replace(alone, teacher=taught, taught=0.5)
    with contextlib.closing(Trainer(config, teacher=student / TEACHER)) as trainer:
        samples = collect(trainer)
    assert isinstance(samples, Taught)
    torch.testing.assert_close(samples.target, expected.target, atol=3e-3, rtol=0)  # bfloat16
    assert float(samples.target.std()) > 0.3


def test_a_student_comes_nearer_to_the_solver():
    with contextlib.closing(Trainer(replace(SOLVED, variant="corner-small"))) as trainer:
        kl = [improve(trainer)[0]["update/kl"] for _ in range(12)]
    assert kl[-1] < 0.8 * kl[0]


def test_after_its_lessons_rewards_alone_teach_a_student(tmp_path):
    config = replace(SOLVED, steps=1024, taught=0.5)
    train(config, tmp_path, progress=False)
    lines = checkpoint.metrics(tmp_path)
    assert len(lines) == 4
    assert ["update/kl" in line for line in lines] == 2 * [True] + 2 * [False]
    assert ["update/policy_loss" in line for line in lines] == 2 * [False] + 2 * [True]


@pytest.mark.parametrize("anneal", [True, False])
def test_lessons_may_have_a_learning_rate_of_their_own(anneal, tmp_path):
    rates = {"lesson_rate": 8e-3, "learning_rate": 1e-4, "anneal": anneal}
    config = replace(SOLVED, steps=1536, taught=0.5, validation=None, **rates)
    train(config, tmp_path, progress=False)
    rates = [line["update/learning_rate"] for line in checkpoint.metrics(tmp_path)]
    lessons, alone = (
        (np.linspace(rate, 0, n, endpoint=False) if anneal else np.full(n, rate))
        for rate, n in ((8e-3, 3), (1e-4, 3))
    )
    assert rates == pytest.approx([*lessons, *alone])


def test_what_follows_the_lessons_is_ppo_to_the_last_digit():
    with contextlib.closing(Trainer(replace(SOLVED, taught=0.25))) as trainer:
        while trainer.is_taught:
            improve(trainer)
        batch = collect(trainer).flat()
        got = trainer.fast.loss(batch)["loss"]
        assert torch.equal(got, ppo.loss(trainer.network, batch, trainer.config)["loss"])
        # Rewards were taken in on the way, so that the critic's scale is that of its lessons.
        assert trainer.player.normaliser.count > 1000


THIEF = {"game": "keys", "variant": "many-chests", "validation": None, "knobs": {}}


@pytest.mark.parametrize(
    "change", [{}, {"lessons": "anywhere"}, THIEF], ids=["episodes", "anywhere", "thief"]
)
def test_a_resumed_student_of_the_solver_is_the_one_that_was_not_stopped(
    change, tmp_path, monkeypatch
):
    config = replace(SOLVED, steps=1024, taught=0.5, checkpoint_every=1, **change)
    train(config, tmp_path / "whole", progress=False)
    train_to_first_checkpoint(config, tmp_path / "parts", monkeypatch)
    train(config, tmp_path / "parts", progress=False)
    assert digest(tmp_path / "parts") == digest(tmp_path / "whole")


@pytest.mark.parametrize(
    "change, message",
    [
        ({"taught": 0.5, "teacher": None}, "taught must be 1.0 without a teacher; got 0.5"),
        ({"lessons": "anywhere", "teacher": None}, "lessons must be episodes without a teacher"),
        ({"lesson_rate": 0.1, "teacher": None}, "lesson_rate must be None without a teacher"),
        ({"lesson_rate": -1.0}, "lesson_rate must be from 0 to 1e.38; got -1.0"),
        ({"taught": 2.0}, "taught must be from 0 to 1; got 2.0"),
        ({"variant": "region-4", "validation": None}, "a variant of a shift, which names the goal"),
    ],
)
def test_lessons_that_nobody_can_give_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        replace(SOLVED, knobs={}, **change)


def test_the_validation_says_which_goal_a_region_is_for():
    assert replace(SOLVED, knobs={}, variant="region-4", validation="anywhere").intended_goal() == (
        "cheese"
    )
