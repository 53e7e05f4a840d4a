"""What does a runner do at a permeable end wall, and where is its critic's value highest?"""

from dataclasses import replace
from typing import Any

import numpy as np
import polars as pl

from astray.analysis import video
from astray.analysis.critic import policy_and_value, visit
from astray.analysis.estimates import group_means, group_rates, mean_of
from astray.analysis.runs import open_run
from astray.experiments import outcomes
from astray.experiments.levels import levels_of
from astray.experiments.outcomes import AGENTS
from astray.experiments.spec import Experiment, Test, Work
from astray.experiments.studies.coinrun import _agents
from astray.experiments.studies.coinrun._agents import RUNNER
from astray.figures import charts
from astray.figures.grids import Picture, images
from astray.games.coinrun import measures
from astray.report.claims import above, rounded
from astray.report.findings import Findings, Plot, Table, Video

COLUMNS = 15  # of the wall
ANYWHERE, AT_END, NONE = "coin anywhere", "coin at the end", "no coin"
TESTS = {  # a coin never ends the episode, or there is none
    ANYWHERE: Test(
        "coin-end-permeable-continue", "end-or-wall", {"random_coin": 1.0, "place": "anywhere"}
    ),
    AT_END: Test("coin-end-permeable-continue", "end-or-wall"),
    NONE: Test("coin-end-permeable", "end-or-wall", {"coins": "none"}),
}
THROUGH, INSIDE, BEFORE, DIED = "went through", "stayed in it", "stayed before it", "died"
FATES = (THROUGH, INSIDE, BEFORE, DIED)
NEARLY_ALL, MOST = 0.9, 0.5  # rates that claims are held to
JUST_LEFT = -1, 6  # cells from the runner's front to the wall: not all in it, and it is in view
FOLLOWED = 60  # steps of a video after the wall was touched
LONGEST = 300  # steps of an episode whose values are kept
AT_ONCE = 20  # levels whose states are held: 20 x 300 steps of 17 kB
PICTURES = 6


def find(work: Work) -> Findings:
    reached = at_wall(work.episodes)
    fates = (
        group_rates(reached, "fate", FATES, ["test", "who"])
        .select("test", "who", "fate", "mean", "low", "high", "agents", "levels", "rows")
        .sort(pl.col("test").cast(pl.Enum([*TESTS])), "who", maintain_order=True)
    )
    table = work.keep("values", lambda: values(work))
    ways, peaks = approach(table), peak(table)
    through, entered = (
        mean_of(reached.filter(test=ANYWHERE, who=RUNNER), pl.col("fate").is_in(which))
        for which in ([THROUGH], [THROUGH, INSIDE])
    )
    before = mean_of(peaks, pl.col("to_wall").is_between(*JUST_LEFT))
    at_peak = "unknown" if peaks.is_empty() else f"{peaks['step'].median():.0f}"
    # The first agent's episode with the median time to the wall, if there is any.
    mine = peaks.filter(pl.col("agent") == pl.col("agent").min()).sort("touched", "level")
    shown = [show(work, one) for one in mine.slice(len(mine) // 2, 1).to_dicts()]
    near = charts.curves(
        ways.with_columns(pl.col("cells") + 0.5), x="cells", shade=(0, COLUMNS),
        x_label="cells from the wall's face to the runner's front; shaded: the wall",
        label="the critic's value",
    )  # fmt: skip
    return Findings(
        answer=f"{rounded(through.mean)} of runners that reach the wall go through it, and "
        f"{rounded(entered.mean)} at least into it. The critic's value is highest just left of the "
        f"wall in {rounded(before.mean)} of these episodes.",
        claims=[
            above(
                "Whenever the runner reaches the wall, it goes through.",
                "100\u00a0%, n\u00a0=\u00a0114",
                "out on the other side",
                through,
                NEARLY_ALL,
                why=f"{rounded(entered.mean - through.mean)} are still in the wall, "
                f"{COLUMNS} columns wide, when the time is up",
            ),
            above(
                "It neither stays at the wall nor comes back to it.",
                "100\u00a0%, n\u00a0=\u00a0114",
                "in the wall or on the other side",
                entered,
                NEARLY_ALL,
            ),
            above(
                "The critic's value is highest just left of the wall, not in it or beyond.",
                "about step 35, one episode",
                f"there, with the wall in view, in the median at step {at_peak}",
                before,
                MOST,
            ),
        ],
        videos=[video for video, _ in shown],
        plots=[
            *[plot for _, plots in shown for plot in plots],
            Plot(
                "approach",
                "The critic's value by the distance to the wall's face, over all episodes that "
                "reach it, with 95\u00a0% intervals over agents and levels; in their first "
                f"{LONGEST} steps.",
                near,
                ways,
            ),
        ],
        tables=[
            Table("fates", "The fates of those who reached the wall", fates),
            *outcomes.outcome_tables(work),
        ],
        settings=outcomes.settings(work.plan)
        | {
            "episodes with values": f"all that touch the wall in their first {LONGEST} steps",
            "the wall": f"{COLUMNS} columns, which end in a step one cell high; who is out of the "
            "last column went through",
            "the paper and its code": "There one wall was two columns wide, a later one 15, and "
            "which was counted by hand is not recorded; nor where the coin was.",
        },
    )


def at_wall(episodes: pl.DataFrame) -> pl.DataFrame:
    """Return episodes that touched the wall, with fate and player.

    The column agent is the seed, as `group_means` needs it.
    """
    fate = (
        pl.when(pl.col("passed_wall").is_not_null())
        .then(pl.lit(THROUGH))
        .when(pl.col("died").is_not_null())
        .then(pl.lit(DIED))
        .when(pl.col("to_wall") < 0)
        .then(pl.lit(INSIDE))
        .otherwise(pl.lit(BEFORE))
    )
    return episodes.filter(pl.col("touched_wall").is_not_null()).select(
        "test",
        "level",
        who=pl.col("policy").replace(AGENTS, RUNNER),
        fate=fate,
        agent=pl.col("seed").fill_null(-1),
    )


def values(work: Work) -> pl.DataFrame:
    """Return the critic's value in every step of the agents' episodes with the coin anywhere.

    Columns: agent (seed), level, step, value, to_wall (cells), touched (step). Only the first
    LONGEST steps of episodes that touch the wall are included.
    """
    test, parts = work.plan.tests[ANYWHERE], []
    levels = levels_of(work.plan, test)
    for run in work.runs[RUNNER]:
        agent, config = open_run(run)
        limited = replace(test, knobs={**test.knobs, "time_limit": LONGEST})
        variant = limited.variant_for(work.plan.config)
        for first in range(0, len(levels), AT_ONCE):
            rows, states = visit(
                agent,
                variant,
                levels[first : first + AT_ONCE],
                measures={"to_wall": measures.to_wall},
            )
            touched = pl.Series(states["touched_wall"]).replace(-1, None)
            rows = rows.with_columns(touched=touched).with_columns(
                touched=pl.col("touched").max().over("level")
            )
            parts.append(
                rows.drop_nulls("touched").select(
                    pl.lit(config.seed).alias("agent"),
                    "level",
                    "step",
                    "value",
                    "to_wall",
                    "touched",
                )
            )
    return pl.concat(parts)


def peak(table: pl.DataFrame) -> pl.DataFrame:
    """Return the step with the highest value in each episode of `values`."""
    highest = pl.col("value") == pl.col("value").max().over("agent", "level")
    return table.filter(highest).unique(("agent", "level"), keep="first").sort("agent", "level")


def approach(table: pl.DataFrame) -> pl.DataFrame:
    """Return the mean value in each cell before the wall (negative) and in it."""
    near = table.with_columns(cells=(-pl.col("to_wall")).floor()).filter(
        pl.col("cells").is_between(-COLUMNS, COLUMNS)
    )
    return group_means(near, "value", ["cells"])


def show(work: Work, typical: dict[str, Any]) -> tuple[Video, list[Plot]]:
    """Return a video of one episode with the critic's value, and its curve with pictures."""
    run = next(run for run in work.runs[RUNNER] if open_run(run)[1].seed == typical["agent"])
    player, config = open_run(run)
    variant = work.plan.tests[ANYWHERE].variant_for(work.plan.config)
    episode = video.play(
        player,
        config.game,
        variant,
        typical["level"],
        pixels=288,
        longest=typical["touched"] + FOLLOWED,
    )
    value = policy_and_value(player, episode.observations)[1]
    path = work.folder / "videos" / "wall.mp4"
    texts = [f"step {k}, value {v:z.2f}" for k, v in enumerate(value)]
    frames = video.beside(episode.frames, captions=[texts.__getitem__])
    video.write(frames, path, fps=8)
    data = pl.DataFrame(
        {"step": np.arange(len(value)), "value": value, "to_wall": measures.to_wall(episode.states)}
    )
    drawn = moments(data)
    inside = data.filter(pl.col("to_wall") < 0)["step"]
    shade = (inside[0], len(data) - 1) if len(inside) else None
    about = (
        f"level {typical['level']}, in which the first agent takes the median time to the wall "
        f"of those in which it reaches it"
    )
    return (
        Video(f"A typical episode: {about}, with the critic's value.", path),
        [
            Plot(
                "episode",
                f"The critic's value in a typical episode: {about}. Shaded: the runner is in the "
                "wall, or was.",
                charts.curves(
                    data.rename({"value": "mean"}),
                    x="step",
                    x_label="step",
                    label="the critic's value",
                    shade=shade,
                ),
                data,
            ),
            Plot(
                "episode-steps",
                "Steps of that episode.",
                images(
                    [
                        [Picture(texts[k], episode.frames[k]) for k in drawn[i : i + 3]]
                        for i in range(0, len(drawn), 3)
                    ]
                ),
                data[drawn],
            ),
        ],
    )


def moments(data: pl.DataFrame) -> list[int]:
    """Return the steps to picture: evenly spaced ones, with the nearest replaced by the peak."""
    steps = np.linspace(0, len(data) - 1, PICTURES).astype(int)
    highest = int(data["value"].arg_max() or 0)
    steps[np.abs(steps - highest).argmin()] = highest
    return steps.tolist()


EXPERIMENT = Experiment(
    title="The permeable wall",
    reproduces="Figure 7",
    question="Do actor and critic pursue the same? A wall that lets pass tells moving right from "
    "moving to the wall.",
    sizes=_agents.plans(
        {"smoke": 200, "pixels": 200, "night": 200, "hour": 300, "paper": 1000, "published": 150},
        tests=TESTS,
        measures={"to_wall": measures.to_wall},
        brief=LONGEST,
    ),
    find=find,
)
