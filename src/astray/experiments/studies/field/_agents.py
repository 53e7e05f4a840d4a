"""Agents of the field's worlds, which train in a minute or two."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from astray.training.config import PRESETS, Config

LEARNED = 0.8  # rate of the intended goal in training above which an agent has learned
OWN_WORLD = "world and rules are written anew and simpler; PPO with a network of two hidden layers"


def agent(game: str, variant: str, steps: int, **settings: Any) -> Config:
    """Return the settings of an agent that sees symbols, with many small updates."""
    return replace(
        PRESETS["small"],
        game=game,
        variant=variant,
        steps=steps,
        num_envs=64,
        minibatches=8,  # of 64 x 64 / 8 = 512 samples
        width=128,
        **settings,
    )
