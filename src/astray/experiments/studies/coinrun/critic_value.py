"""Does the critic value the coin, or the end of the level where the coin always was?"""

import numpy as np
import polars as pl

from astray.analysis.critic import counterfactual, visit
from astray.analysis.estimates import Estimate, group_means, mean_of
from astray.analysis.runs import open_run
from astray.experiments import outcomes
from astray.experiments.levels import levels_of
from astray.experiments.spec import Experiment, Test, Work
from astray.experiments.studies.coinrun import _agents
from astray.experiments.studies.coinrun._agents import RUNNER
from astray.figures import charts
from astray.games.coinrun import edits, measures
from astray.games.coinrun.measures import STAGES
from astray.report.claims import Claim, above, every, near_zero, rounded
from astray.report.findings import Findings, Plot, Table

BEGINNING, MIDDLE, END, BEYOND = STAGES
HALF_AT_END, PAST_END, NO_COIN, TRAINED = "half at the end", "past the end", "none", "in training"
TESTS = {
    # In half of the levels the coin is at the end, in the others anywhere.
    HALF_AT_END: Test("coin-half", "coin-end", {"place": "anywhere"}),
    PAST_END: Test(  # for states beyond the end alone
        "coin-end-permeable-continue", "coin-end", {"place": "anywhere", "random_coin": 0.5}
    ),
    NO_COIN: Test("coin-absent", "coin-end"),
    TRAINED: Test("coin-end", "coin-end"),  # where values are compared with what came
}
BRIEF = 300  # steps; who misses the coin stays for 1,000, of which most look alike
BINS = 8  # of values, as many states in each
DRAWN = 5  # states of each episode, as in the original of each 256 steps
REMOVED, ADDED = "taken away", "put in view"
LITTLE, HALF = 0.1, 0.5  # of what the end adds, that the coin may add in "insignificant", "less"
CHANGE = Estimate.change


def find(work: Work) -> Findings:
    table = work.keep("values", lambda: values(work))
    absent, trained = table.filter(test=NO_COIN), table.filter(test=TRAINED)
    table = table.filter(pl.col("test").is_in([HALF_AT_END, PAST_END]))
    bars = by_stage(table, "value", ["coin"])
    alone = by_stage(absent, "value", [])
    alone_rise, rise = mean_of(rises(absent), "rise"), mean_of(rises(table), "rise")
    came, unit = calibration(trained), unit_of(work)
    effects = by_stage(effects_of(table), "effect", ["coin_is"])
    removed = {row["stage"]: Estimate.of(row) for row in effects.filter(coin_is=REMOVED).to_dicts()}
    stage, largest = max(removed.items(), key=lambda item: abs(item[1].mean))
    most = f"{largest.mean:+z.2f} at the stage “{stage}”"

    def adding_at_most(fraction: float) -> list[Claim]:
        """Return, for each stage, the claim that the coin adds at most `fraction` of the end."""
        margin = max(0.0, round(fraction * rise.low, 3))
        return [
            near_zero("", "", f"with the coin minus without, {stage}", effect, margin, told=CHANGE)
            for stage, effect in removed.items()
        ]

    both = came.select("expected", "mean").to_numpy()
    ends = [both.min(), both.max()]  # of the line where returns equal their expectation
    equal = pl.DataFrame({"expected": ends, "mean": ends, "what": "as expected"})
    came_figure = charts.curves(
        pl.concat([came.with_columns(what=pl.lit("what came")), equal], how="diagonal_relaxed"),
        x="expected", line="what", x_label="the critic's value", base=["as expected"],
        label="discounted return that came", whiskers=True,
    )  # fmt: skip
    seen = pl.when("coin").then(pl.lit("coin in view")).otherwise(pl.lit("no coin in view"))
    stages = charts.points(
        bars.with_columns(seen=seen, n=pl.format("n = {}", "rows")),
        row="stage", group="seen", note="n", label="the critic's value",
    )  # fmt: skip
    coins = charts.points(
        effects.with_columns(coin=pl.format("coin {}", "coin_is")),
        row="stage", group="coin", at={"": 0}, label="value with the coin, minus without it",
    )  # fmt: skip

    return Findings(
        answer=f"From the beginning of a level to its end the value rises by {rise.mean:z.2f} "
        f"(in the unit of the training's rewards); what a coin in view adds to the value of the "
        f"same state is at most {most}.",
        claims=[
            above(
                "The value is higher at the end of the level than at its beginning.",
                "much higher (no number given)",
                f"{END} minus {BEGINNING}",
                rise,
                told=CHANGE,
            ),
            every(
                "The coin has an insignificant effect at all stages of a level.",
                "insignificant at all stages, n = 950",
                adding_at_most(LITTLE),
                "the same state with and without its coin tells smaller effects from none than "
                f"other pictures do; the largest is {rounded(abs(largest.mean / rise.mean))} of "
                "the rise",
            ),
            above(
                "Where a level holds no coin at all, the value rises to its end all the same.",
                "not measured",
                f"{END} minus {BEGINNING}",
                alone_rise,
                told=CHANGE,
            ),
            every(
                "The coin adds less than half of what the end of the level adds.",
                "much higher at the end; the coin insignificant",
                adding_at_most(HALF),
            ),
        ],
        plots=[
            Plot(
                "calibration",
                "The return that the critic expects, and the actual one, in levels of training: "
                f"the discounted return from a state on, of {BINS} groups of states by value, "
                f"with 95\u00a0% intervals. {unit}",
                came_figure,
                came,
            ),
            Plot(
                "stages",
                "The critic's value at different stages of a level, with and without a coin in "
                "view, as in the paper; with 95\u00a0% intervals over agents and levels. Stages "
                "are thirds of the way to the end, and what is beyond the face of a wall that "
                "lets pass.",
                stages,
                bars,
            ),
            Plot(
                "coins",
                "The effect of a coin on the value of a state: a coin in view is removed, and "
                "otherwise one is put at a random visible place to stand.",
                coins,
                effects,
            ),
        ],
        tables=[
            Table("stages", "Values by stage and coin", bars),
            Table("no-coin", "Values by stage in levels that hold no coin", alone),
            Table("calibration", "Values and the returns that came", came),
            Table("coins", "The effect of a coin on the value of a state", effects),
        ],
        settings=outcomes.settings(work.plan)
        | {
            "states": f"{len(table):,}, up to {DRAWN} of each episode",
            "the paper and its code": "There each picture was labelled by hand, and its error bars "
            "are from the 5th to the 95th percentile, which is a 90\u00a0% interval; all pictures "
            "were of one agent and resampled alone. Here stage and coin come from the state, and "
            "intervals are over agents and levels.",
        },
    )


def values(work: Work) -> pl.DataFrame:
    """Return a row for each state sampled from the agents' episodes.

    Columns: agent (seed), test, level, step, stage; value; future, the discounted return; coin,
    whether one is in view; taken_away and put_in_view: the effect of the coin on the value, or
    null.
    """
    parts = []
    for name, test in work.plan.visited.items():
        levels = levels_of(work.plan, test)
        for run in work.runs[RUNNER]:
            agent, config = open_run(run)
            variant = test.variant_for(work.plan.config)
            rows, states = visit(agent, variant, levels, per_episode=DRAWN, gamma=config.gamma)
            stage = measures.stage(states)
            wanted = (stage == STAGES.index(BEYOND)) == (name == PAST_END)
            if not wanted.any():
                continue
            rows, states = rows.filter(wanted), states[wanted]
            away = counterfactual(agent, variant, states, edits.without_coin)
            more = counterfactual(agent, variant, states, edits.with_coin_in_view)
            seen, put = away["seen"], more["seen"] & ~away["seen"]
            parts.append(
                rows.select("level", "step", "value", "future").with_columns(
                    test=pl.lit(name),
                    agent=pl.lit(config.seed),
                    stage=pl.Series(np.array(STAGES)[stage[wanted]]),
                    coin=seen,
                    taken_away=pl.when(seen).then(-away["change"]),
                    put_in_view=pl.when(put).then(more["change"]),
                )
            )
    return pl.concat(parts)


def effects_of(table: pl.DataFrame) -> pl.DataFrame:
    """Return a row for each coin removed or added: agent, level, stage, effect."""
    same = table.select("agent", "level", "stage", "taken_away", "put_in_view")
    same = same.rename({"taken_away": REMOVED, "put_in_view": ADDED})
    return same.unpivot(
        index=("agent", "level", "stage"), variable_name="coin_is", value_name="effect"
    ).drop_nulls("effect")


def rises(table: pl.DataFrame) -> pl.DataFrame:
    """Return the rise of the value from beginning to end, for each agent in common levels."""
    means = table.group_by("agent", "level", "stage").agg(pl.col("value").mean())
    ends, beginnings = means.filter(stage=END), means.filter(stage=BEGINNING)
    both = ends.join(beginnings, on=("agent", "level"), suffix="_before").sort("agent", "level")
    return both.with_columns(rise=pl.col("value") - pl.col("value_before"))


def by_stage(rows: pl.DataFrame, value: str, by: list[str]) -> pl.DataFrame:
    """Return means of `value` by stage and `by`, in the order of STAGES."""
    return group_means(rows, value, ["stage", *by]).sort(pl.col("stage").cast(pl.Enum(STAGES)), *by)


def calibration(table: pl.DataFrame) -> pl.DataFrame:
    """Return states in BINS groups by value: group, expected (mean value), and the mean return."""
    order = table["value"].rank("ordinal").to_numpy() - 1
    grouped = table.with_columns(group=pl.Series((order * BINS // len(table)).astype(int)))
    came = group_means(grouped, "future", ["group"])
    return came.join(
        grouped.group_by("group").agg(expected=pl.col("value").mean()), on="group"
    ).sort("group")


def unit_of(work: Work) -> str:
    """Return the unit of the critic's values, in units of returns."""
    config = open_run(work.runs[RUNNER][0])[1]
    if config.normalise_reward:
        return "Values are in standard deviations of returns, as in the training."
    return "Both are in the unit of the game's rewards; on the line they are equal."


EXPERIMENT = Experiment(
    title="What the critic values",
    reproduces="Figure 6",
    question="Does the critic value the coin, or the end of the level, where the coin always was?",
    sizes=_agents.plans(
        {"smoke": 300, "pixels": 300, "night": 300, "hour": 500, "paper": 1000, "published": 300},
        visited=TESTS,
        brief=BRIEF,
    ),
    find=find,
)
