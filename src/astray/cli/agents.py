"""Verbs for agents: train, evaluate, record, assess them."""

from __future__ import annotations

import io
import json
import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import polars as pl
from rich.table import Column, Table
from tyro.conf import Positional, arg

from astray import imports
from astray.analysis.tables import SIGN, write_table
from astray.cli.arguments import (
    NUMBERS,
    Agent,
    Json,
    Longest,
    OwnPolicy,
    PlayedLevel,
    Player,
    Preset,
    Rewards,
    Settings,
    Shift,
    Tested,
    TestedPlayer,
    level_numbers,
    pairs,
    print_json,
    show,
)
from astray.cli.settings import Grouped, ungrouped
from astray.envs.pictures import PICTURES
from astray.estimate import Estimate
from astray.files import check_free, check_writable, files_aside, write_aside
from astray.training.config import Tracking
from astray.training.folders import PRETRAINED
from astray.training.settings import SEEDS, otherwise
from astray.validation import MOST, bounded

if TYPE_CHECKING:
    import numpy as np

    from astray.analysis.agency import Assessment

SOME = 300  # levels of `agency`, by default
SUMMARY, MARK, EPISODES = "agency.json", b'"explanations"', "episodes.parquet"
POSTERIOR = ("posterior.mp4", "posterior.gif", "posterior.png")


def train(
    settings: Grouped,
    preset: Preset = "small",
    knobs: Settings = (),
    seeds: int = 1,
    out: Annotated[Path | None, otherwise("runs/<game>-<variant>")] = None,
    track: Annotated[Tracking | None, otherwise("none")] = None,
) -> None:
    """Train agents, or resume their trainings.

    Example: astray train maze corner-small --validation anywhere-small --out runs/mice

    Args:
        preset: Preset that gives the other settings their defaults.
        seeds: Number of agents to train one after another, with consecutive seeds.
        out: Folder for the run folders seed-0, seed-1, ...
        track: Tracker of the training's metrics and, at its end, of the agent's behaviour.
    """
    from dataclasses import replace

    from astray.experiments.sweep.settings import changed
    from astray.experiments.track import track_outcomes
    from astray.training import checkpoint, parallel
    from astray.training.track import train_tracked

    config = changed(ungrouped(settings), pairs(knobs))
    bounded("seeds", seeds, 1, SEEDS - config.seed)
    there = out or Path("runs") / f"{config.game}-{config.variant}"
    chosen = range(config.seed, config.seed + seeds)
    runs = {there / f"seed-{seed}": replace(config, seed=seed) for seed in chosen}
    checkpoint.check_all(runs)
    for run, one in runs.items():
        last = train_tracked(one, run, track)
        if parallel.first():
            if track:
                track_outcomes(run, track)
            print(last)


def evaluate(
    agents: Positional[
        Annotated[
            tuple[Path, ...],
            otherwise(
                "none",
                "Run folders, checkpoints in them, or names of pretrained or imported agents.",
            ),
        ]
    ] = (),
    tested: Annotated[Tested, arg(name="")] = Tested(),
    levels: Annotated[
        str | None,
        otherwise(
            "the first 1,000 that no training draws from",
            "Level numbers and ranges, such as 5,17,100:200, or a file or folder of levels in "
            "the format that `astray level` prints.",
        ),
    ] = None,
    unsolvable: bool = False,
    policy: OwnPolicy = OwnPolicy(),
    batch: int = 256,
    longest: Longest = None,
    pool: bool = False,
    rewards: Rewards = (),
    out: Annotated[Path | None, otherwise("none")] = None,
    json: Json = False,
) -> None:
    """Play agents in given levels, and report which goal they reached first.

    Example: astray evaluate maze-corner --levels 200000:201000

    Args:
        unsolvable: Accept levels from files whose objects cannot be reached.
        batch: Number of episodes to play in parallel; results do not depend on it.
        pool: Treat all agents as one kind, in a single row; otherwise each agent has a row.
        out: Parquet file to write, with a row per episode; --rewards are columns.

    Raises:
        ValueError: If options do not go together.
    """
    from astray.analysis.runs import evaluate_policies, evaluate_runs, shift_of

    bounded("batch", batch, 1, MOST)
    played = None
    if levels is not None:
        # os.path: many numbers are too long for the name of a file, and pathlib says so
        played = Path(levels) if os.path.exists(levels) else level_numbers(levels)
    if (unsolvable and not isinstance(played, Path)) or (pool and policy.policy is not None):
        raise ValueError("--unsolvable goes with --levels FILE, and --pool with agents")
    if out:
        if out.suffix != ".parquet":  # nor what is played, as an agent's weights
            raise ValueError(f"a table of episodes is a .parquet file, not {out}")
        check_free(out.parent, out.name, SIGN, ())
        check_writable(out)
    own = imports.find_each(rewards)
    how: dict[str, Any] = dict(batch=batch, solvable=not unsolvable, longest=longest, rewards=own)
    player, rules, config = policy.open(agents, tested.acting, {"--shift": tested.shift})
    tested.acting.check_seen(player)
    if config is None:
        shift = shift_of(None, rules) if tested.shift is None else tested.shift
        test: Any = {"shift": shift, "levels": played, "variant": tested.variant}
        result = evaluate_policies([player], rules, **test, knobs=pairs(tested.knobs), **how)
    else:
        result = evaluate_runs(agents, played, pool=pool, **tested.words(), **how)
    if out:
        write_table(result.episodes, out)
    if json:
        print_json(result.rates.to_dicts())
    else:
        show_rates(result.rates)
        show_amounts(result.episodes, [*rules.measures, *own])
        print(result.verdict)


def keep(
    agent: Agent,
    name: Annotated[str, arg(name="as", help="Name that other verbs find the agent by.")],
    shift: Shift = None,
    out: Annotated[Path | None, otherwise("astray's own, where verbs look for names")] = None,
) -> None:
    """Give a trained agent a name that all verbs accept, and a card about its goals.

    Example: astray keep runs/mice/seed-0 --as my-mouse

    Args:
        out: Folder for a copy of the agent's run folder.
    """
    from astray.experiments.keep import keep as write

    print(write(agent, name, shift=shift, folder=out or PRETRAINED))


def record(
    played: Annotated[Player, arg(name="")] = Player(),
    level: PlayedLevel = PlayedLevel(),
    pixels: int = 512,
    longest: Longest = None,
    out: Path = Path("episode.mp4"),
) -> None:
    """Record a video of an agent in one level; by default in level 1000000.

    Example: astray record maze-corner --variant anywhere-small --level 200003

    Args:
        pixels: Width and height of the video in pixels.
        out: Video file to write, .mp4 or .gif.

    Raises:
        ValueError: If `out` is of another kind, or options do not go together.
    """
    from astray.analysis import video

    write = {".mp4": video.write_mp4, ".gif": video.write_gif}.get(out.suffix)
    if write is None:
        raise ValueError(f"a video is an .mp4 or a .gif file, not {out}")
    bounded("pixels", pixels, *PICTURES)
    check_free(out.parent, out.name, video.SIGN.encode(), ())
    check_writable(out)
    player, rules, made, _ = played.open()
    begun = level.begun(rules, made)
    if begun is None:
        begun = 1_000_000
    episode = video.play(player, rules, made, begun, pixels=pixels, longest=longest)
    write(episode.frames, out)
    print(out)


def agency(
    player: Annotated[TestedPlayer, arg(name="")] = TestedPlayer(),
    levels: Annotated[
        str | None, otherwise("the first 300 that the training does not draw from", NUMBERS)
    ] = None,
    measure: Literal["paper", "calibrated"] = "calibrated",
    longest: Longest = None,
    out: Annotated[Path | None, otherwise("none")] = None,
    json: Json = False,
) -> None:
    """Measure whether a policy in mazes is goal-directed, and towards which goal.

    Example: astray agency maze-corner --levels 200000:200050

    Args:
        measure: Measure of goal-directedness: calibrated, or exactly the paper's, which calls most
            policies agents.
        out: Folder for agency.json, episodes.parquet, and posterior.mp4, .gif and .png of the
            episode with the most steps that distinguish the goals.
    """
    from astray.analysis.agency import assess_policy

    if out:
        check_free(out, SUMMARY, MARK, (EPISODES, *POSTERIOR))
        check_writable(out / SUMMARY)
    policy, rules, _, variant, shift, config = player.open()
    unseen = config.unseen_levels if config else range(SOME)
    chosen = unseen[:SOME] if levels is None else level_numbers(levels)
    assessed, recorded = assess_policy(policy, rules, variant, shift, chosen, measure, longest)
    if out:
        _write_assessment(assessed, recorded, out)
    if json:
        print_json(assessed.summary())
        return
    table = Table("explanation", "of episodes")
    for name, rate in zip(assessed.explanations, assessed.rates, strict=True):
        table.add_row(name, rate.short())
    show(table)
    print(assessed.sentence())


def _write_assessment(
    assessed: Assessment, recorded: Callable[[], np.ndarray], folder: Path
) -> None:
    from PIL import Image

    from astray.analysis import video
    from astray.world import Failed, Silent

    with files_aside(folder, SUMMARY, MARK) as aside:
        write_aside(aside / SUMMARY, json.dumps(assessed.summary()).encode())
        write_table(assessed.episodes, aside / EPISODES)
        movie, _, last = (aside / name for name in POSTERIOR)
        try:
            frames = recorded()
        except (Failed, Silent) as error:
            warnings.warn(f"there is no video: {error}", stacklevel=2)
            for name in POSTERIOR:  # of another assessment
                (folder / name).unlink(missing_ok=True)
            return
        video.write(frames, movie, fps=4)
        picture = io.BytesIO()
        Image.fromarray(frames[-1]).save(picture, "PNG")
        write_aside(last, picture.getvalue())


def show_amounts(episodes: pl.DataFrame, columns: Sequence[str]) -> None:
    """Print the means of measures and returns as a table, if there are any: a row per policy."""
    from astray.analysis.outcomes import amounts

    if not columns:
        return
    shown, told = Table(_policy(), *columns, title="mean of all levels"), []
    for name in columns:
        lost = episodes.filter(~pl.col(name).cast(pl.Float64).is_finite()).select("level", name)
        told += [
            f"{name} is {x} in level {k}, so its mean is not finite" for k, x in lost.rows()[:1]
        ]
    shown.caption = "; ".join(told)
    found = amounts(episodes, columns)
    for rows in found.partition_by("policy", maintain_order=True):
        shown.add_row(rows["policy"][0], *(Estimate.of(row).short(3) for row in rows.to_dicts()))
    show(shown, width=120)


def show_rates(rates: pl.DataFrame) -> None:
    """Print `outcomes.rates` as a table: a row per policy, a column per outcome, 95 % intervals."""
    outcomes = rates["outcome"].unique(maintain_order=True).to_list()
    shown = Table(
        _policy(), "agents", "levels", *outcomes,
        title=rates["variant"][0],
        caption="95 % intervals over agents and levels; for one agent, over levels alone",
    )  # fmt: skip
    for rows in rates.partition_by("policy", "levels_played", maintain_order=True):
        first = rows.row(0, named=True)
        levels = f"{first['levels']} {first['levels_played']}"
        told = [Estimate.of(row).short() for row in rows.to_dicts()]
        shown.add_row(first["policy"], f"{first['agents']}", levels, *told)
    show(shown, width=126)


def _policy() -> Column:
    """Return a column of names, which are paths that may differ in their last letter alone."""
    return Column("policy", overflow="fold")
