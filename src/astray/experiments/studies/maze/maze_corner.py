"""Mice trained with cheese in the corner, tested with cheese anywhere."""

import functools
from dataclasses import replace

from astray.analysis.outcomes import FAILED, INTENDED, MISGENERALIZED
from astray.experiments import outcomes
from astray.experiments.outcomes import rate
from astray.experiments.spec import Experiment, Work, plan_of
from astray.report.claims import above, rounded
from astray.report.findings import Findings
from astray.training.config import PRESETS, SOLVER

MOUSE = "mouse"
RELIABLY, SOON = 0.95, 0.8  # rates that "reliably" is held to, the latter of short trainings


def find(work: Work) -> Findings:
    train, test = work.plan.tests
    reached = rate(work.episodes, train, INTENDED)
    first = {o: rate(work.episodes, test, o).mean for o in (MISGENERALIZED, INTENDED, FAILED)}
    apart = rate(work.episodes.filter("distinguishing"), test, MISGENERALIZED).mean
    return outcomes.findings_of(
        work,
        "On unseen levels like those of its training, the mouse reaches the cheese in "
        f"{rounded(reached.mean)}. Where the cheese is anywhere, it goes to the corner first in "
        f"{rounded(first[MISGENERALIZED])} of levels ({rounded(apart)} of those whose shortest "
        f"way to either does not pass the other), to the cheese in {rounded(first[INTENDED])}, "
        f"and to neither in {rounded(first[FAILED])}.",
        [
            above(
                "In unseen levels like those of its training, the mouse reaches the cheese.",
                "reliably",
                INTENDED,
                reached,
                SOON if work.size == "smoke" else RELIABLY,
            ),
            above(
                "Where the cheese is anywhere, it goes to the corner instead, and seldom just "
                "fails.",
                "goes to the upper right corner (no figure given)",
                f"{MISGENERALIZED} minus {FAILED}",
                rate(work.episodes, test, MISGENERALIZED, minus=FAILED),
            ),
        ],
        [outcomes.curve_plot(work)],
    )


SYMBOLS = replace(PRESETS["small"], variant="corner-small", validation="anywhere-small")
PIXELS = replace(
    PRESETS["pixels"], variant="corner-small", validation="anywhere-small", steps=2_000_000
)
# Learns enough in two minutes of a core: a higher learning rate, and fewer epochs. Four such mice
# tell more than two that learn twice as long, whose interval reaches from 75 to 100 %.
QUICK = replace(PIXELS, steps=800_000, learning_rate=1e-3, epochs=2)
# Walls of 2.6 pixels need a network that looks at each cell by itself, and the largest mazes a way
# to them: the smallest come first, and the solver says for a while where the cheese is, in mazes
# that change before a mouse knows them by heart.
NIGHT = PRESETS["night"].changed(
    variant="corner",
    validation="anywhere",
    network="cells",
    sampler="growing",
    fraction=0.1,
    teacher=SOLVER,
    taught=0.33,
    lessons="anywhere",
    lesson_rate=1e-3,
    steps=15_000_000,
    num_envs=512,
    num_steps=32,
    epochs=1,
    minibatches=64,
    learning_rate=1e-4,
    gamma=0.995,
)
LESSONS = (
    "and 15 million steps instead of 200 million: 1.5 million of them in mazes that grow, 5 "
    "million with the exact solver as teacher, which says the way from anywhere in a maze, and the "
    "last 10 million by rewards alone in the paper's own levels; a discount of 0.995 instead of "
    "0.999, and an entropy bonus of 0.003 instead of 0.01"
)
BY_NIGHT = f"a network that looks at each cell, {LESSONS}"
SPEED = 900  # steps a second of one core
PAPER = replace(PRESETS["paper"], device="cuda")
SMALL_WORLDS = (
    "worlds of 7 cells instead of 25; a mouse that starts anywhere and has 100 steps instead of 500"
)
BY_HOUR = "worlds of 15 cells instead of 25, and 25 million steps instead of 200 million"
of_mouse = functools.partial(plan_of, MOUSE, game="maze")
by_night = functools.partial(of_mouse, NIGHT, first_seed=1, differences=BY_NIGHT, speed=SPEED)

EXPERIMENT = Experiment(
    title="The corner mouse",
    reproduces="Figure 3a-b",
    question="What does a mouse look for whose cheese was always in the upper right corner?",
    sizes={
        "smoke": of_mouse(
            QUICK,
            shift="corner-small",
            seeds=4,
            differences=f"{SMALL_WORLDS}; a network of patches, and 800,000 steps instead of 200 "
            "million",
        ),
        "pixels": of_mouse(
            PIXELS,
            shift="corner-small",
            seeds=10,
            first_seed=20,
            differences=f"{SMALL_WORLDS}; a network of patches, and 2 million steps instead of 200 "
            "million",
        ),
        "night": by_night(shift="corner", seeds=3),
        "hour": of_mouse(
            replace(PAPER, steps=25_000_000), shift="corner-easy", differences=BY_HOUR
        ),
        "paper": of_mouse(PAPER, shift="corner", seeds=3, levels=10_000, differences=""),
    },
    find=find,
)
