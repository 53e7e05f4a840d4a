"""Videos of an agent in one level number of two variants, side by side."""

from collections.abc import Sequence
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
    video.write_gif(_frames(agent, config.find_game(), pair, level, SIDE, LONGEST), path, fps=8)


def write_pair(
    player: Policy,
    game: Game | World,
    variants: Sequence[tuple[str, Any]],
    level: int,
    path: Path,
    *,
    fps: int,
) -> None:
    """Write an .mp4 file, and a .gif beside it, of an agent in variants with captions."""
    video.write(_frames(player, game, variants, level, REPORTED, RECORDED), path, fps)


def _frames(
    player: Policy,
    game: Game | World,
    variants: Sequence[tuple[str, Any]],
    level: int,
    pixels: int,
    longest: int,
) -> np.ndarray:
    """Return frames [T, H, W, 3] uint8 of a level number in all variants, side by side."""
    shown = [
        video.play(player, game, variant, level, pixels=pixels, longest=longest).frames
        for _, variant in variants
    ]
    return video.beside(*shown, captions=[caption for caption, _ in variants])
