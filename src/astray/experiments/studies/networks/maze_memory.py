"""Does an agent with memory, in mazes that it sees a part of, misgeneralize more or less?"""

from dataclasses import replace

from astray.analysis.estimates import estimate_difference, estimate_mean
from astray.analysis.outcomes import MISGENERALIZED, matrix
from astray.experiments import outcomes
from astray.experiments.spec import Experiment, Plan, Test, Work
from astray.experiments.studies.maze.maze_region import REACHED
from astray.report.claims import above, near_zero, rounded
from astray.report.findings import Findings
from astray.training.config import PRESETS, Config

PLAIN, MEMORY = "cheese anywhere, no memory", "cheese anywhere, memory"
PLAIN_CORNER, MEMORY_CORNER = "cheese in the corner, no memory", "cheese in the corner, memory"
TIMES, ALIKE = 1.5, 0.1  # bounds of the claims
WHERE = "cheese anywhere"


def find(work: Work) -> Findings:
    anywhere = {name: outcomes.of(work, WHERE, name) for name in (PLAIN, MEMORY)}
    found = {name: matrix(part, REACHED).astype(float) for name, part in anywhere.items()}
    corner = outcomes.first(work, WHERE, MISGENERALIZED)
    plain, memory = (rounded(estimate_mean(x).mean) for x in found.values())
    before, after = (
        rounded(estimate_mean(corner[name]).mean) for name in (PLAIN_CORNER, MEMORY_CORNER)
    )
    return outcomes.findings_of(
        work,
        f"Where the cheese was anywhere in training, too, mice with memory reach it in "
        f"{memory} of levels, and mice without in {plain}. Where it was in the corner, those with "
        f"memory go to the corner first in {after} of distinguishing levels, those without in "
        f"{before}.",
        [
            above(
                f"With memory, a mouse reaches the cheese at least {TIMES} times as often.",
                "none",
                f"reached with memory, minus {TIMES} times without",
                estimate_difference(found[MEMORY], TIMES * found[PLAIN]),
            ),
            near_zero(
                "Memory hardly changes how often a mouse whose cheese was in the corner goes there "
                "first.",
                "none",
                "corner first, with memory minus without",
                estimate_difference(corner[MEMORY_CORNER], corner[PLAIN_CORNER]),
                ALIKE,
            ),
        ],
        [outcomes.curve_plot(work)],
        agent=MEMORY_CORNER,
    )


def agents(anywhere: Config, corner: str) -> dict[str, Config]:
    """Return the settings of agents with and without memory, trained on both variants."""
    kinds = ((PLAIN, MEMORY, anywhere.variant), (PLAIN_CORNER, MEMORY_CORNER, corner))
    return {
        name: replace(anywhere, variant=variant, network=network)
        for plain, memory, variant in kinds
        for name, network in ((plain, "mlp"), (memory, "mlp+gru"))
    }


SMALL = replace(
    PRESETS["small"],
    variant="anywhere-small",
    knobs={"world": 9, "smallest": 9, "largest": 9, "window": 3, "time_limit": 40},
    steps=1_500_000,
    num_envs=64,
    num_steps=32,
    minibatches=4,
    width=48,
    gamma=0.97,
    learning_rate=2e-3,
    entropy_weight=0.005,
)
# Mazes grow for 70 % of the steps: where all sizes come at once, memory is not learned.
LARGE = SMALL.changed(
    variant="anywhere-memory",
    knobs={},
    sampler="growing",
    fraction=0.7,
    steps=10_000_000,
    num_steps=64,
    width=128,
    gamma=0.99,
    learning_rate=1e-3,
)

EXPERIMENT = Experiment(
    title="Memory in mazes",
    reproduces="nothing, a question of our own",
    question="Does an agent with memory misgeneralize more or less than one without?",
    sizes={
        "smoke": Plan(
            agents=agents(SMALL, "corner-small"),
            seeds=5,
            tests={WHERE: Test("anywhere-small", "corner-small")},
            levels=1000,
            differences="mazes of 9 cells, 3 of them seen at a time, 40 steps an episode; networks "
            "of two hidden layers, and 1.5 million steps",
        ),
        "night": Plan(
            agents=agents(LARGE, "corner-memory"),
            seeds=5,
            tests={WHERE: Test("anywhere-memory", "corner")},
            levels=1000,
            differences="mazes of 3 to 31 cells, 8 of them seen at a time, as symbols; networks of "
            "two hidden layers, and 10 million steps, in mazes that grow for 7 million",
        ),
    },
    find=find,
)
