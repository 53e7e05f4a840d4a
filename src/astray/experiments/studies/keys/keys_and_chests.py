"""Thieves trained with few keys and many chests, tested with many keys and few chests."""

from dataclasses import replace
from typing import Any

from astray.estimate import Estimate
from astray.experiments import outcomes
from astray.experiments.spec import Experiment, Plan, Work, plan_of
from astray.experiments.studies.keys import _hoarding as hoarding
from astray.experiments.studies.keys._hoarding import ALL_FIRST, BEYOND, LEFT, LOST, NEED, PER_CHEST
from astray.experiments.studies.maze import maze_corner
from astray.report.claims import above, rounded
from astray.report.findings import Findings
from astray.training.config import PRESETS, Config

THIEF = "thief"


def find(work: Work) -> Findings:
    train, test = work.plan.tests
    episodes = hoarding.told(work)

    def in_test(measure: str, policy: str = outcomes.AGENTS) -> float:
        return hoarding.estimate(episodes, test, measure, policy).mean

    opened = hoarding.estimate(episodes, train, PER_CHEST)
    first = hoarding.estimate(episodes, test, ALL_FIRST)
    rates = outcomes.outcome_tables(work)
    # In training all keys are needed, and to take them first is no fault.
    in_tests = [replace(table, frame=table.frame.filter(test=test)) for table in rates]
    hoards = hoarding.table(work, episodes)
    return Findings(
        answer="On unseen levels like those of its training, the thief gets "
        f"{rounded(opened.mean)} of the reward there is. With two keys a chest it gets "
        f"{rounded(in_test(PER_CHEST))}, takes {in_test(BEYOND):.1f} more keys than there are "
        f"chests (a thief that fetches what it needs {in_test(BEYOND, NEED):.1f}), and in "
        f"{rounded(first.mean)} of levels takes all keys before it opens the last chest "
        f"({rounded(in_test(ALL_FIRST, NEED))}); in {rounded(in_test(LEFT))} it then never opens "
        "it.",
        claims=[
            above(
                "In unseen levels like those of its training, the thief opens the chests that "
                "there are keys for.",
                "high reward (figure in the appendix)",
                "return per chest",
                opened,
                0.9,
            ),
            above(
                "Where keys are many, it takes more of them than it needs: more than lie on the "
                "way of a thief that fetches what it needs.",
                "goes out of its way to collect all the keys (no figure given)",
                "spare keys taken, more than by the other",
                outcomes.beyond(replace(work, episodes=episodes), test, BEYOND, NEED),
                told=Estimate.change,
            ),
            above(
                "There it routinely takes all keys before it opens the last chest.",
                "routinely (no figure given)",
                "fraction of episodes",
                first,
                0.5,
            ),
            above(
                "There it gets less return for each chest that could be opened than in training.",
                "much lower (figure in the appendix)",
                "return per chest, lower by",
                hoarding.change(episodes, PER_CHEST, test, train),
                told=Estimate.change,
            ),
            above(
                "There it loses more discounted return against the best order than in training.",
                "would decrease it (no figure given)",
                "discounted return lost, more by",
                hoarding.change(episodes, LOST, train, test),
                told=Estimate.change,
            ),
        ],
        videos=outcomes.videos(work),
        plots=[
            hoarding.plot(work, hoards),
            *outcomes.outcome_plots(work, (in_tests[0], in_tests[1])),
            outcomes.curve_plot(work),
            outcomes.curve_plot(
                work,
                "keys_before_last",
                "fraction of episodes",
                "Fraction of recent episodes in which all keys were taken before the last chest "
                "was opened, while training. In the training variant all keys are needed.",
            ),
        ],
        tables=[hoards, *rates],
        settings=outcomes.settings(work.plan)
        | {
            "penalties": "none, as in the commands that the paper's authors published; the run in "
            "its figure may have paid 0.3 a key, which lowers its return in the test"
        },
    )


def plan(config: Config, shift: str, **more: Any) -> Plan:
    """Return the common parts of all sizes."""
    return plan_of(THIEF, config, "keys", shift, measures=hoarding.measures(config.gamma), **more)


SMALL_MAZES = (
    "mazes of 5 and 7 cells instead of 5 to 13, with 1 to 3 keys in training instead of 1 to 6"
)

EXPERIMENT = Experiment(
    title="Keys and chests",
    reproduces="Figure 5 and the figure of its training in the appendix",
    question="What does a thief want that learned with half as many keys as chests, where it has "
    "twice as many?",
    sizes={
        "smoke": plan(
            replace(PRESETS["small"], validation_every=4),
            "many-keys-small",
            seeds=10,
            first_seed=20,
            differences=f"{SMALL_MAZES}; seen as symbols with the thief in the middle, instead of "
            "a picture; 200 steps an episode instead of 1000; a network of two hidden layers, a "
            "discount of 0.98 instead of 0.999, and 5.5 million steps instead of 200 million",
        ),
        "pixels": plan(
            replace(PRESETS["pixels"], steps=6_000_000),
            "many-keys-small",
            seeds=3,
            differences=f"{SMALL_MAZES}; 200 steps an episode instead of 1000; a network of "
            "patches, a discount of 0.98 instead of 0.999, and 6 million steps instead of 200 "
            "million",
        ),
        "night": plan(
            maze_corner.NIGHT.changed(network="strided-impala"),
            "many-keys",
            seeds=2,
            differences="a network of two strided convolutions before one of the paper's blocks, "
            + maze_corner.LESSONS,
            speed=2500,
        ),
        "hour": plan(
            replace(maze_corner.PAPER, steps=25_000_000),
            "many-keys-easy",
            differences="worlds of 9 cells instead of 13, and 25 million steps instead of "
            "200 million",
        ),
        "paper": plan(maze_corner.PAPER, "many-keys", seeds=3, levels=10_000, differences=""),
    },
    find=find,
)
