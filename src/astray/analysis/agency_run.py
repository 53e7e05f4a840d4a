"""A trained agent judged, and its goal inferred before one's eyes."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from astray.agency.gridworld import World
from astray.agency.measure import CALIBRATED, PRESETS, Options
from astray.agency.online import measure_online
from astray.analysis import video
from astray.analysis.agency import Judgement, Played, judge, play
from astray.analysis.outcomes import load_shift
from astray.analysis.policies import Policy
from astray.analysis.runs import Mode, open_run, shift_of
from astray.game import Game, Variant

LEAST, MOST = np.array([244, 243, 236]), np.array([196, 60, 20])  # of the posterior, on floor
STONE, MOUSE = np.array([204, 184, 142]), np.array([34, 34, 34])  # walls are sand, as in the game


def judge_run(
    run: Path,
    levels: Sequence[int] | np.ndarray | None = None,
    *,
    variant: str | None = None,
    shift: str | None = None,
    measure: str = "calibrated",
    mode: Mode = "sampled",
    art: str | None = None,
    knobs: dict[str, Any] | None = None,
) -> tuple[Judgement, Callable[[], np.ndarray]]:
    """Judge a trained agent; also a function that films its most telling episode.

    levels   numbers; None: the first 300 that the training does not draw from
    measure  of `PRESETS`
    art      that the agent is shown; None: what it was trained on
    """
    agent, config = open_run(run, mode, art)
    between = load_shift(config.find_game(), shift or shift_of(config))
    made = config.variant_for(variant or between.test, knobs)
    chosen = config.unseen_levels[:300] if levels is None else levels
    played = play(agent, config.game, made, chosen, between)
    judged = judge(played, PRESETS[measure])
    telling, options = played[judged.telling], PRESETS[measure]
    return judged, lambda: posterior_video(agent, config.game, made, telling, options)


def posterior_video(
    policy: Policy,
    game: str | Game,
    variant: Variant,
    played: Played,
    options: Options = CALIBRATED,
    pixels: int = 320,
) -> np.ndarray:
    """An episode beside the posterior over the cells it may be going to, [T + 1, H, W, 3] uint8.

    Ends where the measure ends, at the last goal that was reached.
    """
    steps = len(played.cells)
    frames = video.play(
        policy, game, variant, played.level, pixels=pixels, longest=max(1, steps - 1)
    ).frames[:steps]
    growth = measure_online(played.episode, replace(options, goals="accessible"))
    moved = [here != there for here, there in itertools.pairwise(played.cells)]
    counted = np.append(0, np.cumsum(moved))  # standing still is no step of a trajectory
    world = played.episode.world
    numbers = [world.number(cell) for cell in growth.goals if not isinstance(cell, str)]
    maps = []
    for t in range(steps):
        belief = np.zeros(len(world))
        belief[numbers] = growth.posterior[counted[t]]
        maps.append(heat(world, belief, world.number(played.cells[t]), pixels))

    def caption(t: int) -> str:
        return f"where to? agent: {100 * growth.agent[counted[t]]:.0f} %"

    level = f"level {played.level}"
    return video.beside(frames, np.stack(maps), captions=[level, caption])


def heat(world: World, belief: np.ndarray, here: int, pixels: int) -> np.ndarray:
    """`belief` [F] on the map, the likeliest cell the darkest, [pixels, pixels, 3] uint8."""
    image = np.broadcast_to(STONE, (*world.free.shape, 3)).astype(float)
    share = (belief / belief.max())[:, None]
    image[world.free] = LEAST + share * (MOST - LEAST)
    large = np.array(
        Image.fromarray(image.astype(np.uint8)).resize((pixels, pixels), Image.Resampling.NEAREST)
    )
    side = pixels / np.array(world.free.shape)
    y, x = np.mgrid[:pixels, :pixels] + 0.5
    row, column = world.cells[here] + 0.5
    large[np.hypot(y / side[0] - row, x / side[1] - column) < 0.22] = MOUSE
    return large
