"""One video of an agent, for its card and for trackers."""

from __future__ import annotations

from pathlib import Path

import polars as pl

from astray.analysis import video
from astray.analysis.trained import Agent
from astray.game import Shift
from astray.training.config import Config

SIDE, LONGEST = 224, 100  # pixels, steps


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
    variants = (config.variant, between.test)
    shown = [
        video.play(
            agent,
            config.find_game(),
            config.variant_for(variant),
            level,
            pixels=SIDE,
            longest=LONGEST,
        ).frames
        for variant in variants
    ]
    captions = [f"{variant} {level}" for variant in variants]
    video.write_gif(video.beside(*shown, captions=captions), path, fps=8)
