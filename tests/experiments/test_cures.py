"""What the experiments with cures compute, on made-up tables and a few frames."""

from types import SimpleNamespace

import numpy as np
import polars as pl
import pytest

from astray.analysis.outcomes import INTENDED, MISGENERALIZED
from astray.experiments.studies.mitigation import _regret as regret
from astray.experiments.studies.mitigation import asking_for_help, early_or_late, reward_ensembles
from astray.experiments.studies.mitigation.asking_for_help import NEVER
from astray.mitigation.helped import AFTER, BEFORE


def test_agents_of_a_method_differ_in_the_fraction_and_in_nothing_else():
    plan = regret.experiment("t", "corner-small", "corner", {}, steps=4_000_000).sizes["smoke"]
    assert len(regret.METHODS) * len(regret.FRACTIONS) == 16
    assert len(plan.agents) == 16 + len(regret.DOSES) + len((regret.LARGE, regret.ORACLE))
    for method in regret.METHODS:
        configs = [plan.agents[regret.name_of(method, fraction)] for fraction in regret.FRACTIONS]
        fractions = [c.training_variant().shift_probability for c in configs]
        assert fractions == list(regret.FRACTIONS)
        assert len({(c.sampler, c.steps) for c in configs}) == 1


def test_a_ceiling_more_doses_and_a_larger_buffer_stand_beside_the_methods():
    plan = regret.experiment("t", "corner-small", "corner", {}, steps=4_000_000).sizes["smoke"]
    oracle, large, small = (
        plan.agents[name]
        for name in (regret.ORACLE, regret.LARGE, regret.name_of(regret.PLR, regret.SOME))
    )
    assert oracle.variant == "anywhere-small" and oracle.steps == large.steps
    assert large.sampler.buffer == 16 * small.sampler.buffer
    rows = [
        {"agent": name, "policy": "sampled", "test": test, "seed": seed, "level": level,
         "distinguishing": test == regret.TESTED,
         "outcome": INTENDED if level < (8 if test == regret.TRAINED else k) else MISGENERALIZED}
        for k, name in enumerate(plan.agents) for test in (regret.TRAINED, regret.TESTED)
        for seed in (0, 1) for level in range(20)
    ]  # fmt: skip
    found = regret.against_training(SimpleNamespace(plan=plan, episodes=pl.DataFrame(rows)))
    assert found["training"].to_list() == [0.4] * len(plan.agents)
    assert found["mean"].to_list() == pytest.approx([k / 20 for k in range(len(plan.agents))])
    assert found.filter(method=regret.DR)["fraction"].to_list() == [
        *regret.FRACTIONS,
        *regret.DOSES,
    ]
    assert found["method"].to_list()[-2:] == [regret.LARGE, regret.ORACLE]
    assert len(regret.ceiling_figure(found).axes) == 1


def test_the_schedules_have_the_same_levels_at_other_times():
    plan = early_or_late.EXPERIMENT.sizes["smoke"]
    agents, mixed = plan.agents, {name: plan.agents[name] for name in early_or_late.MIXED}
    assert len({c.training_variant() for c in mixed.values()}) == 1
    assert sorted(c.sampler.schedule for c in mixed.values()) == [
        "annealed",
        "early",
        "late",
        "throughout",
    ]
    assert {(c.sampler.fraction, c.sampler.shifted_steps) for c in mixed.values()} == {
        (0.1, 40_000)
    }
    assert agents[early_or_late.NEVER].training_variant().shift_probability == 0
    assert not any(c.anneal for c in agents.values())  # what comes late is learned as fast
    for name in early_or_late.KINDS:  # from competence, and to a payment
        assert plan.starts[name] == early_or_late.BEFORE
        assert plan.starts[early_or_late.paid(name)] == name


def test_late_is_after_the_goal_was_passed_or_never_in_episodes_that_go_astray():
    asked = pl.DataFrame(
        {
            "agent": "runner",
            "score": "entropy",
            "outcome": [MISGENERALIZED] * 4 + [INTENDED],
            "moment": [BEFORE, AFTER, None, None, None],
        }
    )
    assert asking_for_help.too_late(asked)["late"].to_list() == [0.75]
    fractions = dict(asking_for_help.late_rates(asked).select("moment", "fraction").iter_rows())
    assert fractions == {BEFORE: 0.25, AFTER: 0.25, NEVER: 0.5}


def test_a_claim_about_help_holds_by_its_bound():
    rows = [
        {"agent": "runner", "run": "r", "score": "entropy", "granularity": "step",
         "threshold": t, "return": r, "gain": r - 5, "error": 0.05, "levels": 100}
        for t, r in ((np.inf, 5.0), (-np.inf, 10.0), (0.5, 4.9))
    ]  # fmt: skip
    areas = pl.DataFrame({"agent": ["runner"], "score": ["entropy"], "granularity": ["step"]})
    late = pl.DataFrame({"agent": ["runner"], "score": ["entropy"], "late": [0.6]})
    table = pl.DataFrame(rows)
    assert [v.supported for v in asking_for_help.claims(table, areas, late)] == [True, True]
    worse = table.with_columns(pl.col("gain").replace(4.9 - 5, -1.0))
    soon = late.with_columns(late=0.4)
    assert [v.supported for v in asking_for_help.claims(worse, areas, soon)] == [False, False]


@pytest.mark.parametrize("variant, apart", [("corner-small", False), ("anywhere-small", True)])
def test_hypotheses_agree_in_training_frames_and_part_in_the_test(variant, apart):
    made = reward_ensembles.frames(variant, 0, 400, 0)
    cheese, corner = (made.labels[name] for name in reward_ensembles.NAMES)
    assert (cheese != corner).any() == apart
    assert cheese.mean() == pytest.approx(0.5 if not apart else 0.3, abs=0.12)
    mouse, shape = made.seen[:, 1] == 1, made.seen[:, 2] > 0
    assert ((mouse & shape).any((1, 2)) == cheese).all()  # the cheese is seen below the mouse
