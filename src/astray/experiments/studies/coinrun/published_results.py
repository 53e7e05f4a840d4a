"""Others' results, joined with a script's results in the same levels."""

import numpy as np
import polars as pl

from astray.analysis.estimates import estimate_difference, estimate_mean, estimate_paired
from astray.analysis.evaluate import evaluate
from astray.analysis.policies import Random
from astray.experiments.spec import Experiment, Plan, Work
from astray.experiments.studies.coinrun._agents import RIGHT_AND_JUMP, fate_bars
from astray.games.coinrun.levels import BEGIN
from astray.published import catalogue
from astray.published.results import read_results
from astray.report.claims import above, below, rounded
from astray.report.findings import Findings, Plot, Table

SOURCE = "paper-coinrun-results"  # of the catalogue of published agents
VARIANT = "coin-ledge"  # its levels: the paper's game, the coin at the random place in all
SCRIPT, RANDOM = RIGHT_AND_JUMP.name, "random"
FATES = ("took it", "end without it", "died", "time was up")
CLOSE, APART = 0.05, 0.1  # differences of fractions that claims are held to


def find(work: Work) -> Findings:
    theirs = read_results(catalogue.results_file(SOURCE)).sort("level").head(work.plan.levels)
    ours = work.keep("scripts", lambda: scripts(theirs["level"].to_numpy()))
    script = ours.filter(policy=SCRIPT).sort("level")
    taken = theirs["coin"].to_numpy().astype(bool)
    by_script = script["took_coin"].is_not_null().to_numpy()
    agent, blind = estimate_mean(taken), estimate_mean(by_script)
    gap = estimate_paired(taken, by_script)
    where = {True: estimate_mean(taken[by_script]), False: estimate_mean(taken[~by_script])}
    foretold = estimate_difference(taken[by_script], taken[~by_script], same_levels=False)
    near = script["is_near"].to_numpy().astype(bool)
    died = {
        name: estimate_mean(theirs["died"].to_numpy()[which])
        for name, which in {"the first section": near, "a later one": ~near}.items()
    }
    rates = [
        {"where": f"right and jump {'takes' if k else 'does not take'} it", "what": "taken"}
        | vars(one)
        for k, one in where.items()
    ] + [{"where": f"the coin is in {k}", "what": "died"} | vars(one) for k, one in died.items()]
    bars = fates(theirs, ours)
    return Findings(
        answer=f"The published agent takes the coin in {rounded(agent.mean)} of the levels, a "
        f"script that holds right and jump, blind to all, in {rounded(blind.mean)} of the same. "
        f"Where the script takes it the agent does in {rounded(where[True].mean)}, elsewhere in "
        f"{rounded(where[False].mean)}.",
        claims=[
            below(
                "Taking a coin at the original's random place shows no more than running "
                "right does.",
                "not measured",
                "agent minus script",
                gap,
                CLOSE,
            ),
            above(
                "The blind script's behaviour in a level predicts the agent's.",
                "not measured",
                "taken where the script takes the coin minus where it does not",
                foretold,
                APART,
            ),
        ],
        plots=[
            Plot("fates", "The fates of episodes in the same levels.", fate_bars(bars, FATES), bars)
        ],
        tables=[
            Table("fates", "The fates of episodes in the same levels", bars),
            Table(
                "foretold",
                "The rates at which the agent takes the coin, and dies",
                pl.DataFrame(rates),
            ),
        ],
        settings={
            "the file": f"{catalogue.find(SOURCE).known.source}; one agent, trained by others with "
            "the paper's program and settings",
            "levels": f"{len(theirs):,}, those of the file; they are numbered as here",
            "variant": VARIANT,
        },
    )


def scripts(levels: np.ndarray) -> pl.DataFrame:
    """Return scripts' episodes in `levels` [N]; `is_near`: the coin is in the first section."""
    return pl.concat(
        [
            evaluate(
                policy,
                "coinrun",
                VARIANT,
                levels,
                until=["reached_end"],
                measures={"is_near": lambda s: s["coin_x"] == BEGIN},
            )
            for policy in (RIGHT_AND_JUMP, Random())
        ]
    )


def fates(theirs: pl.DataFrame, ours: pl.DataFrame) -> pl.DataFrame:
    """Return columns test (who), fate, mean."""
    alone = ~pl.col("end")  # what came after the end does not count
    told = {
        "published agent": theirs.select(
            "coin", "end", died=pl.col("died") & alone, timed_out=pl.col("timed_out") & alone
        )
    }
    for policy in (SCRIPT, RANDOM):
        of = ours.filter(policy=policy)
        coin, end = pl.col("took_coin").is_not_null(), pl.col("reached_end").is_not_null()
        died = pl.col("died").is_not_null()
        told[policy] = of.select(
            coin=coin, end=end & ~coin, died=died & ~end, timed_out=~(coin | end | died)
        )
    return pl.DataFrame(
        [
            {"test": who, "fate": fate, "mean": float(table[column].mean() or 0)}  # type: ignore[arg-type]
            for who, table in told.items()
            for fate, column in zip(FATES, table.columns, strict=True)
        ]
    )


EXPERIMENT = Experiment(
    title="Others' results, examined again",
    reproduces="the levels of Figure 2",
    question="How much of what a published agent takes would a blind runner have taken?",
    sizes={"published": Plan(levels=10_000, differences="the agent was played by others")},
    find=find,
)
