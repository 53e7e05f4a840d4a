"""Samplers of levels: formulas beside slow ones, and trainings that are resumed with them."""

import contextlib
import itertools
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from astray.envs.beginnings import initial_states
from astray.envs.loops import SHIFT
from astray.envs.vector import GameVectorEnv
from astray.games.maze import GAME
from astray.kernel.rng import fraction as fraction_of
from astray.training import checkpoint, loop
from astray.training.levels import (
    FIRST,
    Growing,
    Mixed,
    Plan,
    Played,
    discounted_returns,
    positive_value_loss,
)
from astray.training.loop import collect, play, train
from astray.training.replay import REPLAY, Replay, draw_distinct, probabilities
from astray.training.trainer import Trainer
from helpers.trainings import PLAIN, TINY, digest, train_to_first_checkpoint

SHIFTED = {**TINY.knobs, "shift_probability": 0.2}
MIXED = TINY.changed(sampler="mixed", knobs=SHIFTED)
DOSED = MIXED.changed(shifted_steps=300)
PLR = TINY.changed(sampler="plr", knobs=SHIFTED, buffer=64, score="regret")
GROWING = TINY.changed(sampler="growing", levels=200, knobs={"world": 7, "largest": 7})
ACCEL = PLR.changed(sampler="accel", score="max-monte-carlo")


def rollout(steps=12, n=5, seed=0):
    random = np.random.default_rng(seed)
    ended = random.random((steps, n)) < 0.15
    ended[:, 0] = False  # no episode of the first ends
    return random.random((steps, n)), random.normal(size=(steps, n)), ended


def played(reward, ended):
    return Played(reward, np.zeros(reward.shape, np.float32), ended, np.zeros_like(ended))


def test_few_levels_are_scored_before_they_are_replayed():
    config = PLR.changed(levels=40, buffer=4096, score="positive-value-loss")
    sampler, shape = Replay(config), (8, config.num_envs)
    while sampler.plan(0).learn:
        pass
    ended = np.zeros(shape, bool)
    sampler.note(Played(np.ones(shape), np.ones(shape, np.float32), ended, ended))
    assert (sampler.score > 0).any() and len(sampler.states) == 40


def test_returns_are_those_of_the_episodes_that_ended_one_by_one():
    reward, _, ended = rollout()
    mean, best = discounted_returns(reward, ended, 0.9)
    for i in range(reward.shape[1]):
        ends = np.flatnonzero(ended[:, i]) if ended[:, i].any() else [len(reward) - 1]
        begins = [0, *(t + 1 for t in ends[:-1])]
        naive = [
            sum(reward[t, i] * 0.9 ** (t - first) for t in range(first, last + 1))
            for first, last in zip(begins, ends, strict=True)
        ]
        assert mean[i] == pytest.approx(np.mean(naive)) and best[i] == pytest.approx(max(naive))


def test_the_positive_value_loss_is_that_of_its_definition():
    reward, delta, ended = rollout()
    advantage, steps = np.zeros_like(reward), len(reward)
    for t, i in np.ndindex(*reward.shape):  # (gamma lambda)^(k - t) delta_k up to the end
        last = next((k for k in range(t, steps) if ended[k, i]), steps - 1)
        advantage[t, i] = sum(0.8 ** (k - t) * delta[k, i] for k in range(t, last + 1))
    naive = [sum(max(a, 0) for a in advantage[:, i]) / steps for i in range(reward.shape[1])]
    assert positive_value_loss(advantage) == pytest.approx(naive)


def test_replay_probabilities_are_those_of_the_definition():
    score, age = np.array([0.5, 2.0, 0.5, -1.0]), np.array([1, 4, 2, 3])
    ranks = [2, 1, 3, 4]
    by_score = [(1 / rank) ** (1 / 0.3) for rank in ranks]
    naive = [
        0.9 * w / sum(by_score) + 0.1 * a / sum(age) for w, a in zip(by_score, age, strict=True)
    ]
    assert probabilities(score, age, 0.3, 0.1) == pytest.approx(naive)


def test_levels_are_drawn_one_after_the_other_by_their_chances():
    chance, exact = np.array([0.5, 0.3, 0.15, 0.05]), np.zeros(4)
    for one, two in itertools.permutations(range(4), 2):
        exact[[one, two]] += chance[one] * chance[two] / (1 - chance[one])
    random, often = np.random.default_rng(0), np.zeros(4)
    for _ in range(4000):
        often[draw_distinct(chance, 2, random)] += 1
    assert often / 4000 == pytest.approx(exact, abs=0.03)


@pytest.mark.parametrize("schedule", ["throughout", "early", "late", "annealed"])
@pytest.mark.parametrize("rollouts", [1, 7, 30.5])
@pytest.mark.parametrize("fraction", [0.01, 0.25])
def test_every_schedule_comes_to_its_fraction_also_in_few_rollouts(schedule, fraction, rollouts):
    config = MIXED.changed(schedule=schedule, fraction=fraction, steps=int(rollouts * 256))
    sampler, shifted = Mixed(config), 0.0
    for steps in range(0, config.steps, config.batch):
        sampler.plan(steps)
        shifted += sampler.now * min(config.batch, config.steps - steps)
    assert shifted / config.steps == pytest.approx(fraction)


def test_mixed_levels_are_shifted_with_the_fraction_and_are_the_variants_own_numbers():
    sampler = Mixed(MIXED.changed(fraction=0.5, levels=1000))
    sampler.plan(0)
    numbers = np.concatenate([sampler.next(np.arange(16)) for _ in range(100)])
    shifted = np.array([fraction_of(number, SHIFT) < 0.2 for number in numbers])
    assert abs(shifted.mean() - 0.5) < 0.05 and numbers.max() < 1000
    assert sampler.summary()["shifted_fraction"] == shifted.mean()


def test_early_levels_are_shifted_first_and_late_ones_last():
    fractions = {}
    for schedule in ("early", "late"):
        config = MIXED.changed(schedule=schedule, steps=40 * 256)
        sampler = Mixed(config)
        for steps in (0, config.steps // 2, config.steps - config.batch):
            sampler.plan(steps)
            numbers = sampler.next(np.arange(16))
            shifted = np.mean([fraction_of(number, SHIFT) < 0.2 for number in numbers])
            fractions.setdefault(schedule, []).append(shifted)
    assert fractions == {"early": [1, 0, 0], "late": [0, 0, 1]}


@pytest.mark.parametrize("schedule", ["throughout", "early", "late", "annealed"])
def test_every_schedule_begins_as_many_shifted_levels_as_were_asked_for(schedule):
    config = MIXED.changed(schedule=schedule, fraction=0.25, shifted_levels=40, steps=40 * 256)
    sampler, begun = Mixed(config), []
    for steps in range(0, config.steps, config.batch):
        sampler.plan(steps)
        numbers = [sampler.next(np.arange(16)) for _ in range(1 + steps // 2048)]  # ever shorter
        begun.append(sum(fraction_of(n, SHIFT) < 0.2 for n in np.concatenate(numbers)))
    assert sampler.summary()["shifted"] == sum(begun) == 40
    quarter = len(begun) // 4
    parts = {
        "throughout": 10,  # in the first quarter of all rollouts
        "early": 40,
        "late": 0,
        "annealed": 40 * (1 - 0.75**2),
    }
    assert sum(begun[:quarter]) == pytest.approx(parts[schedule], abs=1)
    if schedule == "late":
        assert sum(begun[-quarter:]) == 40


@pytest.mark.parametrize("schedule", ["throughout", "early", "late", "annealed"])
def test_every_schedule_plays_as_many_steps_in_shifted_levels_as_were_asked_for(schedule):
    config = MIXED.changed(schedule=schedule, fraction=0.25, shifted_steps=2048, steps=40 * 256)
    sampler, random, spent = Mixed(config), np.random.default_rng(0), []
    now = np.zeros(16, np.int64)
    for steps in range(0, config.steps, config.batch):
        if sampler.plan(steps).restart:
            now = sampler.next(np.arange(16))
        # Shifted levels take twice as long, as they may.
        ended, inside = np.zeros((16, 16), bool), 0
        for t in range(16):
            shifted = np.array([fraction_of(number, SHIFT) < 0.2 for number in now])
            inside += shifted.sum()
            ended[t] = random.random(16) < np.where(shifted, 0.1, 0.2)
            if ended[t].any():
                now[ended[t]] = sampler.next(np.flatnonzero(ended[t]))
        sampler.note(played(np.zeros((16, 16)), ended))
        spent.append(inside)
    assert sampler.summary()["shifted_steps"] == sum(spent)
    assert sum(spent) == pytest.approx(2048, rel=0.05)
    quarter = len(spent) // 4
    parts = {"throughout": 0.25, "early": 1, "late": 0, "annealed": 1 - 0.75**2}
    assert sum(spent[:quarter]) / 2048 == pytest.approx(parts[schedule], abs=0.05)
    assert max(spent) < 256 or schedule in ("early", "late")


@pytest.mark.parametrize(
    "change, message",
    [
        ({"fraction": 0, "shifted_levels": 10}, "shifted_levels needs a fraction above 0; got 0"),
        ({"fraction": 0, "shifted_steps": 10}, "shifted_steps needs a fraction above 0; got 0"),
        ({"shifted_levels": 10, "shifted_steps": 9}, "either counted or their steps; got .*: 9}"),
    ],
)
def test_a_dose_of_shifted_levels_is_of_one_kind_and_needs_time_to_come_in(change, message):
    with pytest.raises(ValueError, match=message):
        Mixed(MIXED.changed(**change))


def test_regret_is_what_the_solver_gets_more_than_the_agent():
    sampler = Replay(PLR)
    sampler.plan(0)
    best = np.array([GAME.solver.optimal_return(s, "cheese", PLR.gamma) for s in sampler.current])
    reward = np.zeros((20, 16))
    reward[0] = best * np.arange(16) / 16  # at once: nothing of it is discounted
    ended = np.zeros((20, 16), bool)
    ended[0] = True
    sampler.note(played(reward, ended))
    numbers, kept = sampler.current["level"], sampler.states["level"]
    for i in range(16):
        regret = best[i] * (1 - i / 16)
        assert sampler.score[kept == numbers[i]] == pytest.approx(regret)


def test_the_best_return_in_a_level_that_was_not_played_before_is_the_first_one():
    sampler = Replay(PLR.changed(score="max-monte-carlo"))
    while sampler.kind != REPLAY:
        sampler.plan(0)
    ended = np.ones((2, 16), bool)
    sampler.note(played(np.array([[-3.0], [-1.0]]).repeat(16, 1), ended))
    assert sampler.score[sampler.places] == pytest.approx(1)
    assert sampler.best[sampler.places] == pytest.approx(-1)


def test_what_scores_higher_takes_the_place_of_what_is_replayed_least():
    sampler = Replay(PLR.changed(buffer=16, levels=10**6))
    sampler._fill()
    sampler.score[:] = np.arange(16)
    numbers = np.arange(500_000, 500_016)
    sampler.kind, sampler.current = 0, initial_states(GAME, sampler.variant, numbers)
    score = np.full(16, -1.0)
    score[:3] = 9.5, 1.5, 99.0
    before = sampler.states["level"].copy()
    sampler._insert(np.stack([score, score, score]))
    assert sorted(sampler.score) == [2, 3, 4, 5, 6, 7, 8, 9, 9.5, 10, 11, 12, 13, 14, 15, 99]
    assert sorted(set(sampler.states["level"]) - set(before)) == [500_000, 500_002]
    sampler._insert(np.stack([score + 100, score, score]))  # the same numbers are there already
    assert (sampler.states["level"] == 500_002).sum() == 1


def test_an_environment_plays_one_level_of_the_buffer_throughout_a_replay():
    trainer = Trainer(replace(PLR, validation=None))
    play(trainer)
    sampler, player = trainer.player.sampler, trainer.player
    assert sampler.kind == 1 and len(set(sampler.places)) == 16
    mazes = sampler.states[sampler.places]["cell"] == 1
    assert ((player.envs[0].states["cell"] == 1) == mazes).all()
    trainer.close()


def test_levels_that_are_only_scored_leave_no_trace_in_learning():
    class Scores:
        """Has a rollout scored before each that is learned from, of the same levels."""

        turn = 0

        def plan(self, steps):
            self.turn += 1
            return Plan(learn=self.turn % 3 == 0, restart=True)

        def next(self, places):
            return places.copy()

        def note(self, played):
            pass

    trainer = Trainer(PLAIN)
    trainer.player.sampler = Scores()
    before = trainer.player.normaliser.count
    trainer.player.plan(0)
    collect(trainer)
    assert not trainer.player.learns and trainer.player.normaliser.count == before
    assert not trainer.player.recent
    play(trainer)
    assert trainer.player.normaliser.count > before
    trainer.close()


@pytest.mark.parametrize(
    "config", [MIXED, DOSED, GROWING, PLR, ACCEL], ids=["mixed", "dosed", "growing", "plr", "accel"]
)
def test_a_resumed_run_is_the_one_that_was_not_stopped(config, tmp_path, monkeypatch):
    train(config, tmp_path / "whole", progress=False)
    train_to_first_checkpoint(config, tmp_path / "parts", monkeypatch)
    train(config, tmp_path / "parts", progress=False)
    assert digest(tmp_path / "parts") == digest(tmp_path / "whole")
    assert checkpoint.metrics(tmp_path / "parts") == checkpoint.metrics(tmp_path / "whole")
    counted = checkpoint.metrics(tmp_path / "parts")[-1]
    if config is MIXED:
        assert 0 < counted["levels/shifted_fraction"] < 0.5
    elif config is DOSED:
        assert 250 < counted["levels/shifted_steps"] < 350
    elif config is GROWING:
        assert counted["levels/part"] == 1
    else:
        assert counted["levels/replayed"] == 4 * 16 and counted["levels/generated"] > 0
        assert (counted["levels/mutated"] > 0) == (config is ACCEL)


def begun(sampler, steps, count=4000):
    """The levels that a sampler begins after so many steps."""
    sampler.plan(steps)
    return sampler.next(np.arange(count))


def side(level):
    """Cells a side of the maze of a training level."""
    env = GameVectorEnv("maze", GROWING.training_variant(), 1)
    env.reset(options={"level": np.array([level])})
    return int(env.get_state()["maze_size"][0])


def test_levels_grow_from_the_smallest_to_those_of_the_variant_itself():
    sampler, steps = Growing(GROWING), GROWING.steps
    smallest = set(begun(sampler, 0))
    assert len(smallest) == round(FIRST * GROWING.levels)
    sides = {level: side(level) for level in GROWING.training_levels}
    assert {sides[level] for level in smallest} == {3}
    middle = set(begun(sampler, steps // 4))
    assert smallest < middle < set(GROWING.training_levels)
    assert max(sides[n] for n in middle) <= min(sides[n] for n in sides.keys() - middle)
    # Then each is as likely as the others.
    for now in (steps // 2, steps - 1):
        numbers = begun(sampler, now, 40_000)
        counts = np.bincount(numbers, minlength=GROWING.levels)
        assert len(counts) == GROWING.levels
        assert counts.min() > 120 and counts.max() < 290  # of 200 on average, +-5 deviations


def test_how_long_levels_grow_can_be_said():
    sampler = Growing(GROWING.changed(fraction=0.25))
    assert len(set(begun(sampler, GROWING.steps // 8))) == round(0.55 * GROWING.levels)
    assert len(set(begun(sampler, GROWING.steps // 4))) == GROWING.levels


class Numbered:
    """A sampler of somebody's own: environment i begins level i, always."""

    def __init__(self, config):
        self.count = np.zeros(1, np.int64)

    def plan(self, steps):
        return Plan(restart=steps == 0)

    def next(self, places):
        self.count += len(places)
        return places.astype(np.int64)

    def note(self, played):
        assert played.reward.shape == played.advantage.shape == (16, 16)

    def summary(self):
        return {"begun": float(self.count[0])}

    def arrays(self):
        return {"count": self.count}

    def restore(self, arrays):
        self.count = arrays["count"].copy()


def test_a_sampler_of_your_own_comes_in_as_a_class_and_by_its_name(tmp_path):
    train(TINY, tmp_path / "class", sampler=Numbered, progress=False)
    named = TINY.changed(sampler=f"{Numbered.__module__}:Numbered")
    train(named, tmp_path / "name", progress=False)
    assert digest(tmp_path / "class") == digest(tmp_path / "name")
    assert checkpoint.metrics(tmp_path / "class")[-1]["levels/begun"] > 16
    states = digest(tmp_path / "class")["training.states"]
    assert set(np.frombuffer(states, GAME.state)["level"]) == set(range(16))


def numbered(**methods):
    """A sampler as `Numbered`, but for some methods; settings name the last one."""
    globals()["Other"] = found = type("Other", (Numbered,), methods)
    return found


def test_a_sampler_chooses_the_first_levels_too():
    sampler = numbered(plan=lambda self, steps: Plan())
    with contextlib.closing(Trainer(loop.checked(TINY, sampler=sampler))) as trainer:
        trainer.player.plan(0)
        assert trainer.player.envs[0].states["level"].tolist() == [*range(16)]
        trainer.player.plan(256)
        assert trainer.player.sampler.arrays()["count"] == 16


@pytest.mark.parametrize(
    "method, message",
    [
        ({"next": lambda self, places: [0] * len(places)}, "must return an array of 16 levels"),
        ({"next": lambda self, places: places[:1]}, "must return an array of 16 levels"),
        ({"next": lambda self, places: 10**5 + places}, "from 0 to 99999, as others are for tests"),
        ({"plan": lambda self, steps: None}, "what a sampler plans must be a Plan"),
        ({"plan": lambda self, steps: Plan(learn="no")}, "a plan's learn must be a bool"),  # pyrefly: ignore
        ({"plan": lambda self, steps: Plan(learn=False)}, "must plan to learn from one of 3"),
        ({"summary": lambda self: {"begun": np.nan}}, "begun of a sampler's summary must be a fin"),
        ({"summary": lambda self: None}, "a sampler's summary must be a Mapping"),
        ({"arrays": lambda self: {"a": [1]}}, "a of a sampler must be an array of numbers"),
        ({"arrays": lambda self: []}, "a sampler's arrays must be a Mapping"),
        ({"restore": None}, "what .* makes must be a Sampler"),
        (  # no training could go on from its checkpoints
            {"arrays": lambda self: {"begun": np.arange(self.count[0])}},
            "arrays of a sampler must keep names, shapes and dtypes",
        ),
    ],
)
def test_what_a_sampler_must_not_do_is_told(method, message, tmp_path, monkeypatch):
    monkeypatch.setattr(loop, "SCORED", 3)
    sampler = numbered(**method)
    with pytest.raises(ValueError, match=message):
        trainer = Trainer(loop.checked(TINY, sampler=sampler))
        with contextlib.closing(trainer):
            loop.improve(trainer)


def leaves(*given):
    sys.exit(0)


def fails(*given):
    raise KeyError("mine")


@pytest.mark.parametrize("failing", [leaves, fails])
@pytest.mark.parametrize("method", ["plan", "next", "note", "summary", "arrays"])
def test_a_sampler_that_fails_at_any_time_is_told_in_a_sentence(method, failing, tmp_path):
    """One that called `sys.exit` ended the command without a word, as if the training were done."""
    said = r"Other fails: (SystemExit\(0\)|KeyError\('mine'\))"
    with pytest.raises(ValueError, match=said):
        train(TINY, tmp_path, sampler=numbered(**{method: failing}), progress=False)


def test_a_sampler_that_writes_to_what_it_is_told_changes_nothing_that_is_learned():
    def note(self, played):
        played.advantage[:] = played.reward[:] = 0

    learned = []
    for sampler in (Numbered, numbered(note=note)):
        with contextlib.closing(Trainer(loop.checked(TINY, sampler=sampler))) as trainer:
            loop.improve(trainer)
            learned.append(torch.cat([w.detach().flatten() for w in trainer.weights]))
    assert torch.equal(*learned)


@pytest.mark.parametrize(
    "change, message",
    [
        ({"sampler": "best"}, "one of uniform, mixed, growing, plr, accel, or module:Class"),
        ({"sampler": "mixed"}, "shift_probability must be between 0 and 1; got 0.0"),
        ({"sampler": "plr", "buffer": 8}, "a level for each of 16 environments; got 8"),
        ({"sampler": "plr", "replay": 0.0}, "replay must be from 0.01 to 1; got 0.0"),
        (
            {"sampler": "plr", "score": "regret", "variant": "region-1-strict", "validation": None},
            "a variant of a shift, which names the goal; got 'region-1-strict'",
        ),
        (
            {"sampler": "plr", "score": "regret", "game": "follow", "variant": "expert",
             "validation": None, "knobs": {}},
            "needs a goal that ends a level; 'order' does not end those of follow",
        ),
        (
            {"sampler": "accel", "game": "coinrun", "variant": "coin-end", "validation": None,
             "knobs": {}},
            "the game 'coinrun' has no mutation",
        ),
        (
            {"sampler": "mixed", "fraction": 0.6, "schedule": "annealed", "knobs": SHIFTED},
            "fraction must be at most 0.5 to be annealed; got 0.6",
        ),
    ],
)  # fmt: skip
def test_settings_that_cannot_be_are_explained(change, message, tmp_path):
    with pytest.raises(ValueError, match=message):
        train(TINY.changed(**change), tmp_path, progress=False)


def test_a_buffer_that_was_forged_is_refused():
    sampler = Replay(PLR)
    sampler.plan(0)
    arrays = sampler.arrays() | {"places": np.full(16, 64)}
    with pytest.raises(ValueError, match="buffer is not one that a training writes"):
        sampler.restore(arrays)
