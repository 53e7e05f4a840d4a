"""Any Gymnasium environment is evaluated as a game is; what is wrong with one is told."""

import contextlib
import copy
import gc
import itertools
import json
import multiprocessing
import os
import pickle
import signal
import subprocess
import sys
import threading
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import ClassVar
from unittest.mock import Mock

import gymnasium
import numpy as np
import polars as pl
import pytest
from gymnasium import spaces

from astray import acting, games
from astray import world as registry
from astray.analysis import video
from astray.analysis.adapters import Function, from_sb3
from astray.analysis.dataset import export, read_trajectories, trajectories
from astray.analysis.evaluate import evaluate
from astray.analysis.outcomes import INTENDED, MISGENERALIZED
from astray.analysis.policies import Random, Walk
from astray.analysis.runs import evaluate_policies
from astray.envs import worlds
from astray.envs.pool import usable_processors
from astray.envs.worlds import WorldVectorEnv, check_repeats
from astray.game import More, Never
from helpers.processes import environment
from helpers.rooms import CELLS, WORLD, Room
from helpers.thorough import thorough

LEVELS = np.array([3, 1, 4, 15, 9, 2, 6, 53, 58, 97])
RIGHT = Function(lambda seen: np.ones(len(seen), int), "right")


def by_hand(choose, place, level):
    """One episode in a loop of one's own: return, length, and when square and end were reached."""
    env, total, square, end = Room(place), 0.0, None, None
    seen, _ = env.reset(seed=level)
    for time in range(1, 100):
        seen, reward, terminated, truncated, _ = env.step(choose(seen))
        total += reward
        square = time if square is None and env.x == env.square else square
        end = time if end is None and env.x == CELLS - 1 else end
        if terminated or truncated:
            return level, total, time, terminated, square, end
    raise AssertionError("the episode does not end")


def troubled(trouble, **more):
    return replace(
        WORLD, variants=dict.fromkeys(WORLD.variants, partial(Room, trouble=trouble)), **more
    )


@pytest.mark.parametrize("batch, workers", [(1, False), (3, False), (256, False), (2, True)])
def test_the_table_is_that_of_a_loop_by_hand(batch, workers):
    world = replace(WORLD, workers=workers)
    table = evaluate(RIGHT, world, "anywhere", LEVELS, batch=batch)
    columns = ("level", "return", "length", "terminated", "reached_square", "reached_end")
    assert table.select(columns).rows() == [
        by_hand(lambda _: 1, "anywhere", int(k)) for k in LEVELS
    ]
    assert table["walked"].to_list() == table["length"].to_list()


def test_environments_whose_levels_are_done_take_no_more_steps():
    taken = []

    class Counted(Room):
        def step(self, action):
            taken.append(action)
            return super().step(action)

    variants = dict.fromkeys(WORLD.variants, partial(Counted, "anywhere"))
    world = replace(WORLD, variants=variants, repeats=False)  # else some are tried first
    assert evaluate(RIGHT, world, "anywhere", LEVELS, batch=4)["length"].sum() == len(taken)


class Moving(Room):
    """Its square is further from the left in each episode; the level says nothing of it."""

    episodes = 0

    def reset(self, **given):
        _, info = super().reset(**given)
        self.episodes += 1
        self.square = self.episodes % CELLS
        return self._seen(), info


class Shared(Room):
    """All of these have one place, as an object of the class's is of all."""

    place_of_all: ClassVar = [0]

    def reset(self, **given):
        super().reset(**given)
        self.x = int(self.np_random.integers(CELLS))
        self.place_of_all[0] = self.x
        return self._seen(), {}

    def step(self, action):
        self.x = self.place_of_all[0]
        taken = super().step(action)
        self.place_of_all[0] = self.x
        return taken


def test_environments_that_share_something_are_refused_where_several_play():
    """In a batch of one each is by itself, and so is each with a process."""
    world = replace(WORLD, variants=dict.fromkeys(WORLD.variants, Shared))
    alone, apart = (
        evaluate(RIGHT, replace(world, workers=workers), "anywhere", LEVELS, batch=batch)
        for workers, batch in ((False, 1), (True, 4))
    )
    assert alone.equals(apart)
    with pytest.raises(ValueError, match="last episode or another environment"):
        evaluate(RIGHT, world, "anywhere", LEVELS)


@pytest.mark.parametrize("levels, last", [(LEVELS, 2), ([3, 1], 1), ([3], 3)])
def test_an_environment_that_keeps_something_of_its_last_episode_is_refused(levels, last):
    world = replace(WORLD, variants=dict.fromkeys(WORLD.variants, Moving))
    with pytest.raises(ValueError, match=f"level 3 is another one .*, after level {last}: step 0"):
        evaluate(RIGHT, world, "anywhere", levels)


class Begun(Room):
    """Each has a place of its own from the beginning."""

    places = itertools.cycle(range(CELLS))

    def __init__(self, *given, **more):
        super().__init__(*given, **more)
        self.beginning = next(self.places)

    def reset(self, **given):
        _, info = super().reset(**given)
        self.square = self.beginning
        return self._seen(), info


def test_environments_that_differ_from_their_beginning_on_are_refused():
    world = replace(WORLD, variants=dict.fromkeys(WORLD.variants, Begun))
    with pytest.raises(ValueError, match="level 3 is another one"):
        evaluate(RIGHT, world, "anywhere", LEVELS)


class Follows(Room):
    """Its square lies elsewhere after level 2."""

    last = 0

    def reset(self, *, seed=None, options=None):
        _, info = super().reset(seed=seed, options=options)
        self.square, self.last = (self.square + (self.last == 2)) % CELLS, seed
        return self._seen(), info


def test_an_environment_that_keeps_something_of_one_level_in_three_is_refused():
    world = replace(WORLD, variants=dict.fromkeys(WORLD.variants, Follows))
    with pytest.raises(ValueError, match=r"level 3 is another one .*, after level 2: step 0"):
        evaluate(RIGHT, world, "anywhere", LEVELS)


def test_outcomes_base_rates_and_distinguishing_levels_are_those_of_games():
    rates, episodes = evaluate_policies([RIGHT], WORLD, "end", LEVELS)
    squares = {}
    for level in LEVELS:
        (env := Room("anywhere")).reset(seed=int(level))
        squares[level] = env.square
    right = episodes.filter(policy="right")
    for level, outcome, apart in right.select("level", "outcome", "distinguishing").rows():
        is_right = squares[level] > CELLS // 2
        assert outcome == (INTENDED if is_right else MISGENERALIZED)
        assert apart == (not is_right)
    told = {(r["policy"], r["outcome"]): r["mean"] for r in rates.to_dicts()}
    assert told[Walk("square").name, INTENDED] == told[Walk("end").name, MISGENERALIZED] == 1
    assert {"random", "right"} <= {*rates["policy"]} and rates["low"].null_count() == 0


def test_a_model_of_another_library_plays_as_by_hand():
    sb3 = pytest.importorskip("stable_baselines3")
    model = sb3.PPO("MlpPolicy", Room("anywhere"), seed=1, device="cpu")
    table = evaluate(from_sb3(model, greedy=True), WORLD, "anywhere", LEVELS, batch=4)

    def choose(seen):
        return int(model.predict(seen, deterministic=True)[0])

    hand = [by_hand(choose, "anywhere", int(level)) for level in LEVELS]
    columns = ("level", "return", "length", "terminated", "reached_square", "reached_end")
    assert table.select(columns).rows() == hand


def test_chance_takes_any_actions_and_none_depends_on_the_batch():
    one, two = (
        evaluate(
            Random(), WORLD, WORLD.variant("end").with_knobs({"vector": True}), LEVELS, batch=n
        )
        for n in (1, 4)
    )
    assert one.equals(two) and one["walked"].n_unique() > 1


@pytest.mark.parametrize("one", [[0.7, 1], ["1", "1"]])
def test_actions_that_would_be_rounded_or_read_are_refused(one):
    variant = WORLD.variant("end").with_knobs({"vector": True})
    with pytest.raises(ValueError, match=r"must return 2 actions in room end, .*each of Multi"):
        evaluate(Function(lambda seen: np.array([one] * len(seen))), WORLD, variant, range(2))
    rounded = Function(lambda seen: np.full((len(seen), 2), 1.0))  # as SB3 has of a MultiBinary
    assert evaluate(rounded, WORLD, variant, range(2))["reached_end"].null_count() == 0


def test_rewards_and_data_sets_have_the_measures_of_each_step():
    def later(step):
        return (step.after["walked"] - step.before["walked"]) * step.after["time"]

    table = evaluate(Random(), WORLD, "anywhere", LEVELS, rewards={"later": later})
    assert (table["later"] == table["length"] * (table["length"] + 1) / 2).all()
    for one in trajectories(Random(), WORLD, "anywhere", LEVELS):
        assert one.states["walked"].tolist() == [*range(len(one) + 1)]


class Slippery(Room):
    """Draws every third action from its own space, which the level's number seeds."""

    def reset(self, *, seed=None, options=None):
        self.action_space.seed(seed)
        return super().reset(seed=seed, options=options)

    def step(self, action):
        return super().step(action if self.time % 3 else self.action_space.sample())


def test_chance_seeds_no_space_that_an_environment_draws_from():
    variants = dict.fromkeys(WORLD.variants, partial(Slippery, "anywhere", True))
    world = replace(WORLD, variants=variants)
    one, two = (evaluate(Random(), world, "anywhere", LEVELS, batch=n) for n in (1, 4))
    assert one.equals(two)


class Masked(Room):
    """Refuses to go left, as its mask says."""

    def reset(self, **given):
        return super().reset(**given)[0], {"action_mask": np.array([0, 1], np.int8)}

    def step(self, action):
        if not action:
            raise ValueError("an illegal action")
        return *super().step(action)[:4], {"action_mask": np.array([0, 1], np.int8)}


@pytest.mark.parametrize("workers", [False, True])
def test_chance_and_the_check_of_repeats_take_only_actions_that_a_mask_allows(workers):
    variants = dict.fromkeys(WORLD.variants, partial(Masked, "anywhere"))
    events = WORLD.events | {"reached_square": lambda env, _: env.x == env.square}
    world = replace(WORLD, variants=variants, events=events, workers=workers)
    chance, right = (
        evaluate(policy, world, "end", LEVELS[:4], batch=2) for policy in (Random(), RIGHT)
    )
    assert chance.drop("policy").equals(right.drop("policy"))


class Nameless(Exception):
    def __repr__(self):
        raise self


def nameless(env):
    raise Nameless


def test_an_image_without_pixels_is_refused():
    class Empty(Room):
        def render(self):
            return np.zeros((0, 0, 3), np.uint8)

    variants = {v: partial(Empty, render_mode="rgb_array") for v in WORLD.variants}
    with pytest.raises(ValueError, match=r"must render images .* of shape \(0, 0, 3\)"):
        video.play(RIGHT, replace(WORLD, variants=variants), "end", 0)


def test_an_episode_has_every_part_of_what_it_showed():
    space = spaces.Tuple((spaces.Box(0, 1, (2, CELLS)), spaces.Discrete(3)))
    made = partial(
        gymnasium.wrappers.TransformObservation,
        func=lambda seen: (seen, 2),
        observation_space=space,
    )
    world = replace(WORLD, shifts={}, variants={"end": lambda **knobs: made(Room(**knobs))})
    right = Function(lambda seen: np.ones(len(seen[0]), int))
    room, two = video.play(right, world, "end", 3).observations
    assert (room == video.play(RIGHT, WORLD, "end", 3).observations).all()
    assert two.tolist() == [2] * len(room)


def test_states_of_a_video_have_the_measures_of_every_step():
    told = video.play(RIGHT, replace(WORLD, measures={"steps": lambda env: env.steps}), "end", 3)
    assert told.states["steps"].tolist() == [*range(len(told.states))]


def test_images_of_several_shapes_are_no_video():
    class Growing(Room):
        def render(self):
            return np.zeros((10 + self.time, 10, 3), np.uint8)

    world = replace(WORLD, shifts={}, variants={"end": Growing})
    with pytest.raises(
        ValueError, match=r"room end.*level 3: images of a video must have one shape"
    ):
        video.play(RIGHT, world, "end", 3)


@pytest.mark.parametrize(
    "shown, said",
    [
        ({}, "KeyError"),
        ({"room": np.zeros(2)}, "ValueError"),
        ({"room": np.zeros((2, CELLS), str)}, "TypeError"),
    ],
)
def test_parts_that_are_not_of_their_space_are_told(shown, said):
    class Parts(Room):
        def _seen(self):
            return shown

    world = replace(WORLD, shifts={}, variants={"end": partial(Parts, trouble="parts")})
    policy = Function(lambda seen: np.ones(len(seen["room"]), int))
    with pytest.raises(ValueError, match=f"an observation is not of its space Dict.*{said}"):
        evaluate(policy, world, "end", [3, 4])
    if said != "ValueError":  # which a process does not tell from others
        with pytest.raises(ValueError, match=rf"of their space, or World\(workers=False\): {said}"):
            evaluate(policy, replace(world, workers=True), "end", [3, 4])


def test_knobs_are_arguments_of_the_factory():
    told = evaluate(RIGHT, WORLD, WORLD.variant("end").with_knobs({"place": "anywhere"}), LEVELS)
    assert told["reached_square"].null_count() > 0


@pytest.mark.parametrize(
    "said, meant", [("0", 0), ("False", False), ("1.5", 1.5), ("None", None), ("8x8", "8x8"),
                    ("[1]", "[1]"), ("nan", "nan"), ("1" * 5000, "1" * 5000)]
)  # fmt: skip
def test_a_knob_is_the_number_or_word_that_its_text_says(said, meant):
    def made(size=3, name="end", **others):
        return Room()

    world = replace(WORLD, variants={**WORLD.variants, "end": made})
    knobs = world.variant("end").with_knobs({"size": said, "name": said, "other": said}).knobs
    assert knobs == {"size": meant, "name": said, "other": meant}
    assert type(knobs["size"]) is type(meant)


def test_a_knob_that_is_text_is_text_in_variants_that_pass_it_on():
    """Training read `room=1` as text, and the test as a number."""
    passed = {"end": lambda room="0": Room(), "test": lambda **knobs: Room(**knobs)}
    world = replace(WORLD, shifts={}, variants=passed)
    read = [world.variant(one).with_knobs({"room": "1"}).knobs["room"] for one in passed]
    assert read == ["1", "1"]


@pytest.mark.parametrize(
    "world, policy, said",
    [
        (troubled("raises"), RIGHT, r"room anywhere, level 3, step 3: its step fails: KeyError"),
        (troubled("shrinks"), RIGHT, r"step 3: the observation is of shape \(2, 3\), .* \(2, 9\)"),
        (troubled("draws"), RIGHT, "is another one when it is played again with the same actions"),
        (troubled("none", events={**WORLD.events, "reached_end": "ended"}), RIGHT,
         "'reached_end' of room is the key 'ended' of info, which no step reported; .*: square"),
        (troubled("none", events={**WORLD.events, "reached_end": lambda env: True}), RIGHT,
         "level 3, step 0: its event 'reached_end' fails: TypeError"),
        (replace(WORLD, variants={"end": Room, "anywhere": lambda: 1 / 0}), RIGHT,
         "the factory of room anywhere fails: division by zero"),
        (replace(WORLD, variants={"end": Room, "anywhere": lambda: 3}), RIGHT,
         "the factory of room anywhere returns must be a Env; got 3"),
        (replace(WORLD, variants=dict.fromkeys(WORLD.variants, sys.exit)), RIGHT,
         r"the factory of room anywhere fails: SystemExit\(\)"),
        (replace(WORLD, experts={"end": sys.exit}), RIGHT, "expert of 'end' fails: SystemExit"),
        (replace(WORLD, measures={"walked": sys.exit}), RIGHT, "'walked' fails: SystemExit"),
        (replace(WORLD, measures={"walked": nameless}), RIGHT, "fails: <Nameless instance at"),
        (troubled("none", events={**WORLD.events, "reached_end": lambda *_: sys.exit(0)}), RIGHT,
         r"its event 'reached_end' fails: SystemExit\(0\)"),
        (troubled("no info"), RIGHT, "level 3, step 1: its info must be a dictionary; got None"),
        (troubled("stuck"), RIGHT, r"its close fails: OSError\('busy'\)"),
        (troubled("exits"), RIGHT, r"step 3: its step fails: SystemExit\(3\)"),
        (troubled("speaks"), RIGHT, "the observation is of <U32, where the space says float32"),
        (troubled("murmurs"), RIGHT, "step 3: the observation is of <U32, where the space says"),
        (WORLD, Function(lambda seen: 1 / 0, "lost"), r"lost fails: ZeroDivisionError\('divis"),
        (WORLD, Function(lambda seen: np.full(len(seen), 2)), "from 0 to 1; got 2 to 2"),
        (WORLD, Function(lambda seen: np.full(len(seen), 0.5)), r"integers \[1\].*got float64"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_told_in_a_sentence(world, policy, said):
    with pytest.raises(ValueError, match=said):
        evaluate_policies([policy], world, "end", LEVELS)


def test_a_key_that_no_step_reported_is_told_where_one_policy_is_evaluated():
    world = replace(WORLD, events={"reached_end": "ended", "reached_square": "square"})
    with pytest.warns(worlds.Unreported, match="the key 'ended' of info, .*; keys were: square"):
        assert len(evaluate(RIGHT, world, "end", LEVELS)) == len(LEVELS)
    with pytest.raises(
        ValueError, match="the key 'ended' of info"
    ):  # and no warning, an error here
        evaluate_policies([RIGHT], world, "end", LEVELS)


def rate_of_nothing(env):
    return np.float64(np.nan) if env.steps < 3 else 0.5


@pytest.mark.parametrize("part, name, told", [
    ("events", "return", "room have the names of columns: return$"),
    ("measures", "return", "room have the names of columns: return$"),
    ("measures", "seed", "room have the names of columns: seed$"),
    ("events", "test", "room have the names of columns: test$"),
    ("measures", "mean", r"need other names than \['mean'\]"),
    ("measures", "time", r"need other names than \['time'\]"),
    ("events", "", r"need other names than \[''\]"),
])  # fmt: skip
def test_names_that_a_table_or_a_record_cannot_have_are_refused_where_a_world_is_made(
    part, name, told
):
    with pytest.raises(ValueError, match=told):
        replace(WORLD, **{part: {**vars(WORLD)[part], name: "square"}})


@pytest.mark.parametrize(
    "changes, said",
    [
        ({"events": {**WORLD.events, 1: "square"}}, "each name of events must be a str; got 1"),
        ({"shifts": {"end": ("end", "anywhere", "square", ())}}, "a shift must be a Shift"),
        ({"ends": {"burnt": "gone"}}, "unknown event of a goal 'gone'"),
        ({"ends": {"unburnt": Never("gone")}}, "unknown event of a goal 'gone'"),
        ({"ends": {"often": More("gone")}}, "unknown measure of a goal 'gone'; there are: walked"),
        ({"ends": {"often": More("walked", "gone")}}, "unknown measure of a goal 'gone'"),
        ({"ends": {"often": More("walked", np.nan)}}, "must be a finite number; got nan"),
        ({"ends": {"often": 3}}, "unknown event of a goal 3"),
        ({"goals": {**WORLD.goals, "device": "square", "another cell": "square"}},
         "a goal must have a name of its own; got another cell, device"),
        ({"goals": {**WORLD.goals, "undecided": "square"}}, "name of its own; got undecided"),
        ({"goals": {**WORLD.goals, "neither": "square"}}, "name of its own; got neither"),
        ({"events": {**WORLD.events, "reached_end": lambda *_: np.zeros(2)}},
         "step 0: its event 'reached_end' must be True or False; got"),
        ({"events": {**WORLD.events, "reached_end": lambda *_: np.nan}}, "True or False; got nan"),
        ({"events": {**WORLD.events, "reached_end": lambda *_: "no"}}, "True or False; got 'no'"),
    ],
)  # fmt: skip
def test_names_and_goals_that_cannot_be_are_refused(changes, said):
    with pytest.raises(ValueError, match=said):
        evaluate_policies([RIGHT], replace(WORLD, **changes), "end", LEVELS)


def test_a_measure_that_is_no_number_yet_repeats_itself():
    world = replace(WORLD, measures={"rate": rate_of_nothing})
    assert evaluate_policies([RIGHT], world, "end", LEVELS).episodes["rate"].is_nan().any()


@pytest.mark.waits
@pytest.mark.parametrize(
    "trouble, said",
    [("dies", "the process of an environment"), ("hangs", "did not answer for 2 s")],
)
def test_a_worker_that_dies_or_hangs_is_told(trouble, said):
    world = troubled(trouble, workers=True, patience=2.0, repeats=False)
    with pytest.raises(RuntimeError, match=said):
        evaluate(RIGHT, world, "anywhere", LEVELS, batch=2)


@pytest.mark.waits
def test_an_environment_that_hangs_in_this_process_is_interrupted():
    world = troubled("hangs", patience=1.0, repeats=False)
    with pytest.raises(RuntimeError, match=r"room anywhere.* did not answer for 1 s"):
        evaluate(RIGHT, world, "anywhere", LEVELS, batch=2)


@pytest.mark.waits
@pytest.mark.parametrize(
    "trouble, workers, said",
    [
        ("dies", True, "the process of an environment"),
        ("hangs", True, "did not answer for 2 s"),
        ("hangs", False, "did not answer for 2 s"),
    ],
)
def test_the_level_that_is_played_twice_is_watched(trouble, workers, said):
    world = troubled(trouble, workers=workers, patience=2.0)
    with pytest.raises(RuntimeError, match=said):
        check_repeats(world, world.variant("anywhere"), (3,), 1)


@pytest.mark.parametrize("workers", [False, True])
def test_observations_without_a_number_are_told(workers):
    world = troubled("blurs", workers=workers)
    with pytest.raises(ValueError, match="level 3, step 3: the observation has NaN"):
        evaluate(RIGHT, world, "end", [3, 4], batch=2)


def test_observations_of_several_parts_without_a_number_are_told():
    def first(seen):
        return np.ones(len(seen["room"]), int)

    table = evaluate(Function(first, "first"), troubled("parts"), "end", [3, 4])
    assert table["terminated"].all()
    for repeats in (False, True):
        with pytest.raises(ValueError, match="level 3, step 3: the observation has NaN"):
            play(Function(first, "first"), troubled("blurred parts", repeats=repeats))


class Said(spaces.Space):
    """A space of one's own, as MiniGrid's missions."""

    def contains(self, x):
        return isinstance(x, str)

    def __eq__(self, other):
        return isinstance(other, Said)


@pytest.mark.parametrize("workers", [False, True])
@pytest.mark.parametrize(
    "space, shown",
    [
        (spaces.Tuple((spaces.Box(0, 1, (2, CELLS)), spaces.Discrete(3))), lambda seen: (seen, 2)),
        (spaces.Dict(room=spaces.Box(0, 1, (2, CELLS)), said=spaces.Text(9)),
         lambda seen: {"room": seen, "said": "go on"}),
        (spaces.Sequence(spaces.Discrete(CELLS)), lambda seen: (*range(seen[0].argmax()),)),
        (Said(), lambda seen: "go on"),
    ],
    ids=["tuple", "text", "sequence", "custom"],
)  # fmt: skip
def test_observations_of_any_space_are_in_rows(space, shown, workers):
    def made(**knobs):
        return gymnasium.wrappers.TransformObservation(Room("anywhere", **knobs), shown, space)

    def choose(seen):
        parts = [*seen.values()] if isinstance(seen, dict) else seen
        parts = parts if isinstance(parts, list | tuple) else [parts]
        (count,) = {len(part) for part in parts}
        return np.ones(count, int)

    world = replace(WORLD, variants=dict.fromkeys(WORLD.variants, made), workers=workers)
    told = evaluate(Function(choose, "right"), world, "anywhere", LEVELS, batch=4)
    assert told.equals(evaluate(RIGHT, WORLD, "anywhere", LEVELS))


def play(policy, world):
    return evaluate_policies([policy], world, "end", [3, 4], variant="end")


@pytest.mark.parametrize("workers", [False, True])
def test_observations_outside_their_space_are_told_once(workers, caplog):
    world = troubled("bright", workers=workers, name=f"bright room {workers}")
    said = f"observations of bright room {workers} are not all in Box(0.0, 1.0, (2, 9), float32)"
    for _ in range(2):
        play(RIGHT, world)
    assert [one for one in caplog.messages if "levels played" not in one] == [said]


@pytest.mark.parametrize("workers", [False, True])
def test_a_walk_to_a_goal_without_an_expert_is_refused_by_its_name(workers):
    world = replace(WORLD, experts={"end": WORLD.experts["end"]}, workers=workers)
    with pytest.raises(ValueError, match=r"unknown goal of an expert 'square' of room; .*: end$"):
        play(Walk("square"), world)


def test_observations_of_several_parts_are_no_data_set(tmp_path):
    policy = Function(lambda seen: np.ones(len(seen["room"]), int))
    with pytest.raises(ValueError, match=r"shows in a data set must be a ndarray; got .'room'"):
        export(policy, troubled("parts"), "end", [3, 4], tmp_path / "set")
    assert not (tmp_path / "set").exists()


def test_observations_of_text_are_no_data_set(tmp_path):
    def made(**knobs):
        return gymnasium.wrappers.TransformObservation(Room(**knobs), lambda seen: "go", Said())

    world = replace(WORLD, variants=dict.fromkeys(WORLD.variants, made))
    with pytest.raises(ValueError, match=r"in a data set must be of numbers; got array\(\['go'"):
        export(RIGHT, world, "end", [3, 4], tmp_path / "set")


def test_actions_of_several_parts_are_refused_before_the_first_step():
    with pytest.raises(ValueError, match=r"actions of room end must be numbers or .*; got Tuple"):
        play(RIGHT, troubled("two answers"))


@pytest.mark.waits
def test_a_process_that_hangs_where_it_closes_is_ended():
    world = troubled("stays", workers=True, patience=1.0)
    assert evaluate(RIGHT, world, "anywhere", LEVELS[:2], batch=1).height == 2


@pytest.mark.skipif(os.name == "nt", reason="signals there end processes")
def test_processes_of_environments_leave_interrupts_to_their_parent(capfd, monkeypatch):
    env = WorldVectorEnv(replace(WORLD, workers=True), "anywhere", 2)
    env.reset(options={"level": np.arange(2)})
    for process in env._envs.processes:
        os.kill(process.pid, signal.SIGINT)
    env.step(np.ones(2, int))
    with monkeypatch.context() as amid, pytest.raises(KeyboardInterrupt):
        amid.setattr(env._envs, "step_wait", Mock(side_effect=KeyboardInterrupt))
        env.step(np.ones(2, int))
    env.close()
    assert not multiprocessing.active_children() and capfd.readouterr().err == ""


def test_a_signal_while_processes_begin_is_that_signal(monkeypatch):
    def begin(*_, **__):
        with contextlib.suppress(KeyboardInterrupt):  # as Python does amid a fork
            signal.raise_signal(signal.SIGINT)
        raise BrokenPipeError  # of processes that had the signal, too

    monkeypatch.setattr(worlds, "AsyncVectorEnv", begin)
    before = signal.getsignal(signal.SIGINT)
    with pytest.raises(KeyboardInterrupt):
        WorldVectorEnv(replace(WORLD, workers=True), "anywhere", 2)
    assert signal.getsignal(signal.SIGINT) is before


def test_a_process_that_dies_where_it_begins_is_told():
    def make():
        return os._exit(1) if multiprocessing.parent_process() else Room("anywhere")

    world = replace(WORLD, workers=True, variants={"end": make, "anywhere": make})
    with pytest.raises(RuntimeError, match="the process of an environment of room end died"):
        WorldVectorEnv(world, "end", 2)


# Python 3.13 frees what was being pickled before what looks at it.
@pytest.mark.filterwarnings("ignore:Exception ignored in. <_io.BytesIO:pytest.PytestWarning")
@pytest.mark.parametrize("which", ["observation_space", "info"])
def test_what_a_process_cannot_send_is_told_in_a_sentence(which):
    class Keeps(Room):
        def reset(self, **given):
            seen, info = super().reset(**given)
            return seen, info | ({"lock": threading.Lock()} if which == "info" else {})

    def make():
        env = Keeps("anywhere")
        if which != "info":
            vars(env.observation_space)["lock"] = threading.Lock()
        return env

    world = replace(WORLD, workers=True, variants={"end": make, "anywhere": make})
    said = (
        r"spaces and infos of room end must be picklable, .*, or World\(workers=False\): .*cannot"
    )
    with pytest.raises(ValueError, match=said):
        WorldVectorEnv(world, "end", 2).reset(options={"level": [1, 2]})
    gc.collect()
    assert not multiprocessing.active_children()


def test_an_interrupt_while_actions_are_sent_is_no_error(monkeypatch):
    env = WorldVectorEnv(replace(WORLD, workers=True), "anywhere", 2)
    env.reset(options={"level": np.arange(2)})
    with monkeypatch.context() as amid, pytest.raises(KeyboardInterrupt):
        amid.setattr(env._envs.parent_pipes[1], "send", Mock(side_effect=KeyboardInterrupt))
        env.step(np.ones(2, int))
    env.close()  # the answer of the first waits, which is of nothing that is asked now
    assert not multiprocessing.active_children()


DEFAULT, *OTHERS = multiprocessing.get_all_start_methods()


@pytest.mark.parametrize("how", [DEFAULT, *thorough(*OTHERS)])
def test_processes_of_environments_begin_in_any_way(how):
    """They fork on Linux alone, until Python 3.14, and unless torchrl is imported."""
    multiprocessing.set_start_method(how, force=True)
    apart = evaluate(RIGHT, replace(WORLD, workers=True), "anywhere", LEVELS[:4], batch=2)
    assert apart.equals(evaluate(RIGHT, WORLD, "anywhere", LEVELS[:4], batch=2))


COUNTED = """
import os
import gymnasium
import astray

os.write(1, b"imported\\n")

def lake():
    return gymnasium.make("FrozenLake-v1")

def gift(env, info):
    return env.s == 15

LAKE = astray.World(
    name="lake",
    variants={"map": lake},
    events={"gift": gift},
    goals={"gift": "gift"},
    shifts={},
    workers=True,
)
"""
MANY = """
import multiprocessing
import numpy as np

if __name__ in ({names!r}):
    multiprocessing.set_start_method({how!r}, force=True)
    from astray.envs.worlds import WorldVectorEnv
    from counted import LAKE
    env = WorldVectorEnv(LAKE, "map", 4)
    print(env.reset(options={{"level": np.arange(4)}})[0], flush=True)
    env.close()
"""
FRESH = [one for one in (DEFAULT, *OTHERS) if one != "fork"]


def begun(folder, how, *names):
    """A script that begins environments in processes where it has one of the names."""
    (folder / "counted.py").write_text(COUNTED)
    (folder / "many.py").write_text(MANY.format(how=how, names=names))
    paths = os.pathsep.join([str(folder), environment()["PYTHONPATH"]])
    command = [sys.executable, folder / "many.py"]
    return subprocess.run(
        command, env=environment(PYTHONPATH=paths), capture_output=True, text=True
    )


@pytest.mark.skipif("forkserver" not in FRESH, reason="there is no such server")
def test_a_server_of_forks_imports_a_world_once_for_all_its_processes(tmp_path):
    """Each took a second and more, and an evaluation has hundreds."""
    done = begun(tmp_path, "forkserver", "__main__")
    assert sorted(done.stdout.split("\n")) == ["", "[0 0 0 0]", "imported", "imported"], done.stderr


@pytest.mark.parametrize("how", [FRESH[-1], *thorough(*FRESH[:-1])])
def test_a_script_that_begins_processes_where_it_is_imported_is_told(tmp_path, how):
    done = begun(tmp_path, how, "__main__", "__mp_main__")
    assert "died, as of a script without `if __name__ == '__main__':`" in done.stderr


def test_two_processes_a_processor_play_at_a_time():
    """More play no faster, and where processes do not fork 24 took 1.3 GB and 20 s to begin."""
    asked = []

    def right(seen):
        asked.append(len(seen))
        return np.ones(len(seen), int)

    most = 2 * usable_processors()
    levels = np.arange(2 * most + 1)
    apart = evaluate(Function(right, "right"), replace(WORLD, workers=True), "anywhere", levels)
    assert max(asked) == most and apart.equals(evaluate(RIGHT, WORLD, "anywhere", levels))


class Below(Room):
    """Goes right if an action less 2 is below 0."""

    def step(self, action):
        return super().step(action - 2 < 0)


def test_actions_of_few_bits_do_not_overflow_in_an_environment():
    world = replace(WORLD, variants={"end": Below, "anywhere": Below})
    few = Function(lambda seen: np.ones(len(seen), np.uint8), "few")
    assert evaluate(few, world, "end", LEVELS[:2])["reached_square"].to_list() == [4, 4]


def test_a_variant_of_a_world_is_copied_and_pickled():
    variant = replace(WORLD.variant("end"), knobs={"size": 5})
    for again in (pickle.loads(pickle.dumps(variant)), copy.copy(variant), copy.deepcopy(variant)):
        assert str(again) == str(variant) and again.size == 5
    with pytest.raises(AttributeError, match="room end has no 'colour'"):
        _ = variant.colour


def test_the_end_of_all_processes_at_once_is_no_other_error(monkeypatch):
    env = WorldVectorEnv(replace(WORLD, workers=True), "anywhere", 2)
    env.reset(options={"level": np.arange(2)})
    with monkeypatch.context() as amid, pytest.raises(KeyboardInterrupt), contextlib.closing(env):
        amid.setattr(env._envs, "step_wait", Mock(side_effect=KeyboardInterrupt))
        try:
            env.step(np.ones(2, int))
        finally:
            amid.undo()
            for process in env._envs.processes:
                process.terminate()
                process.join()
    assert not multiprocessing.active_children()


def test_an_episode_that_an_event_of_its_reset_ends_has_the_measures_of_its_step():
    world = replace(WORLD, events={**WORLD.events, "begun": lambda env, info: True})
    table = evaluate(RIGHT, world, "anywhere", LEVELS, until=["begun"])
    assert set(table["length"]) == set(table["walked"]) == {1} and set(table["begun"]) == {0}


def test_an_episode_without_end_is_left_after_the_longest(monkeypatch):
    left = Function(lambda seen: np.zeros(len(seen), int), "left")
    table = evaluate(left, troubled("endless"), "end", LEVELS, longest=30)
    assert table["length"].to_list() == [30] * len(LEVELS) and not table["terminated"].any()
    monkeypatch.setattr(acting, "OF_WORLD", 500)
    with pytest.raises(
        ValueError, match=r"after 500 steps: say `longest`, after which an episode is left$"
    ):
        evaluate(left, troubled("endless"), "end", LEVELS[:1])
    with pytest.raises(ValueError, match="after 500 steps") as told:
        evaluate(left, troubled("endless", workers=True), "end", LEVELS[:1])
    assert told.tb and not multiprocessing.active_children()  # which would end with tracebacks


def test_episodes_none_of_which_ends_are_told_before_they_are_refused(monkeypatch, caplog):
    monkeypatch.setattr(acting, "OF_WORLD", 500)
    monkeypatch.setattr(acting, "EVERY", 0.0)
    caplog.set_level("INFO", "astray.acting")
    left = Function(lambda seen: np.zeros(len(seen), int), "left")
    with pytest.raises(ValueError, match="after 500 steps"):
        evaluate(left, troubled("endless"), "end", LEVELS[:2])
    said = "levels played; those begun go on after {} steps: `longest` truncates episodes"
    assert caplog.messages == [f"0 of 2 {said.format(1)}"]
    evaluate(left, troubled("endless"), "end", LEVELS[:2], longest=30)
    assert caplog.messages[1:] == ["2 of 2 levels played"]
    evaluate(left, "maze", "corner-small", LEVELS[:2])  # whose time is limited
    assert not [one for one in caplog.messages[2:] if "longest" in one]
    of_game = games.find("maze").variant("corner-small").with_knobs({"time_limit": 20_000})
    next(acting.steps(left, "maze", of_game, LEVELS[:2]))
    assert [one for one in caplog.messages if "longest" in one][1:] == [f"0 of 2 {said.format(1)}"]
    with pytest.raises(ValueError, match="after 500 steps"):
        video.play(left, troubled("endless"), "end", 3)
    assert caplog.messages[-1] == f"0 of 1 {said.format(1)}"


def test_a_level_without_end_after_others_is_told_where_nobody_asked_for_progress(
    monkeypatch, caplog
):
    monkeypatch.setattr(acting, "OF_WORLD", 500)
    monkeypatch.setattr(acting, "EVERY", 6)
    clock = itertools.count()  # a second for each step
    monkeypatch.setattr(acting, "time", SimpleNamespace(monotonic=lambda: next(clock)))
    moves = itertools.chain([1] * 4, itertools.repeat(0))  # to the square, then never
    policy = Function(lambda seen: np.full(len(seen), next(moves)), "once")
    with pytest.raises(ValueError, match="after 500 steps"):
        evaluate(policy, troubled("endless"), "end", LEVELS[:2], batch=1)
    said = "those begun go on after 3 steps: `longest` truncates episodes"
    assert caplog.messages == [f"1 of 2 levels played; {said}"]


def test_what_a_world_names_must_be_there():
    with pytest.raises(ValueError, match="unknown event of a goal 'gone'; there are: reached_"):
        replace(WORLD, goals={**WORLD.goals, "end": "gone"})
    with pytest.raises(ValueError, match=f"an end must have a name of its own; got {INTENDED}"):
        replace(WORLD, ends={INTENDED: "reached_end"})
    with pytest.raises(ValueError, match="unknown goal of an expert 'gone'"):
        replace(WORLD, experts={"gone": lambda env: 0})
    with pytest.raises(ValueError, match="unknown variant of room 'gone'; there are: end, any"):
        evaluate(RIGHT, WORLD, "gone", LEVELS)


def test_the_command_line_takes_a_world(astray):
    words = ("evaluate", "--policy", "helpers.rooms:go_right", "--shift", "end", "--levels", "0:9")
    rates = json.loads(astray(*words, "--world", "helpers.rooms:WORLD", "--json"))
    told = {(r["policy"], r["outcome"]): r["mean"] for r in rates if r["levels_played"] == "all"}
    hand = [by_hand(lambda _: 1, "anywhere", level)[4] is not None for level in range(9)]
    assert told["helpers.rooms:go_right", INTENDED] == pytest.approx(np.mean(hand))
    assert "walked" in astray(*words, "--world", "helpers.rooms:WORLD")
    assert "--world must be a World; got 9" in astray(
        *words, "--world", "helpers.rooms:CELLS", fails=True
    )


def test_the_command_line_measures_rewards_of_ones_own(astray, tmp_path):
    words = ("evaluate", "--policy", "helpers.rooms:go_right", "--shift", "end", "--levels", "0:9")
    words += ("--world", "helpers.rooms:WORLD", "--rewards", "helpers.rooms:each_step")
    assert "each_step" in astray(*words, "--out", str(tmp_path / "episodes.parquet"))
    table = pl.read_parquet(tmp_path / "episodes.parquet")
    assert (table["each_step"] == table["length"]).all()
    words = (*words[:-1], "helpers.rooms:each_step", "helpers.rooms:each_step")
    assert "two of these have one name" in astray(*words, fails=True)


def test_an_ability_that_a_world_lacks_is_told():
    with pytest.raises(ValueError, match="the game 'room' has no editing, which this needs"):
        WORLD.editing.grid(None)
    with pytest.raises(ValueError, match="a game must be a Game or its name; got World"):
        games.find(WORLD)  # pyrefly: ignore
    assert not WORLD.solver


@pytest.mark.parametrize("knobs", [{}, {"vector": True}, {"vector": 2}])
def test_episodes_of_a_world_are_exported_and_read_as_they_were(tmp_path, knobs, monkeypatch):
    variant = WORLD.variant("anywhere").with_knobs(knobs)
    folder = export(Random(), WORLD, variant, LEVELS, tmp_path / "data")
    written = {one.level: one for one in trajectories(Random(), WORLD, variant, LEVELS)}
    read = {one.level: one for one in read_trajectories(folder, WORLD)}
    assert set(read) == set(LEVELS.tolist())
    for level, one in read.items():
        for part in ("observations", "actions", "rewards", "states"):
            assert (getattr(one, part) == getattr(written[level], part)).all(), part
    assert read[3].observations.dtype == np.float32
    with pytest.raises(ValueError, match="Minari's layout is of games; room is a World"):
        export(Random(), WORLD, variant, LEVELS, tmp_path / "minari", form="minari")
    monkeypatch.setitem(registry._registered, WORLD.name, WORLD)  # whose name files know then
    assert {one.level for one in read_trajectories(folder)} == set(read)
    with pytest.raises(ValueError, match="it is of 'room', not of 'other'"):
        next(read_trajectories(folder, replace(WORLD, name="other")))
