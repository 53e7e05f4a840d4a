"""Any settings, knobs and experiments are kept as they are given, or refused."""

import json
from dataclasses import fields, replace

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from astray import games
from astray.envs.vector import GameVectorEnv
from astray.experiments import spec
from astray.experiments.spec import SIZES, Experiment, Plan
from astray.training.config import Config
from helpers.anything import ANYTHING, CONFIG, GAMES, tried, tries


@tries(50)
@given(
    st.dictionaries(
        st.sampled_from([f.name for f in fields(Config)] + ["more"]),
        ANYTHING | st.sampled_from(["maze", "corner", 1, 0.5]),
        max_size=3,
    )
)
def test_settings_are_refused_or_kept(changes):
    try:
        config = Config.from_json(json.loads(json.dumps(CONFIG.to_json() | changes)))
    except ValueError:
        assert changes
        tried("settings", 1)
        return
    for name, value in changes.items():
        if name != "training_variant":
            assert getattr(config, name) == value
    tried("settings", 0)


@tries(50)
@given(st.data())
def test_knobs_are_refused_or_make_levels(data):
    game = data.draw(st.sampled_from(GAMES))
    made = games.find(game)
    name = data.draw(st.sampled_from(list(made.variants)))
    names = [f.name for f in fields(made.variants[name])] + ["more"]
    value = ANYTHING | st.integers(-2, 40) | st.sampled_from(["none", "corner", "1", "true", "2.5"])
    changes = data.draw(st.dictionaries(st.sampled_from(names), value, max_size=3))
    try:
        variant = games.find(game).variant(name).with_knobs(changes)
    except ValueError:
        assert changes
        tried("knobs", 1)
        return
    env = GameVectorEnv(game, variant, 2, observation="symbolic", autoreset_mode="SameStep")
    seen, _ = env.reset(seed=0)
    assert seen in env.observation_space
    made.check(env.states, variant)
    env.step(np.zeros(2, int))
    tried("knobs", 0)


@tries(30)
@given(st.data())
def test_an_experiment_is_refused_or_can_be_run(data):
    game = data.draw(st.sampled_from(GAMES))
    made = games.find(game)
    words = st.sampled_from([*made.variants, *made.shifts, *GAMES, "more"])

    def mostly(*right):  # one draw in ten is of anything
        return data.draw(words if data.draw(st.integers(0, 9)) == 0 else st.sampled_from(right))

    shift = mostly(*made.shifts)
    train = made.shifts[shift].train if shift in made.shifts else "corner"
    knobs = (
        {mostly("time_limit"): data.draw(st.integers(-1, 9))} if data.draw(st.booleans()) else {}
    )
    played = data.draw(st.booleans())
    try:
        agents = {
            name: replace(CONFIG, game=mostly(game), variant=mostly(train))
            for name in ("one", "two")[: data.draw(st.integers(0, 2))]
        }
        plan = Plan(
            agents=agents,
            seeds=data.draw(st.integers(0, 9)),
            tests={"test": spec.Test(mostly(*made.variants), shift, knobs)} if played else {},
            levels=data.draw(st.integers(-1, 10) | st.integers(2**31 - 200_000, 2**31)),
            differences="",
        )
        size = data.draw(st.sampled_from(["smoke", "hour", "paper", "tiny"]))
        Experiment("", "", "", {size: plan}, find=print)
    except ValueError:
        tried("experiments", 1)
        return
    assert plan.seeds >= 1 and size in SIZES and len(plan.trainings()) == len(agents)
    for config in agents.values():
        assert 1 <= plan.levels <= len(config.unseen_levels)
        for test in plan.tests.values():
            assert test.variant_for(config).time_limit >= 1 and test.shift in made.shifts
    tried("experiments", 0)
