"""Verbs for agents: train, evaluate, film, judge them."""

from __future__ import annotations

import io
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import polars as pl
from rich.table import Table
from tyro.conf import Positional, arg

from astray import games, imports
from astray.analysis.kept import KEPT
from astray.analysis.tables import write_table
from astray.bounds import MOST, bounded, of_kind
from astray.cli.arguments import (
    Knobs,
    Mode,
    chosen,
    level_numbers,
    one_level,
    pairs,
    print_json,
    see_of_policy,
    show,
)
from astray.envs.vector import PICTURES
from astray.files import see_free, see_writable, write_aside
from astray.game import OWN, Game
from astray.training.config import Config, Tracking
from astray.training.settings import SEEDS
from astray.world import World

if TYPE_CHECKING:
    import numpy as np

    from astray.analysis.agency import Judgement

SUMMARY, EPISODES = "agency.json", "episodes.parquet"
POSTERIOR = ("posterior.mp4", "posterior.gif", "posterior.png")
Preset = Literal["paper", "night", "small", "pixels"]


def train(
    config: Annotated[Config, arg(name="")],
    preset: Preset = "small",
    knobs: Knobs = (),
    seeds: int = 1,
    folder: Path | None = None,
    track: Tracking | None = None,
) -> None:
    """Train agents, or go on where they stopped.

    Args:
        preset: whose settings are the defaults of all others
        knobs: of the variant, changed
        seeds: agents to train one after the other, with this seed, the next, ...
        folder: of the runs; by default runs/<game>-<variant>
        track: tell wandb or trackio, too, of the training, and at its end of what the agent does
    """
    from dataclasses import replace

    from astray.experiments.track import track_outcomes
    from astray.training import parallel
    from astray.training.track import train_tracked

    bounded("seeds", seeds, 1, SEEDS - config.seed)
    changed = replace(config, knobs=pairs(knobs))
    there = folder or Path("runs") / f"{config.game}-{config.variant}"
    for seed in range(config.seed, config.seed + seeds):
        run = there / f"seed-{seed}"
        last = train_tracked(replace(changed, seed=seed), run, track)
        if parallel.first():
            if track:
                track_outcomes(run, track)
            print(last)


def evaluate(
    runs: Positional[tuple[Path, ...]] = (),
    agent: str | None = None,
    policy: str | None = None,
    game: str | None = None,
    world: str | None = None,
    observation: Literal["image", "symbolic"] | None = None,
    variant: str | None = None,
    shift: str | None = None,
    levels: str | None = None,
    unsolvable: bool = False,
    mode: Mode = "sampled",
    art: str | None = None,
    knobs: Knobs = (),
    batch: int = 256,
    longest: int | None = None,
    out: Path | None = None,
    json: bool = False,
) -> None:
    """Play agents on explicit levels and say which goal they pursued.

    Args:
        runs: run folders, or checkpoints in them, or names as `astray list` has them; several
            agents of one kind
        agent: instead, the name of a kept or imported one
        policy: instead, a function of your own, module:function, of observations [N, ...] that
            returns actions [N]; needs --shift, and --game or --world
        game: that the policy plays
        world: instead of a game, a World of your own that the policy plays, module:WORLD
        observation: that the policy is shown; by default images
        variant: of the levels; by default the shift's test variant
        shift: which goals are intended and proxies; by default the one that the run trained for
        levels: numbers and ranges, as 5,17,100:200, or a file or folder of levels as
            `astray level` prints them; by default the first 1,000 numbers that no run's training
            draws from
        unsolvable: let levels from files have objects that cannot be reached
        mode: draw from the agent's policy, or take the likeliest action
        art: that images are drawn with, own or original; by default what it was trained on
        knobs: of the variant, changed
        batch: episodes at once; the rows do not depend on it
        longest: steps after which an episode is left; needed where episodes may last for ever
        out: a Parquet file for the episodes, a row each
        json: print JSON
    """
    from astray.analysis.adapters import Function
    from astray.analysis.runs import evaluate_policies, evaluate_runs, open_run

    bounded("batch", batch, 1, MOST)
    played = None
    if levels:
        # os.path: many numbers are too long for the name of a file, and pathlib says so
        played = Path(levels) if os.path.exists(levels) else level_numbers(levels)
    if out:
        see_writable(out)
    if policy is None:
        see_of_policy(game, observation, world)
        folders = chosen(runs, agent)
        rules = open_run(folders[0])[1].find_game()
        shares, episodes = evaluate_runs(
            folders,
            played,
            variant=variant,
            shift=shift,
            mode=mode,
            art=art,
            knobs=pairs(knobs),
            batch=batch,
            solvable=not unsolvable,
            longest=longest,
        )
    elif runs or agent or (game is None) == (world is None) or shift is None:
        raise ValueError(
            "--policy needs --shift, and --game or --world, and neither runs nor --agent"
        )
    elif mode != "sampled":
        raise ValueError(f"a policy of your own chooses by itself; it has no mode {mode!r}")
    else:
        own = Function(imports.find(policy), policy, observation or "image", art or OWN)
        rules = games.find(game) if game else imports.find(world or "")
        of_kind("--world", rules, Game | World)
        shares, episodes = evaluate_policies(
            [own],
            rules,
            shift,
            played,
            variant=variant,
            knobs=pairs(knobs),
            batch=batch,
            solvable=not unsolvable,
            longest=longest,
        )
    if out:
        write_table(episodes, out)
    if json:
        print_json(shares.to_dicts())
    else:
        show_shares(shares)
        show_amounts(episodes, rules)


def keep(
    run: Positional[Path],
    name: Annotated[str, arg(name="as")],
    shift: str | None = None,
    folder: Path | None = None,
) -> None:
    """Keep a trained agent by a name, with a card that tells what it pursues.

    Args:
        run: a run folder or a checkpoint in it
        name: by which --agent finds it
        shift: which goals are intended and proxies; by default the one that the run trained for
        folder: to keep it in, as a run folder; by default astray's, where --agent finds it
    """
    from astray.experiments.keep import keep as write

    print(write(run, name, shift=shift, folder=folder or KEPT))


def record(
    run: Positional[Path | None] = None,
    agent: str | None = None,
    variant: str | None = None,
    level: int | None = None,
    level_file: Path | None = None,
    unsolvable: bool = False,
    mode: Mode = "sampled",
    art: str | None = None,
    knobs: Knobs = (),
    pixels: int = 512,
    longest: int | None = None,
    out: Path = Path("episode.mp4"),
) -> None:
    """Film an agent in one level.

    Args:
        run: a run folder or a checkpoint in it, or a name as `astray list` has them
        agent: instead, the name of a kept or imported one
        variant: of the level; by default that of the training
        level: its number; by default 1000000
        level_file: the level instead; `astray level` prints such
        unsolvable: let it have objects that cannot be reached
        mode: draw from the agent's policy, or take the likeliest action
        art: that images are drawn with, own or original; by default what it was trained on
        knobs: of the variant, changed
        pixels: a side of the picture
        longest: steps after which the episode is left; needed where it may last for ever
        out: an .mp4 or .gif file
    """
    from astray.analysis import video
    from astray.analysis.runs import open_run

    write = {".mp4": video.write_mp4, ".gif": video.write_gif}.get(out.suffix)
    if write is None:
        raise ValueError(f"a video is an .mp4 or a .gif file, not {out}")
    bounded("pixels", pixels, *PICTURES)
    see_writable(out)
    player, config = open_run(chosen((run,) if run else (), agent)[0], mode, art)
    made = config.variant_for(variant or config.variant, pairs(knobs))
    begun = one_level(config.find_game(), made, level, level_file, unsolvable)
    if begun is None:
        begun = 1_000_000
    episode = video.play(player, config.game, made, begun, pixels=pixels, longest=longest)
    write(episode.frames, out)
    print(out)


def agency(
    run: Positional[Path | None] = None,
    agent: str | None = None,
    variant: str | None = None,
    shift: str | None = None,
    levels: str | None = None,
    measure: Literal["paper", "calibrated"] = "calibrated",
    mode: Mode = "sampled",
    art: str | None = None,
    knobs: Knobs = (),
    out: Path | None = None,
    json: bool = False,
) -> None:
    """Say whether a trained agent of mazes is goal-directed at all, and towards what.

    Args:
        run: a run folder or a checkpoint in it, or a name as `astray list` has them
        agent: instead, the name of a kept or imported one
        variant: of the levels; by default the shift's test variant
        shift: which goals are intended and proxies; by default the one that the run trained for
        levels: numbers and ranges, as 5,17,100:200; by default the first 300 that the training
            does not draw from
        measure: calibrated, or the paper's to the letter, which calls most policies agents
        mode: draw from the agent's policy, or take the likeliest action
        art: that images are drawn with, own or original; by default what it was trained on
        knobs: of the variant, changed
        out: a folder for agency.json and episodes.parquet, and for posterior.mp4, .gif and .png of
            the episode in which most steps tell the goals apart
        json: print JSON
    """
    from astray.analysis.agency import judge_run

    if out:
        see_free(out, SUMMARY, b'"explanations"', (EPISODES, *POSTERIOR))
        for name in (SUMMARY, EPISODES, *POSTERIOR):
            see_writable(out / name)
    judged, filmed = judge_run(
        chosen((run,) if run else (), agent)[0],
        level_numbers(levels) if levels else None,
        variant=variant,
        shift=shift,
        measure=measure,
        mode=mode,
        art=art,
        knobs=pairs(knobs),
    )
    if out:
        _write_judgement(judged, filmed(), out)
    if json:
        print_json(judged.summary())
        return
    table = Table("explanation", "of episodes")
    for name, share in zip(judged.explanations, judged.shares, strict=True):
        table.add_row(name, f"{share.mean:.1%} [{share.low:.1%}, {share.high:.1%}]")
    show(table)
    print(judged.sentence())


def _write_judgement(judged: Judgement, frames: np.ndarray, folder: Path) -> None:
    from PIL import Image

    from astray.analysis import video

    folder.mkdir(parents=True, exist_ok=True)
    write_aside(folder / SUMMARY, json.dumps(judged.summary()).encode())
    film, loop, last = (folder / name for name in POSTERIOR)
    video.write_mp4(frames, film, fps=4)
    video.write_gif(frames, loop, fps=4)
    picture = io.BytesIO()
    Image.fromarray(frames[-1]).save(picture, "PNG")
    write_aside(last, picture.getvalue())
    write_table(judged.episodes, folder / EPISODES)


def show_amounts(episodes: pl.DataFrame, game: Game | World) -> None:
    """The means of a game's measures as a table, where it has any: a row a policy."""
    from astray.analysis.outcomes import amounts

    if not game.measures:
        return
    shown = Table("policy", *game.measures, title="mean of all levels")
    found = amounts(episodes, [*game.measures])
    for rows in found.partition_by("policy", maintain_order=True):
        told = [f"{r['mean']:.3g} [{r['low']:.3g}, {r['high']:.3g}]" for r in rows.to_dicts()]
        shown.add_row(rows["policy"][0], *told)
    show(shown, width=120)


def show_shares(shares: pl.DataFrame) -> None:
    """`outcomes.shares` as a table: a row a policy, a column an outcome, with 95 % intervals."""
    outcomes = shares["outcome"].unique(maintain_order=True).to_list()
    shown = Table("policy", "agents", "levels", *outcomes, title=shares["variant"][0])
    for rows in shares.partition_by("policy", "levels_played", maintain_order=True):
        first = rows.row(0, named=True)
        levels = f"{first['levels']} {first['levels_played']}"
        told = [f"{r['mean']:.1%} [{r['low']:.1%}, {r['high']:.1%}]" for r in rows.to_dicts()]
        shown.add_row(first["policy"], f"{first['agents']}", levels, *told)
    show(shown, width=120)
