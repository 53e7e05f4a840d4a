"""Videos of an agent in one level number of two variants, side by side."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import polars as pl

from astray.acting import Policy
from astray.analysis import video
from astray.analysis.trained import Agent
from astray.game import Game, Shift
from astray.training.config import Config
from astray.world import World

SIDE, LONGEST = 224, 100  # pixels and steps, of a card's video
REPORTED, RECORDED = 288, 120  # likewise, of a report's


def write_video(
    agent: Agent, config: Config, between: Shift, episodes: pl.DataFrame, path: Path
) -> None:
    """Record the agent in one level, in training and in the test of `episodes`.

    The level has the most common outcome, distinguishes the goals if any does, and is not short.
    """
    mine = episodes.drop_nulls("run")  # scripts are of no run
    apart = mine.filter("distinguishing")
    mine = apart if len(apart) else mine
    mine = mine.filter(outcome=mine["outcome"].mode().sort()[0])
    level = mine.filter(pl.col("length") >= pl.col("length").quantile(0.75))["level"][0]
    names = (config.variant, between.test)
    pair = [(f"{name} {level}", config.variant_for(name)) for name in names]
    frames, _ = _recorded(agent, config.find_game(), pair, level, SIDE, LONGEST)
    video.write_gif(frames, path, fps=8)


def write_pair(
    player: Policy,
    game: Game | World,
    variants: Sequence[tuple[str, Any]],
    level: int,
    path: Path,
    *,
    fps: int,
    told: Mapping[str, Any] | None = None,
    longest: int | None = None,
) -> str:
    """Write an .mp4 file, and a .gif beside it, of an agent in variants with captions.

    Args:
        told: Row of `evaluate` that the last variant's episode should repeat.
        longest: Steps after which episodes are truncated; None for no limit.

    Returns:
        A sentence if that episode is another one than the row's, or "".
    """
    most = min(longest or RECORDED, RECORDED)
    frames, last = _recorded(player, game, variants, level, REPORTED, most)
    video.write(frames, path, fps)
    return " Played again for this video, it did otherwise." * (
        told is not None and not repeats(last, told, most)
    )


def repeats(played: video.Episode, told: Mapping[str, Any], most: int) -> bool:
    """Return whether an episode is that of a row of `evaluate`, as far as its `most` steps show.

    It is not if a policy draws actions from a random state, as Stable-Baselines3's do, or if the
    level does not repeat.
    """
    first = {name: step for name in played.events if (step := told[name]) is not None}
    known = {name: step for name, step in played.events.items() if step is not None}
    seen = {name: step for name, step in first.items() if step <= most}
    return known == seen and len(played.rewards) == min(told["length"], most)


def _recorded(
    player: Policy,
    game: Game | World,
    variants: Sequence[tuple[str, Any]],
    level: int,
    pixels: int,
    longest: int,
) -> tuple[np.ndarray, video.Episode]:
    """Return frames [T, H, W, 3] uint8 of a level number in all variants, and the last episode."""
    captions, played = zip(*variants, strict=True)
    shown = [video.play(player, game, v, level, pixels=pixels, longest=longest) for v in played]
    return video.beside(*(one.frames for one in shown), captions=captions), shown[-1]
