"""Reports to trackers after a training or a report."""

from pathlib import Path

import numpy as np

from astray.acting import check_ending
from astray.analysis.outcomes import load_shift
from astray.analysis.runs import evaluate_runs, open_run, shift_of
from astray.experiments.videos import write_video
from astray.report.findings import Findings, Heading
from astray.training.config import Tracking
from astray.training.track import Tracker, label

LEVELS = 200  # that an agent is evaluated on for its tracker
VIDEO = "episode.gif"


def track_outcomes(run: Path, by: Tracking, levels: int = LEVELS) -> None:
    """Report the goals of a run's last agent to a tracker: a table and a video.

    Agents without a shift of their game, or with a test that may never end, are skipped.
    """
    agent, config = open_run(run)
    try:
        between = load_shift(config.find_game(), shift_of(config))
        check_ending(config.find_game(), config.variant_for(between.test), None)
    except ValueError:
        return
    numbers, steps = np.array(config.unseen_levels[:levels]), int(agent.path.parent.name)
    result = evaluate_runs([run], numbers, variant=between.test)
    write_video(agent, config, between, result.episodes, run / VIDEO)
    tracker = Tracker(by, label(config), run, config.to_json())
    tracker.video(steps, "video", run / VIDEO)
    tracker.table(steps, "outcomes", result.rates.columns, result.rates.rows())
    mine = result.rates.filter(policy=result.agents[0], levels_played="all")
    tracker.log(steps, {f"outcome/{row['outcome']}": row["mean"] for row in mine.to_dicts()})
    tracker.finish()


def track_report(heading: Heading, findings: Findings, folder: Path, by: Tracking) -> None:
    """Report a folder's report to a tracker: claims, tables, figures, videos."""
    settings = {"answer": findings.answer, **vars(heading), **findings.settings}
    tracker = Tracker(by, f"{heading.name}-{heading.size}", folder, settings)
    claims = [[one.sentence, one.paper, one.ours, one.supported] for one in findings.claims]
    tracker.table(0, "claims", ("claim", "paper", "ours", "supported"), claims)
    for table in findings.tables:
        tracker.table(0, f"tables/{table.name}", table.frame.columns, table.frame.rows())
    for plot in findings.plots:
        tracker.picture(0, f"figures/{plot.name}", folder / "figures" / f"{plot.name}.png")
    for video in findings.videos:
        tracker.video(0, f"videos/{video.path.stem}", video.path)
    tracker.finish()
