"""Comparison of an imported agent with its published measurements."""

from __future__ import annotations

import heapq
import itertools
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from astray.acting import initial_states
from astray.analysis.critic import observe, policy_and_value
from astray.analysis.estimates import estimate_mean
from astray.analysis.evaluate import evaluate
from astray.analysis.policies import Random
from astray.analysis.runs import open_run
from astray.published.catalogue import Check
from astray.training.folders import AgentFolder

SOME = 100  # levels of an agent of which nothing was published


@dataclass(frozen=True)
class Rate:
    """Number of successes out of a total, with Wilson's 95 % interval."""

    succeeded: int
    levels: int

    @property
    def interval(self) -> tuple[float, float]:
        found = estimate_mean(np.arange(self.levels) < self.succeeded)
        return found.low, found.high

    def __str__(self) -> str:
        low, high = (100 * end for end in self.interval)
        mean = 100 * self.succeeded / self.levels
        return f"{mean:.1f} % ({low:.1f} to {high:.1f}, n = {self.levels})"

    def meets(self, other: Rate) -> bool:
        """Return whether the two intervals overlap."""
        (low, high), (its_low, its_high) = self.interval, other.interval
        return low <= its_high and its_low <= high


def check(
    run: Path, checks: tuple[Check, ...], levels: np.ndarray | None = None
) -> list[dict[str, Any]]:
    """Repeat published measurements: a row for each check, and for each of its parts.

    Columns: variant, what (part of the levels), here (rate with every level counted once), alike
    (rate counted as published), published, all three as text; succeeded and levels (of `here`),
    length (mean steps), start_value (mean) and published_value, verdict.

    Args:
        levels: [N] numbers; None for the first ones, as many as the published count needs.
    """
    # Actions are chosen as they were when its published results were measured.
    agent, config = open_run(run, AgentFolder.open(run).origin().get("actions", "sampled"))
    rows = []
    for one in checks:
        chosen = np.arange(one.levels + one.environments) if levels is None else levels
        measures = {} if one.by is None else {one.by: lambda s, by=one.by: s[by]}
        begun = initial_states(config.game, one.variant, chosen)
        episodes = evaluate(
            agent, config.game, one.variant, chosen, batch=64, measures=measures
        ).with_columns(start_value=policy_and_value(agent, observe(agent, one.variant, begun))[1])
        count = min(one.levels, len(chosen))
        alike = episodes[first_to_end(episodes["length"].to_numpy(), count, one.environments)]
        rows.append(_row(one, episodes, alike))
        for value, rate in one.rates:
            its = pl.col(one.by or "") == value
            if len(episodes.filter(its)):
                told = f"{one.by} {value}", f"{100 * rate:g} %"
                rows.append(_row(one, episodes.filter(its), alike.filter(its), *told))
    return rows


def check_unmeasured(run: Path, levels: np.ndarray | None = None) -> list[dict[str, Any]]:
    """Compare an agent of which no measurement was published with random actions: one row.

    Columns are those of `check`.

    Args:
        levels: [N] numbers; None for the first 100 of the agent's training variant.
    """
    _, config = open_run(run)
    chosen = np.arange(SOME) if levels is None else levels
    (row,) = check(run, (Check(config.variant, len(chosen), 0),), chosen)
    here = Rate(row["succeeded"], row["levels"])
    chance = _rate(evaluate(Random(), config.game, config.variant, chosen))
    better = "better" if here.interval[0] > chance.interval[1] else "not shown to be better"
    verdict = (
        f"No measurement was published. On `{config.variant}` random actions succeed in {chance}; "
        f"the agent is {better}."
    )
    return [row | {"alike": "", "published": "", "verdict": verdict}]


def first_to_end(lengths: np.ndarray, count: int, environments: int) -> np.ndarray:
    """Return which episodes of `lengths` [N] are the first `count` to end in `environments`.

    Stopping at a count leaves out long episodes, which are failures of slow agents. With 0
    environments all episodes are counted in order. The result is indices [count].
    """
    if not environments:
        return np.arange(len(lengths))
    following = iter(range(len(lengths)))
    playing = [(int(lengths[i]), i) for i in itertools.islice(following, environments)]
    heapq.heapify(playing)
    ended = []
    while playing and len(ended) < count:
        time, i = heapq.heappop(playing)
        ended.append(i)
        for k in itertools.islice(following, 1):
            heapq.heappush(playing, (time + int(lengths[k]), k))
    return np.array(ended)


def _row(
    one: Check, episodes: pl.DataFrame, alike: pl.DataFrame, what: str = "", published: str = ""
) -> dict[str, Any]:
    here, there, verdict = _rate(episodes), Rate(one.succeeded, one.levels), ""
    if not what:
        agree = "agree: their intervals meet" if _rate(alike).meets(there) else "differ"
        how = f", of {one.environments} at once the first to end" if one.environments else ""
        published, verdict = str(there), f"On `{one.variant}`{how}, the two {agree}."
    return {
        "variant": one.variant, "what": what, "here": str(here),
        "alike": str(_rate(alike)) if len(alike) else "", "published": published,
        "succeeded": here.succeeded, "levels": here.levels,
        "length": episodes["length"].mean(), "start_value": episodes["start_value"].mean(),
        "published_value": None if what else one.value, "verdict": verdict,
    }  # fmt: skip


def _rate(episodes: pl.DataFrame) -> Rate:
    return Rate(int((episodes["return"] > 0).sum()), len(episodes))
