"""Does a network that averages over places, and cannot distinguish them, still go to the corner?"""

from dataclasses import replace

from astray.analysis.estimates import estimate_difference, estimate_mean
from astray.analysis.outcomes import FAILED, INTENDED, MISGENERALIZED
from astray.experiments import outcomes
from astray.experiments.outcomes import rate
from astray.experiments.spec import Experiment, Plan, Work, tests_of
from astray.experiments.studies.maze.maze_corner import PIXELS
from astray.report.claims import above, rounded
from astray.report.findings import Findings

FLAT, POOLED = "places apart", "places pooled"
CAPABLE, LESS = 0.9, 0.1  # bounds of the claims


def find(work: Work) -> Findings:
    train, test = work.plan.tests
    corner, cheese, neither = (
        outcomes.first(work, test, outcome) for outcome in (MISGENERALIZED, INTENDED, FAILED)
    )
    pooled = rate(work.episodes.filter(agent=POOLED), train, INTENDED)
    return outcomes.findings_of(
        work,
        "In distinguishing levels, mice whose last layer sees each place for "
        f"itself go to the corner first in {rounded(estimate_mean(corner[FLAT]).mean)}, mice whose "
        "last layer is given means over all places in "
        f"{rounded(estimate_mean(corner[POOLED]).mean)}; the latter go to the cheese first in "
        f"{rounded(estimate_mean(cheese[POOLED]).mean)}, and come to neither in "
        f"{rounded(estimate_mean(neither[POOLED]).mean)}.",
        [
            above(
                "A network that pools over places learns to reach the cheese of its training.",
                "none",
                INTENDED,
                pooled,
                CAPABLE,
            ),
            above(
                "Pooling over places removes the corner as a goal, at least in part.",
                "none",
                f"{FLAT} minus {POOLED}",
                estimate_difference(corner[FLAT], corner[POOLED]),
                LESS,
            ),
            # Who comes to nothing goes to the corner less often, too.
            above(
                "They go to the cheese instead.",
                "none",
                f"{INTENDED}, {POOLED} minus {FLAT}",
                estimate_difference(cheese[POOLED], cheese[FLAT]),
                LESS,
            ),
        ],
        [outcomes.curve_plot(work)],
        agent=POOLED,
        told={
            "places": "convolutions pad with zeros, so that channels can tell the border of the "
            "picture, which pooling does not take away"
        },
    )


EXPERIMENT = Experiment(
    title="Pooled places",
    reproduces="nothing, a question of our own",
    question="The corner is a place. Does a network that averages over places still look for it?",
    sizes={
        "pixels": Plan(
            agents={FLAT: PIXELS, POOLED: replace(PIXELS, network="patch-pooled")},
            seeds=3,
            tests=tests_of("maze", "corner-small"),
            levels=1000,
            differences="worlds of 7 cells, networks of patches, and 2 million steps",
        )
    },
    find=find,
)
