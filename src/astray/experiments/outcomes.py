"""Outcomes as findings: rates, plots and videos of a work's episodes.

The policy "sampled" stands for the agents: as in the original, actions are sampled.
"""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import polars as pl

from astray.analysis.estimates import AGENT, Estimate, estimate_paired, mean_of, minus
from astray.analysis.outcomes import (
    INTENDED,
    MISGENERALIZED,
    load_shift,
    matrix,
    outcomes_of,
    rates,
    reached,
)
from astray.analysis.policies import Walk
from astray.experiments.spec import SPREADS, Plan, Runs, Test, Work, open_agents
from astray.experiments.videos import write_pair
from astray.figures import charts
from astray.published.curves import beside
from astray.report.claims import Claim, above, below, rounded
from astray.report.findings import Findings, Plot, Scene, Table, Video
from astray.report.learning import learning_curves
from astray.training import checkpoint
from astray.training.config import Config
from astray.training.folders import read_config
from astray.validation import brief
from astray.world import Failed, Silent, World

STREAMS = (
    "its levels do not repeat, so that none is played again, and nothing is compared level by level"
)
AGENTS = "sampled"
LEARNED = 0.8  # rate of the intended goal in training above which an agent has learned


def rate(
    episodes: pl.DataFrame,
    test: str,
    outcome: str,
    *,
    minus: str | None = None,
    minus_test: str | None = None,
) -> Estimate:
    """Return the rate of `outcome` in the agents' episodes, minus the rate of `minus` if given.

    Args:
        outcome: One of `outcomes_of` the game. A name that no episode has counts as never reached.
        minus_test: Another test, whose rate in the same levels is subtracted.

    Raises:
        ValueError: If a test has no episodes, or agents are of several names.
    """
    part, came = _of_one(episodes, test), pl.col("outcome") == outcome
    other = pl.col("outcome") == (minus or outcome)
    if minus_test:
        its = _of_one(episodes, minus_test)
        who = [name for name in (*AGENT, "level") if name in part.columns]
        if {*its.select(who).rows()} != {*part.select(who).rows()}:
            told = "are not in the same levels, of the same agents"
            raise ValueError(f"the tests {test!r} and {minus_test!r} {told}")
        return estimate_paired(matrix(part, came), matrix(its, other))
    if not minus:
        return mean_of(part, came)
    return mean_of(part, came.cast(pl.Int8) - other.cast(pl.Int8), rate=True, lowest=-1.0)


def _of_one(episodes: pl.DataFrame, test: str, policy: str = AGENTS) -> pl.DataFrame:
    """Return the episodes of a policy in a test; raise ValueError if agents have several names."""
    part = episodes.filter(pl.col("test") == test, pl.col("policy") == policy)
    if part.is_empty():
        raise ValueError(f"there are no episodes of {policy!r} in the test {test!r}")
    if len(names := sorted({*part["agent"].drop_nulls()} if "agent" in part.columns else {})) > 1:
        told = f"got {', '.join(names)}: filter(agent=...) chooses one"
        raise ValueError(f"episodes must be of agents of one name; {told}")
    return part


def of(work: Work, test: str, agent: str) -> pl.DataFrame:
    """Return the episodes of the agents of a name in a test."""
    return work.episodes.filter(policy=AGENTS, test=test, agent=agent)


def first(work: Work, test: str, outcome: str) -> dict[str, np.ndarray]:
    """Return whether an outcome occurred in a test's distinguishing levels.

    It is [agents, levels] for the agents of each name.
    """
    apart = {name: of(work, test, name).filter("distinguishing") for name in work.plan.agents}
    return {name: matrix(part, pl.col("outcome") == outcome) for name, part in apart.items()}


def findings(work: Work) -> Findings:
    """Return the usual findings of a plan, for each kind of agents.

    Its first two tests are `tests_of` a shift; others have their place in the tables.

    Raises:
        ValueError: If agents have no episodes in one of these.
    """
    kinds = [*work.plan.agents, *work.plan.own]
    names = {name: (name, name) for name in kinds} if kinds[1:] else {kinds[0]: ("the agent", "it")}
    told = [_of_kind(work, kind, *words) for kind, words in names.items()]
    answer = " ".join(answer for answer, _ in told)
    return findings_of(work, answer, [claim for _, both in told for claim in both])


def _of_kind(work: Work, kind: str, who: str, it: str) -> tuple[str, list[Claim]]:
    """Return the answer and claims of `findings` for the agents of one name, called `who`, `it`."""
    train, test, *_ = work.plan.tests
    shift = load_shift(work.plan.game, work.plan.tests[test].shift)
    mine = work.episodes.filter(agent=kind)
    learned = rate(mine, train, INTENDED)
    intended, proxies = f"“{shift.intended}”", " or ".join(f"“{goal}”" for goal in shift.proxies)
    apart = mine.filter("distinguishing", test=test)
    tried = mine if apart.is_empty() else apart
    first = {name: rate(tried, test, name) for name in (INTENDED, MISGENERALIZED)}
    both = [_of_one(mine, one) for one in (test, train)]
    if not of_streams(work.plan) and {*both[0]["level"]} == {*both[1]["level"]}:
        lost = rate(mine, test, INTENDED, minus_test=train)
    else:
        lost = minus(*(rate(mine, one, INTENDED) for one in (test, train)))
    other = f", and {proxies} first in {first[MISGENERALIZED].short()}"
    other += ", where levels distinguish these" * (not apart.is_empty())
    return (
        f"In the training levels of the shift, {who} reaches {intended} first in "
        f"{learned.short()}; in the test in {first[INTENDED].short()}{other if proxies else ''}.",
        [
            above(
                f"In the training levels of the shift, {who} reaches {intended} first.",
                "", INTENDED, learned, LEARNED,
            ),
            below(
                f"In the test {it} reaches {intended} less often than in training.",
                "", f"{INTENDED}, in the test minus in training", lost,
            )
            if not proxies
            else above(
                f"In the test {it} reaches {proxies} first more often than {intended}.",
                "", f"{MISGENERALIZED} minus {INTENDED}",
                rate(tried, test, MISGENERALIZED, minus=INTENDED),
            ),
        ],
    )  # fmt: skip


def findings_of(
    work: Work,
    answer: str,
    claims: Sequence[Claim],
    plots: Sequence[Plot] = (),
    *,
    tables: Sequence[Table] = (),
    agent: str | None = None,
    told: Mapping[str, str] | None = None,
) -> Findings:
    """Return findings with the usual tables, plots and `videos`, and the given ones.

    Args:
        agent: Name of the agents in the videos; None for the first ones.
        told: Further settings.
    """
    usual = [table for table in outcome_tables(work) if not table.frame.is_empty()]
    shown, more = [], {"videos": f"none: {STREAMS}"} if of_streams(work.plan) else {}
    try:
        shown = [] if more else videos(work, agent=agent)
    except (Failed, Silent) as error:  # an environment may fail to render, at any step
        more = {"videos": f"none: {brief(error)}"}
    return Findings(
        answer=answer,
        claims=claims,
        videos=shown,
        plots=[*outcome_plots(work, usual), *plots],
        tables=[*usual, *tables],
        settings=settings(work.plan) | more | dict(told or {}),
    )


def played(work: Work, test: str, value: str | pl.Expr, policy: str = AGENTS) -> np.ndarray:
    """Return a column or expression of a policy's episodes in a test, [agents, levels].

    Raises:
        ValueError: If they are of agents of several names.
    """
    part = _of_one(work.episodes, test, policy)
    return matrix(part, pl.col(value) if isinstance(value, str) else value)


def beyond(work: Work, test: str, value: str | pl.Expr, policy: str = "random") -> Estimate:
    """Estimate the agents' mean of an episode's value, minus a script's in the same levels."""
    mine, its = (played(work, test, value, which) for which in (AGENTS, policy))
    return estimate_paired(mine, its + 0 * mine)


def table_of(found: Mapping[Any, Estimate], *names: str) -> pl.DataFrame:
    """Return estimates by a key, or by a tuple of keys, as a table.

    Columns: `names`, of the keys; mean, low, high; n, of levels.
    """
    rows = [
        [*(key if names[1:] else [key]), one.mean, one.low, one.high, one.levels]
        for key, one in found.items()
    ]
    return pl.DataFrame(rows, [*names, "mean", "low", "high", "n"], orient="row")


def of_streams(plan: Plan) -> bool:
    """Return whether the environments of a plan choose their levels themselves."""
    return isinstance(game := plan.game, World) and game.level_key is not None


def outcome_tables(work: Work) -> tuple[Table, Table]:
    """Return the rate of each outcome, in all levels and in the distinguishing ones."""
    by = ("agent", "policy", "test")
    apart, names = work.episodes.filter("distinguishing"), outcomes_of(work.plan.game)
    return (
        Table("outcomes", "All levels", rates(work.episodes, by, names)),
        Table("distinguishing", "Distinguishing levels", rates(apart, by, names)),
    )


def outcome_plots(work: Work, tables: Sequence[Table]) -> list[Plot]:
    """Plot `outcome_tables`, or the first of them, with a panel per test."""
    captions = (
        "Which goal was reached first, in all levels.",
        "The same in the distinguishing levels: the shortest way to either goal does not "
        "pass the other.",
    )
    shown = [_who_and_where(work.plan, table.frame) for table in tables]
    return [
        Plot(table.name, caption, charts.outcome_bars(data), data)
        for table, caption, data in zip(tables, captions, shown, strict=False)
    ]


def _who_and_where(plan: Plan, table: pl.DataFrame) -> pl.DataFrame:
    """Return `rates` in the form of `figures.outcome_bars`, agents first."""
    scripts: dict[str, str] = {}
    for shift in (load_shift(plan.game, test.shift) for test in plan.tests.values()):
        for goal in shift.proxies:
            scripts.setdefault(Walk(goal).name, f"walks to the {goal}, blind to the rest")
        scripts.setdefault(Walk(shift.intended).name, f"walks to the {shift.intended}")
    scripts["random"] = "random"
    count = f"{plan.seeds} agents" if plan.seeds > 1 else "one agent"
    kinds = [*plan.agents, *plan.own]
    named = [f"{name}: {count}" if len(kinds) > 1 or plan.own else count for name in kinds]
    order = {**dict(zip(kinds, named, strict=True)), **scripts}
    where = {name: f"{test.name}: {name}" for name, test in plan.tests.items()}
    return (
        table.with_columns(
            who=pl.coalesce("agent", "policy").replace(order), where=pl.col("test").replace(where)
        )
        .sort(
            pl.col("where").cast(pl.Enum([*where.values()])),
            pl.col("who").cast(pl.Enum([*order.values()])),
            maintain_order=True,
        )
        .select("who", "where", "outcome", "mean", "low", "high")
    )


def curves(trained: Runs) -> pl.DataFrame:
    """Return the metrics of trainings.

    Columns: agent (name), seed, steps, and the metrics.

    Metrics of episodes are null until the first could have timed out, because at first only short
    ones have ended.
    """
    tables = []
    for name, runs in trained.items():
        for run in runs:
            config = read_config(run)
            lines = checkpoint.metrics(run) or {"steps": []}
            table = pl.DataFrame(lines, infer_schema_length=None)
            tables.append(
                table.with_columns(
                    agent=pl.lit(name), seed=pl.lit(config.seed), **fair(table, config)
                )
            )
    return pl.concat(tables, how="diagonal_relaxed")


def fair(table: pl.DataFrame, config: Config) -> dict[str, pl.Expr]:
    """Return a training's metrics of episodes, null while these are few."""
    iteration = pl.col("steps") // config.batch
    rounds = {"training": (iteration, config.training_variant())}
    if config.validation:
        every, tested = config.validation_every, config.variant_for(config.validation)
        rounds["validation"] = ((iteration + every - 1) // every, tested)
    return {
        column: pl.when(rounds[which][0] * config.num_steps >= rounds[which][1].time_limit).then(
            pl.col(column)
        )
        for column in table.columns
        if (which := column.split("/")[0]) in rounds
    }


def curve_plot(
    work: Work | Runs,
    metric: str = "return",
    label: str = "return",
    caption: str = "Mean return of recent episodes while training.",
) -> Plot:
    """Plot a metric of recent episodes during training, on both variants, per agent name."""
    trained = work.runs if isinstance(work, Work) else work
    data = curves(trained)
    series = {f"{which}/{metric}": f"{which} variant" for which in ("training", "validation")}
    there = {column: name for column, name in series.items() if column in data.columns}
    name = "curves" if metric == "return" else f"curves-{metric.replace('_', '-')}"
    others = published_curves(trained, data) if metric == "return" else None
    if others is not None and len(others):
        caption += " Dashed: training returns of the paper's own program, from its public logs."
    return Plot(name, caption, learning_curves(data, there, label, others), data)


def published_curves(trained: Runs, data: pl.DataFrame) -> pl.DataFrame:
    """Return published curves of the worlds that agents were trained in, by agent name."""
    last = dict(data.group_by("agent").agg(pl.col("steps").max()).iter_rows())
    return pl.concat(
        beside(read_config(runs[0]), last.get(name, 0)).with_columns(agent=pl.lit(name))
        for name, runs in trained.items()
    )


def settings(plan: Plan) -> dict[str, str]:
    """Return the agents' settings; differing ones with the names of their agents."""
    every = {name: config.flat() for name, config in plan.agents.items()}
    told = {}
    for key in next(iter(every.values()), {}):
        values = {name: str(config[key]) for name, config in every.items()}
        several = ", ".join(f"{name}: {value}" for name, value in values.items())
        told[key] = several if len(set(values.values())) > 1 else values.popitem()[1]
    if plan.own:
        told = {"world": plan.game.name, "agents": ", ".join(plan.own)}
    told["seeds"] = str(plan.seeds)
    if of_streams(plan):  # how many levels their episodes meet shows as they are played
        return told | {"levels": STREAMS, "episodes evaluated": str(plan.levels)}
    near, far = (f"rates {100 * one:.0f}\u00a0% from their bound" if one < 1 else "no rates"
                 for one in plan.power()[: len(SPREADS)])  # fmt: skip
    return told | {
        "levels evaluated": str(plan.levels),
        "found with a power of 80\u00a0%": near + f", or {far} where agents differ most, by a "
        f"standard deviation of {100 * max(SPREADS):g}\u00a0%" * (far != near),
    }


def videos(work: Work, *, trained: Test | None = None, agent: str | None = None) -> list[Video]:
    """Show an agent in a training level and the test level of that number, for each outcome.

    The most common outcome comes first. Each shows the first distinguishing level whose way to the
    proxy (or else to the intended goal) is longer than in most levels, or else the first of all.

    Args:
        trained: Test that is shown as the training, with the plan's first test. None for the plan's
            first two tests; if it has one alone, for the variant that the agent was trained on.
        agent: Name of the agents; None for the first ones.
    """
    plan = work.plan
    name = agent or next(iter(work.runs))
    player = open_agents(plan, {name: work.runs[name][:1]})[name][0]
    first, *others = plan.tests
    where = others[0] if others and trained is None else first
    tested = plan.tests[where]
    if trained is None:
        trained = plan.tests[first] if others else Test(plan.agents[name].variant, tested.shift)
    game, shift = plan.game, load_shift(plan.game, tested.shift)
    apart, which = work.episodes.filter("distinguishing", test=where), "levels"
    if apart.is_empty():
        apart = work.episodes.filter(test=where)
    else:
        which += " that distinguish the goals"
    who = [name] * (len(work.runs) > 1) + [f"seed {player.seed}"] * (len(work.runs[name]) > 1)
    which += f", played by {', '.join(who)}" * bool(who)
    goal = (*shift.proxies, shift.intended)[0]
    mine = far = apart.filter(policy=AGENTS, agent=name, seed=player.seed)
    if goal in game.walked:
        way = reached(game.goals[goal])
        ways = apart.filter(policy=Walk(goal).name)
        far = farther if len(farther := ways.filter(way > way.median())) else ways
    common = mine["outcome"].value_counts(sort=True)
    own: Any = plan.variant_of if plan.own else lambda test: test.variant_for(plan.agents[name])
    variants, shown = [(test, own(test)) for test in (trained, tested)], []
    for outcome, count in common.rows():
        alike = mine.filter(outcome=outcome)
        for level in pl.concat([alike.join(far, on="level", how="semi"), alike])["level"][:1]:
            pair = [(f"{test.name} {level}", variant) for test, variant in variants]
            path = work.folder / "videos" / f"{outcome.replace(' ', '-')}.mp4"
            (row,) = alike.filter(level=level).to_dicts()
            drawn = write_pair(
                player, game, pair, level, path, fps=8, told=row, longest=plan.longest
            )
            shown.append(
                Video(
                    f"{outcome.capitalize()}, as in {rounded(count / len(mine))} of the "
                    f"{which}: level {level} as in training, and in the test.{drawn}",
                    path,
                    None
                    if plan.own or tested.knobs or tested.name != tested.variant
                    else Scene(work.runs[name][0], tested.variant, level),
                )
            )
    return shown
