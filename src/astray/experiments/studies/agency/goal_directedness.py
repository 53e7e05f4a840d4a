"""Are trained mice goal-directed, and towards what? MEG, a second measure of it."""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
import polars as pl

from astray import games
from astray.acting import initial_states
from astray.analysis.agency import named_places
from astray.analysis.outcomes import load_shift
from astray.analysis.runs import open_run
from astray.estimate import Estimate
from astray.experiments.levels import levels_of
from astray.experiments.outcomes import table_of
from astray.experiments.spec import Experiment, Plan, Test, Work
from astray.experiments.studies.insight._plans import CORNER_MOUSE, of_levels
from astray.experiments.studies.maze.maze_corner import PIXELS
from astray.figures import charts
from astray.game import Variant
from astray.insight.directedness import directedness
from astray.insight.fields import Field, each_field
from astray.insight.probes import untrained
from astray.level import Cell
from astray.report.claims import Claim, above, near_zero
from astray.report.findings import Findings, Plot, Table

SYMBOLS, PICTURES = "mouse, symbols", "mouse, pictures"
UNTRAINED, RANDOM = "untrained network", "random policy"
CHEESE, CORNER = "cheese", "corner"
WALKS = {f"walk to {goal}": goal for goal in (CHEESE, CORNER)}
WHERE = "cheese anywhere"
PUBLISHED = "MEG falls as a policy errs more (Figure 4); not measured for mice"


def find(work: Work) -> Findings:
    rows = work.keep("directedness", lambda: measured(work))
    mean = {
        (name, goal): of_levels(rows.filter(policy=name), "fraction", goal)
        for name in rows["policy"].unique(maintain_order=True)
        for goal in (CHEESE, CORNER)
    }
    table = table_of(mean, "policy", "goal").drop("n")
    levels = mean[SYMBOLS, CORNER].levels
    return Findings(
        answer=f"In {levels:,} levels, mice whose cheese was always in the corner are directed to "
        f"the corner by {mean[SYMBOLS, CORNER].mean:.2f} (symbols) and "
        f"{mean[PICTURES, CORNER].mean:.2f} (pictures) of what is possible, and to the cheese by "
        f"{mean[SYMBOLS, CHEESE].mean:.2f} and {mean[PICTURES, CHEESE].mean:.2f}.",
        claims=claims(rows, mean),
        plots=[
            Plot(
                "directedness",
                "MEG of each policy for each goal, as a fraction of that of a policy that always "
                "takes a shortest way; mean over levels with 95\u00a0% intervals.",
                charts.points(
                    table, row="policy", group="goal", label="MEG, fraction of the largest"
                ),
                table,
            )
        ],
        tables=[Table("directedness", "MEG of each policy for each goal", table)],
        settings={"discount": "0.9, as in the publication", "levels": f"{levels:,}"},
    )


def claims(rows: pl.DataFrame, mean: Mapping[tuple[str, str], Estimate]) -> list[Claim]:
    """Return the claims, which were made before the levels of this study were played."""
    amount, of = Estimate.amount, "fraction for the {}".format
    return [
        *(
            above(
                f"The {name.replace(', ', ' that sees ')} is directed to the corner more than to "
                "the cheese.",
                PUBLISHED, "fraction for the corner minus that for the cheese",
                of_levels(rows.filter(policy=name), "fraction", CORNER, minus=CHEESE), 0.3,
                told=amount,
            )
            for name in (SYMBOLS, PICTURES)
        ),
        *(
            near_zero(
                f"The {name} is directed to no {goal}.",
                PUBLISHED, of(goal), mean[name, goal], 0.05, told=amount,
            )
            for name in (UNTRAINED, RANDOM)
            for goal in (CHEESE, CORNER)
        ),
        *(
            above(
                f"The script that walks to the {goal} is directed to it.",
                PUBLISHED, of(goal), mean[name, goal], 0.95, told=amount,
            )
            for name, goal in WALKS.items()
        ),
    ]  # fmt: skip


def measured(work: Work) -> pl.DataFrame:
    """Return a row per policy, level and goal: policy, level, condition (the goal), fraction.

    Only levels with both goals count, in two cells in which the mouse does not begin.
    """
    test = work.plan.visited[WHERE]
    variant, levels = test.variant_for(work.plan.config), levels_of(work.plan, test)
    goals = cells_of(test, variant, levels)
    return pl.DataFrame(
        {"policy": name, "level": number, "condition": goal, "fraction": one.fraction}
        for name, number, field in fields_of(work, variant, goals)
        for goal, one in directedness(field, goals[number]).items()
    ).filter(pl.col("fraction").is_not_nan())


def cells_of(test: Test, variant: Variant, levels: np.ndarray) -> dict[int, dict[str, Cell]]:
    """Return the cell of each goal, for those `levels` [N] in which both can be pursued."""
    maze = games.find("maze")
    shift = load_shift(maze, test.shift)
    found = {}
    for number, s in zip(levels.tolist(), initial_states(maze, variant, levels), strict=True):
        places = named_places(maze, s, shift)
        goals = [goal for goal in (CHEESE, CORNER) if places[goal]]
        cells: Any = {goal: tuple(map(int, places[goal])) for goal in goals}
        begun = tuple(np.floor(maze.places.centre(np.array([s], maze.state)))[0].astype(int))
        if len({*cells.values(), begun}) == 3:
            found[number] = cells
    return found


def fields_of(
    work: Work, variant: Variant, goals: Mapping[int, Mapping[str, Cell]]
) -> Iterator[tuple[str, int, Field]]:
    """Yield each policy's name, a level's number, and the policy at every place of the level."""
    agents = {name: open_run(run)[0] for name, (run,) in work.runs.items()}
    agents[UNTRAINED] = untrained(agents[SYMBOLS], seed=0)
    for name, agent in agents.items():
        fields = each_field(agent, variant, [*goals])
        for number, field in zip(goals, fields, strict=True):
            yield name, number, field
            if name == SYMBOLS:  # scripts are of the same places
                yield RANDOM, number, scripted(field, np.zeros(field.policy.shape, bool))
                for goal, cell in goals[number].items():
                    yield f"walk to {goal}", number, scripted(field, field.places.advancing(cell))


def scripted(field: Field, taken: np.ndarray) -> Field:
    """Return the uniform policy over the given actions [K, A], or over all if there are none."""
    taken = taken | ~taken.any(1, keepdims=True)
    return Field(field.places, taken / taken.sum(1, keepdims=True), field.value)


MICE = {SYMBOLS: ("maze-corner", CORNER_MOUSE), PICTURES: ("maze-corner-pixels", PIXELS)}
EXPERIMENT = Experiment(
    title="Goal-directedness",
    reproduces="MacDermott et al. 2024 (arXiv 2412.04758), their measure, of mice",
    question="How goal-directed are mice whose cheese was always in the corner, and towards what?",
    sizes={
        "smoke": Plan(
            agents={name: config for name, (_, config) in MICE.items()},
            published={name: agent for name, (agent, _) in MICE.items()},
            levels=300,
            visited={WHERE: Test("anywhere-small", "corner-small")},
            differences="the two mice of the corner that come with astray, in worlds of 7 cells",
        )
    },
    find=find,
)
