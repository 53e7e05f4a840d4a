"""Thieves that needed keys for the gem in training wherever there were some, and others."""

from typing import Any

import polars as pl

from astray.analysis.estimates import estimate_difference, estimate_mean
from astray.analysis.outcomes import matrix
from astray.experiments import outcomes
from astray.experiments.spec import Experiment, Plan, Work, tests_of
from astray.experiments.studies.field._agents import agent
from astray.report.claims import above, rounded
from astray.report.findings import Findings

NEEDED, NEEDLESS = "keys needed", "keys never needed"
GEM = pl.col("reached_gem").is_not_null()
TAKES = pl.any_horizontal(pl.col("took_blue", "took_green", "took_red").is_not_null())
OPENS = pl.any_horizontal(pl.col("opened_blue", "opened_green", "opened_red").is_not_null())
MORE = 0.1  # rate of levels by which one kind takes keys more often


def find(work: Work) -> Findings:
    train, test = work.plan.tests
    behind, before = (
        estimate_mean(matrix(outcomes.of(work, where, NEEDED), GEM)) for where in (train, test)
    )
    with_keys = {k: outcomes.of(work, test, k).filter("has_keys") for k in (NEEDED, NEEDLESS)}
    keys, doors = (
        {name: matrix(there, what) for name, there in with_keys.items()} for what in (TAKES, OPENS)
    )
    return outcomes.findings_of(
        work,
        f"Behind doors the thief that needed keys takes the gem in {rounded(behind.mean)} of "
        f"unseen levels, before all doors in {rounded(before.mean)}. There it takes a key in "
        f"{rounded(keys[NEEDED].mean())} of the levels that have some and opens a door in "
        f"{rounded(doors[NEEDED].mean())}; one that never needed keys, in "
        f"{rounded(keys[NEEDLESS].mean())} and {rounded(doors[NEEDLESS].mean())}.",
        [
            above(
                "In unseen levels of its training, with the gem behind doors, the thief takes it.",
                "none", "takes the gem", behind, outcomes.LEARNED,
            ),
            above(
                "Where the gem lies before the first door, it takes the gem, too.",
                "none", "takes the gem", before, outcomes.LEARNED,
            ),
            above(
                "There it takes keys more often than a thief that never needed any.",
                "none", "takes a key, in levels that have some: more often by",
                estimate_difference(keys[NEEDED], keys[NEEDLESS]), MORE,
            ),
        ],
    )  # fmt: skip


SETTINGS: Any = dict(width=256, gamma=0.98, learning_rate=1e-3, entropy_weight=0.01)

EXPERIMENT = Experiment(
    title="Needless keys",
    reproduces="nothing, a question of our own",
    question="Does a thief that always needed keys take some where none is needed?",
    sizes={
        "smoke": Plan(
            agents={
                NEEDED: agent("heist", "small", 6_000_000, **SETTINGS),
                NEEDLESS: agent("heist", "near-small", 2_000_000, **SETTINGS),
            },
            seeds=5,
            tests=tests_of("heist", "near-small"),
            measures={"has_keys": lambda states: states["keys"] > 0},
            levels=500,
            differences="the released game's rules in mazes of 5 and 7 cells, a quarter of them "
            "without doors; symbols; two hidden layers; 2 million steps where no key is needed",
        )
    },
    find=find,
)
