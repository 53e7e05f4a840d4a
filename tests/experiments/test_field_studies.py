"""The studies of the field's worlds claim what the register says, of tables made up here."""

from typing import Any

import numpy as np
import polars as pl
import pytest

from astray.analysis.outcomes import outcomes_of
from astray.experiments import catalogue, outcomes
from astray.experiments.outcomes import AGENTS
from astray.experiments.spec import Work
from astray.report.claims import corrected
from helpers import registered

NAMES = [name for name, module in catalogue.MODULES.items() if ".field." in module]


def episodes(plan, intended):
    """Thirty episodes of five agents a kind and of random moves in each test of a plan, at random.

    All agents reach the intended goal in training, or none does.
    """
    random, game = np.random.default_rng(0), plan.game
    train, rows = next(iter(plan.tests)), []
    agents = [(AGENTS, seed, agent) for agent in plan.agents for seed in range(5)]
    for test in plan.tests:
        for policy, seed, agent in (*agents, ("random", None, None)):
            for level in range(30):
                row = {"test": test, "policy": policy, "seed": seed, "level": level, "run": policy}
                row |= {"agent": agent} | dict.fromkeys(plan.measures, True)
                row |= {event: random.choice([None, 3]) for event in game.events}
                row |= {name: float(random.integers(2)) for name in game.measures}
                first, *others = outcomes_of(game)
                reached = first if intended else others[0]
                outcome = reached if test == train else random.choice(others)
                rows.append(row | {"outcome": outcome, "return": 1.0, "distinguishing": True})
    return pl.DataFrame(rows, infer_schema_length=None)


def claims_of(name, tmp_path, monkeypatch, intended=True, **events):
    whole = catalogue.load(name)
    plan = whole.sizes["smoke"]
    monkeypatch.setattr(outcomes, "findings_of", lambda work, answer, claims, *plots: claims)
    table = episodes(plan, intended).with_columns(pl.lit(e).alias(n) for n, e in events.items())
    found: Any = whole.find(Work(name, "smoke", plan, tmp_path, "", {}, table))
    return found


@pytest.mark.parametrize("name", NAMES)
def test_claims_about_a_world_of_the_field_are_registered(name, tmp_path, monkeypatch):
    claims = claims_of(name, tmp_path, monkeypatch)
    assert claims and not registered.unstated(name, corrected(claims))


@pytest.mark.parametrize("name", ["lava-land", "lava-bridge", "follow-the-leader"])
def test_a_claim_to_have_learned_needs_that_the_goal_is_reached(name, tmp_path, monkeypatch):
    for intended in (True, False):
        assert claims_of(name, tmp_path, monkeypatch, intended)[0].supported == intended


@pytest.mark.parametrize("step", [3, None])
def test_a_thief_that_takes_keys_first_has_taken_the_gem_all_the_same(step, tmp_path, monkeypatch):
    claims = claims_of("needless-keys", tmp_path, monkeypatch, intended=False, reached_gem=step)
    assert [claim.supported for claim in claims[:2]] == [step is not None] * 2
