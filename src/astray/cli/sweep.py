"""The verb for sweeps: agents of every combination of some settings."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from tyro.conf import UseAppendAction, arg

from astray.bounds import bounded
from astray.experiments.spec import Place
from astray.training.config import Config, Tracking

MOST_WORKERS = 1024  # processes
Preset = Literal["paper", "night", "small", "pixels"]
Sets = UseAppendAction[Annotated[tuple[str, ...], arg(name="set", metavar="NAME=VALUE,...")]]

MOST_LEVELS = 10**6  # that each agent is evaluated on


def sweep(
    config: Annotated[Config, arg(name="")],
    preset: Preset = "small",
    axes: Sets = (),
    seeds: int = 1,
    test_levels: int = 1000,
    shift: str | None = None,
    folder: Path | None = None,
    workers: int | None = None,
    on: Place = "here",
    track: Tracking | None = None,
) -> None:
    """Train agents of every combination of some settings, and show what they pursue.

    What is done already is not done again: the same command goes on where it stopped, and one with
    more values or seeds adds to what is there.

    Args:
        preset: whose settings are the defaults of all others
        axes: a setting and its values, as lr=1e-4,5e-4, or a knob of the variant, as
            variant.region=1,3,5; given once for each
        seeds: agents of each combination, with this seed, the next, ...
        test_levels: that each agent is evaluated on, the first that its training does not draw from
        shift: which goals are intended and proxies; by default the one that the training is for
        folder: of runs and outcomes; by default sweeps/<game>-<variant>
        workers: agents trained at once here; by default one for each processor
        on: train on this machine, or on a Ray cluster whose nodes all see the folder
        track: tell wandb or trackio, too, how trainings go
    """
    from astray.experiments.sweep.run import run_sweep
    from astray.experiments.sweep.settings import Sweep
    from astray.experiments.sweep.settings import axes as read_axes

    bounded("test_levels", test_levels, 1, MOST_LEVELS)
    if workers is not None:
        bounded("workers", workers, 1, MOST_WORKERS)
    there = folder or Path("sweeps") / f"{config.game}-{config.variant}"
    wanted = Sweep(config, read_axes(axes), seeds, test_levels, shift)
    print(run_sweep(wanted, there, workers=workers, on=on, track=track))
