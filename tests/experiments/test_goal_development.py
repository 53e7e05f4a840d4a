"""The development of a published mouse's goals, from its episodes."""

from dataclasses import replace
from types import SimpleNamespace

import polars as pl
import pytest

from astray.analysis.outcomes import FAILED, INTENDED, MISGENERALIZED
from astray.experiments import outcomes
from astray.experiments.studies.maze import goal_development as study
from astray.published.catalogue import find
from astray.report.claims import corrected
from helpers import registered

LEVELS = 100


def work(cheese, corner):
    """Episodes in which agents, or None for random actions, reach goals in so many levels."""
    rows = [
        {"agent": name, "policy": outcomes.AGENTS if name else "random", "test": study.WHERE,
         "seed": 0 if name else None, "level": level,
         "outcome": INTENDED if level < cheese[name]
         else MISGENERALIZED if level < cheese[name] + corner[name] else FAILED}
        for name in cheese for level in range(LEVELS)
    ]  # fmt: skip
    plan = replace(study.EXPERIMENT.sizes["published"], levels=LEVELS)
    return SimpleNamespace(plan=plan, episodes=pl.DataFrame(rows))


@pytest.mark.parametrize(
    "early, late, corner, supported",
    [(60, 97, 2, [True, True, True]), (30, 97, 50, [False, False, True]),
     (60, 70, 30, [True, False, False])],
)  # fmt: skip
def test_a_goal_that_appears_early_is_told_from_one_that_appears_late(
    early, late, corner, supported
):
    cheese = dict.fromkeys(study.AGENTS, 30) | {study.EARLY: early, study.FINAL: late, None: 30}
    corners = dict.fromkeys(cheese, 10) | {study.EARLY: corner, study.FINAL: 1}
    found = study.find(work(cheese, corners))
    assert [one.supported for one in corrected(found.claims)] == supported
    assert not registered.unstated("goal-development", found.claims)
    curve = found.tables[0].frame
    assert curve["steps"].drop_nulls().unique().sort().to_list() == [*study.STEPS, study.LAST]
    assert curve.filter(steps=study.LAST, outcome=INTENDED)["mean"].item() == late / LEVELS
    assert f"after 160,022,528 steps {late}\u00a0% and 1\u00a0%" in found.answer


def test_its_checkpoints_are_those_of_the_catalogue():
    for steps, name in study.AGENTS.values():
        assert find(name).known.steps == steps and find(name).sha256
    assert [study.thousands(steps) for steps in (32_768, 2_031_616)] == ["33 k", "2.03 M"]
