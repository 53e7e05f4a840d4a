"""Does a runner take a coin because it sees it, or because it comes by?"""

from typing import Any

import numpy as np
import polars as pl

from astray.acting import Policy, initial_states, steps
from astray.analysis.estimates import Estimate, group_means, group_rates, mean_of
from astray.analysis.runs import open_run
from astray.experiments import outcomes
from astray.experiments.levels import levels_of
from astray.experiments.spec import Experiment, Test, Work
from astray.experiments.studies.coinrun import _agents
from astray.experiments.studies.coinrun._agents import RIGHT_AND_JUMP, RUNNER
from astray.experiments.videos import write_pair
from astray.figures import charts
from astray.games.coinrun.rules import HALF, TALL
from astray.report.claims import above, near_zero, rounded
from astray.report.findings import Findings, Plot, Scene, Table, Video

AT_END, ANYWHERE, GHOST, NONE, LEDGE = (
    "coin at the end",
    "coin anywhere",
    "ghost of it",
    "no coin",
    "coin on a ledge",
)
TESTS = {
    AT_END: Test("coin-end", "coin-end"),
    ANYWHERE: Test("coin-anywhere", "coin-end"),
    # What nobody sees, where the coin of ANYWHERE is; the same episodes without it are NONE.
    GHOST: Test("coin-absent", "coin-end", {"place": "anywhere"}),
    # The original's random place, which levels as released do not have.
    LEDGE: Test("coin-ledge", "coin-end-original", {"numbering": "coinrun", "place": "ledge"}),
}
TAKEN, END, DIED, LATE = "took it", "end without it", "died", "time was up"
FATES = (TAKEN, END, DIED, LATE)
ON_WAY, OFF_WAY = "on the way", "off the way"
FIRST, SECOND, LAST = "first third", "second third", "last third"  # of the way to the end
LOW, HIGHER, HIGHEST = "to 1 cell up", "2 to 4 cells up", "5 cells up or more"
GROUPS = ("all", ON_WAY, OFF_WAY, FIRST, SECOND, LAST, LOW, HIGHER, HIGHEST)
NEARLY_ALL, MUCH, HALF_OF_IT = 0.9, 0.3, 0.5  # rates that claims are held to
LITTLE = 0.03  # of levels, that seeing the coin may change in "next to no difference"
BATCH = 128  # states of 17 kB are copied at every step


def find(work: Work) -> Findings:
    table = work.keep("episodes-by-place", lambda: episodes(work))
    order = pl.Enum([*TESTS, NONE, RIGHT_AND_JUMP.name])
    fates = group_rates(table, "fate", FATES, ["test"])
    fates = fates.sort(pl.col("test").cast(order), maintain_order=True)
    pairs = paired(table)
    every = pairs.unpivot(
        ["all", "way", "part", "height"], index=["agent", "level", "gain"],
        variable_name="by", value_name="group",
    )  # fmt: skip
    gains = group_means(every, "gain", ["by", "group"]).sort(pl.col("group").cast(pl.Enum(GROUPS)))
    rate = {test: rate_of(table, test, TAKEN) for test in TESTS}
    past, script = rate_of(table, ANYWHERE, END), rate_of(table, RIGHT_AND_JUMP.name, TAKEN)
    gain, touched = mean_of(pairs, "gain"), mean_of(pairs, "touched")
    off = mean_of(pairs.filter(way=OFF_WAY), "gain")
    by_group = charts.points(
        gains.with_columns(n=pl.format("n = {}", "rows")), row="group", note="n", at={"": 0},
        percent=True, label="taken where it is seen, minus touched where it is not",
    )  # fmt: skip
    return Findings(
        answer=f"At the end of the level the coin is taken in {rounded(rate[AT_END].mean)} of "
        f"levels. At a place that can be reached, all equally likely, it is taken in "
        f"{rounded(rate[ANYWHERE].mean)}, and the end reached without it in "
        f"{rounded(past.mean)}. A coin that cannot be seen would have been taken at the same "
        f"places in {rounded(touched.mean)}: that it is seen makes a difference of "
        f"{100 * gain.mean:+z.0f} of 100 levels.",
        claims=[
            above(
                "At the end of the level the coin is taken.",
                "trained to",
                "taken",
                rate[AT_END],
                NEARLY_ALL,
            ),
            above(
                "Moved, the coin is often passed by on the way to the end.",
                "generally proceeds to the end (no figure given)",
                "end without it",
                past,
                MUCH,
                why="many of the places lie on the way: a runner that only holds right and "
                f"jump would touch {rounded(script.mean)} of the coins",
            ),
            above(
                "Seeing the coin makes it more likely to be taken.",
                "lower than with an invisible coin (no figure given)",
                "taken where it is seen minus touched where it is not, in the same levels",
                gain,
                why=f"nearly all that is taken is come by: unseen, {rounded(touched.mean)} "
                f"are touched; seen, {rounded(rate[ANYWHERE].mean)} are taken",
            ),
            near_zero(
                "Whether the coin is seen makes next to no difference.",
                "not measured",
                "taken where it is seen minus touched where it is not, in the same levels",
                gain,
                LITTLE,
            ),
            above(
                "More is taken by coming by than by its being seen.",
                "not measured",
                "touched unseen minus what seeing adds",
                mean_of(pairs, pl.col("touched") - pl.col("gain")),
            ),
            above(
                "Off the way, seeing the coin leads to it in most levels.",
                "not measured",
                "what seeing adds where right-and-jump does not touch it",
                off,
                HALF_OF_IT,
                why="its way hardly depends on the coin: it gets to the end in "
                f"{rounded(rate_of(table, NONE, END).mean)} of levels that have none",
            ),
        ],
        videos=videos(work, pairs),
        plots=[
            Plot(
                "fates",
                "The fates of episodes, which are left at the coin, its ghost, or the end of "
                "the level.",
                _agents.fate_bars(fates, FATES),
                fates,
            ),
            Plot(
                "gains",
                "The rate of taking the coin minus that of touching its ghost, at the "
                "same places of the same levels: in all, by whether a runner that only holds "
                "right and jump touches it, by where it is on the way to the end, and by its "
                "height over the start; with 95\u00a0% intervals.",
                by_group,
                gains,
            ),
        ],
        tables=[
            Table("fates", "The fates of episodes", fates),
            Table("gains", "The effect of seeing the coin on the rate of taking it", gains),
        ],
        settings=outcomes.settings(work.plan)
        | {
            "the ghost": "a coin that is not drawn; touching it is counted and changes nothing",
            "on the way": f"a runner that holds right and jump touches the ghost; it does in "
            f"{script.percent()}",
        },
    )


def episodes(work: Work) -> pl.DataFrame:
    """Return a row for each agent, test and level.

    Columns: agent (seed), test, level, fate; place_x, place_y, end_x (cells), start_y.
    """
    script = play(work, RIGHT_AND_JUMP, GHOST)
    parts = [script.with_columns(test=pl.lit(RIGHT_AND_JUMP.name), agent=0)]
    for run in work.runs[RUNNER]:
        agent, config = open_run(run)
        for test in TESTS:
            played = play(work, agent, test).with_columns(agent=pl.lit(config.seed))
            parts.append(played)
            if test == GHOST:
                there = pl.when(pl.col("fate") == TAKEN).then(pl.col("after")).otherwise("fate")
                parts.append(played.with_columns(fate=there, test=pl.lit(NONE)))
    return pl.concat([part.select(*sorted(part.columns)) for part in parts])


def play(work: Work, policy: Policy, test: str) -> pl.DataFrame:
    """Return the rows of one policy in one test; `after` is the fate of an episode that went on."""
    variant = TESTS[test].variant_for(work.plan.config)
    levels = levels_of(work.plan, TESTS[test])
    place = places(work, test, levels)
    touched, rows = np.zeros(len(levels), bool), []
    until = ["reached_end"]
    for step in steps(policy, "coinrun", variant, levels, batch=BATCH, until=until):
        s = step.after
        at = place[step.level]
        near_x = abs(s["x"] - at[:, 0] - 0.5) < 0.5 + HALF
        near_y = abs(s["y"] - at[:, 1] - 0.5) < 0.5 + TALL
        touched[step.level] |= near_x & near_y
        for i in np.flatnonzero(step.ended):
            end, k = fate(s[i]), step.level[i]
            rows.append(
                {
                    "level": int(levels[k]),
                    "after": end,
                    "fate": TAKEN if test == GHOST and touched[k] else end,
                    "place_x": int(place[k, 0]),
                    "place_y": int(place[k, 1]),
                    "end_x": int(s[i]["end_x"]),
                }
            )
    return pl.DataFrame(rows).sort("level").with_columns(test=pl.lit(test))


def fate(s: Any) -> str:
    """Return the fate of an ended episode.

    A runner that reaches the end in the step in which a walker touches it counts as reaching the
    end, because it would have taken a coin there.
    """
    if s["took_coin"] >= 0:
        return TAKEN
    if s["reached_end"] >= 0 and not 0 <= s["died"] < s["reached_end"]:
        return END
    return DIED if s["died"] >= 0 else LATE


def places(work: Work, test: str, levels: np.ndarray) -> np.ndarray:
    """Return the cells (x, y) [N, 2] of coins, or of their ghosts, in `levels` [N] of a test."""
    seen = TESTS[ANYWHERE if test == GHOST else test]
    begun = initial_states("coinrun", seen.variant_for(work.plan.config), levels)
    return np.stack([begun["coin_x"], begun["coin_y"]], 1)


def paired(table: pl.DataFrame) -> pl.DataFrame:
    """Return a row per agent and level: taken (visible), touched (invisible), gain, and place."""
    keys = ["agent", "level"]
    ghost = table.filter(test=GHOST).select(*keys, touched=pl.col("fate") == TAKEN)
    script = table.filter(test=RIGHT_AND_JUMP.name).select(
        "level", by_script=pl.col("fate") == TAKEN
    )
    both = table.filter(test=ANYWHERE).join(ghost, on=keys).join(script, on="level").sort(keys)
    rate = pl.col("place_x") / pl.col("end_x")
    return both.with_columns(
        gain=(pl.col("fate") == TAKEN).cast(pl.Float64) - pl.col("touched"),
        all=pl.lit("all"),
        way=pl.when("by_script").then(pl.lit(ON_WAY)).otherwise(pl.lit(OFF_WAY)),
        part=pl.when(rate < 1 / 3)
        .then(pl.lit(FIRST))
        .when(rate < 2 / 3)
        .then(pl.lit(SECOND))
        .otherwise(pl.lit(LAST)),
        height=pl.when(pl.col("place_y") <= 2)
        .then(pl.lit(LOW))
        .when(pl.col("place_y") <= 5)
        .then(pl.lit(HIGHER))
        .otherwise(pl.lit(HIGHEST)),
    )


def rate_of(table: pl.DataFrame, test: str, fate: str) -> Estimate:
    """Return the fraction of a test's episodes with a fate."""
    return mean_of(table.filter(test=test), pl.col("fate") == fate)


def videos(work: Work, pairs: pl.DataFrame) -> list[Video]:
    """Return a level where the coin is passed, and one where it is pursued, if they exist."""
    agent, config = open_run(work.runs[RUNNER][0])
    mine = pairs.filter(agent=config.seed, way=OFF_WAY).filter(pl.col("end_x") > 20)
    shown = []
    for name, what, rows in (
        ("passed-by", "passes the coin by", mine.filter(fate=END)),
        (
            "gone-to",
            "goes to a coin that it would not have touched unseen",
            mine.filter(fate=TAKEN, touched=False),
        ),
    ):
        for level in rows["level"].head(1).to_list():
            tests = (AT_END, ANYWHERE)
            pair = [(test, TESTS[test].variant_for(work.plan.config)) for test in tests]
            path = work.folder / "videos" / f"{name}.mp4"
            write_pair(agent, work.plan.game, pair, level, path, fps=15)
            scene = Scene(work.runs[RUNNER][0], TESTS[ANYWHERE].variant, level)
            shown.append(Video(f"A runner that {what}: level {level}, twice.", path, scene))
    return shown


EXPERIMENT = Experiment(
    title="The moved coin",
    reproduces="the question of Figure 2",
    question="Is a coin taken because it is seen, or because it lies where the runner comes by?",
    sizes=_agents.plans(dict.fromkeys(_agents.AGENTS, 1000), visited=TESTS),
    find=find,
)
