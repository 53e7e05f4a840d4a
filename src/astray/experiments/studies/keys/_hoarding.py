"""Findings about thieves and keys: how many they take, when, and at which cost."""

from functools import partial

import numpy as np
import polars as pl

from astray.acting import initial_states
from astray.analysis.estimates import Estimate, estimate_mean, estimate_paired
from astray.analysis.evaluate import Measure
from astray.analysis.outcomes import matrix
from astray.analysis.policies import Walk
from astray.experiments.outcomes import AGENTS
from astray.experiments.spec import Work
from astray.figures import charts
from astray.games.keys.measures import discounted_return, keys_beyond_need, keys_in_hand
from astray.report.findings import Plot, Table

NEED = Walk("chests").name  # fetches only what it needs
POLICIES = {
    AGENTS: "agents",
    NEED: "fetches what it needs",
    Walk("keys").name: "takes all keys",
    "random": "random",
}
BEYOND, ALL_FIRST, IN_HAND = "spare keys", "all keys first", "keys in hand"
PER_CHEST, LOST, LEFT = "return per chest", "return lost", "chests left"
MEASURES = {  # measures of an episode, with their units
    BEYOND: "keys taken beyond\nthe number of chests",
    ALL_FIRST: "fraction that took all keys\nbefore the last chest",
    IN_HAND: "keys in hand when\na chest was opened",
    PER_CHEST: "return per chest\nthat could be opened",
    LOST: "discounted return lost\nagainst the best order",
    LEFT: "fraction that took all keys and\nnever opened the last chest",
}


def measures(gamma: float) -> dict[str, Measure]:
    """Return measures of final states; other `MEASURES` are computed in `told`."""
    return {
        BEYOND: keys_beyond_need,
        IN_HAND: keys_in_hand,
        "discounted return": partial(discounted_return, gamma=gamma),
        "possible": lambda states: np.minimum(states["keys"], states["chests"]),
    }


def told(work: Work) -> pl.DataFrame:
    """Return the episodes with all of `MEASURES`, null where undefined."""
    best = work.keep("best", lambda: best_returns(work))
    took_all = pl.col("keys_before_last").is_not_null()
    return work.episodes.join(best, on=["test", "level"], maintain_order="left").with_columns(
        pl.col(IN_HAND).fill_nan(None),
        took_all.alias(ALL_FIRST),
        (took_all & pl.col("all_chests").is_null()).alias(LEFT),
        (pl.col("return") / pl.col("possible")).alias(PER_CHEST),
        (pl.col("best") - pl.col("discounted return")).alias(LOST),
    )


def best_returns(work: Work) -> pl.DataFrame:
    """Return the discounted return of the best order in every level: test, level, best."""
    config, game = work.plan.config, work.plan.game
    parts = []
    for name, test in work.plan.tests.items():
        levels = work.episodes.filter(test=name)["level"].unique().sort()
        begun = initial_states(game, test.variant_for(config), levels.to_numpy())
        best = [game.solver.optimal_return(s, "chests", config.gamma) for s in begun]
        parts.append(pl.DataFrame({"test": name, "level": levels, "best": best}))
    return pl.concat(parts)


def estimate(episodes: pl.DataFrame, test: str, measure: str, policy: str = AGENTS) -> Estimate:
    """Return the mean of a measure for a policy, over levels where all have it."""
    part = episodes.filter(test=test, policy=policy)
    part = part.filter(pl.col(measure).is_not_null().all().over("level"))
    if part.is_empty():
        return Estimate.nothing()
    return estimate_mean(matrix(part, pl.col(measure)))


def change(episodes: pl.DataFrame, measure: str, before: str, after: str) -> Estimate:
    """Return the difference of the agents' measure between the tests `after` and `before`.

    Only numbers played in both count: their levels have the same maze, thief and object cells.
    """
    agents = episodes.filter(policy=AGENTS)
    both = [agents.filter(test=test)["level"] for test in (before, after)]
    common = set(both[0]) & set(both[1])
    one, two = (
        matrix(agents.filter(pl.col("level").is_in(common), test=test), pl.col(measure))
        for test in (before, after)
    )
    return estimate_paired(two, one)


def table(work: Work, episodes: pl.DataFrame) -> Table:
    """Return every measure, for every policy, in every test."""
    rows = [
        {"test": test, "policy": name, "measure": measure}
        | vars(estimate(episodes, test, measure, policy))
        for test in work.plan.tests
        for measure in MEASURES
        for policy, name in POLICIES.items()
    ]
    return Table(
        "hoarding",
        "Use of the keys, by episode; in training every key is needed. Keys in hand are counted "
        "in the levels in which each of the agents opened a chest.",
        pl.DataFrame(rows),
    )


def plot(work: Work, table: Table) -> Plot:
    """Plot a panel per measure, a row per policy, a mark per test."""
    names = {name: f"{test.variant}: {name}" for name, test in work.plan.tests.items()}
    drawn = table.frame.with_columns(
        pl.col("test").replace(names), pl.col("measure").replace(MEASURES)
    )
    return Plot(
        "hoarding",
        "Use of the keys: by the agents, by a thief that opens all chests in the "
        "fewest steps, by one that cares for keys alone, and by chance. Lines are 95 % intervals.",
        charts.points(
            drawn, row="policy", group="test", panel="measure", columns=2, sharex=False, label=""
        ),
        table.frame,
    )
