"""The verb for sweeps: agents for every combination of settings."""

import sys
from pathlib import Path
from typing import Annotated

from tyro.conf import UseAppendAction, arg

from astray.cli.arguments import Longest, Preset, Shift, Workers
from astray.cli.settings import Grouped, ungrouped
from astray.experiments.spec import Place
from astray.training.config import Tracking
from astray.training.settings import otherwise
from astray.validation import bounded, command_of

Axes = UseAppendAction[
    Annotated[
        tuple[str, ...],
        arg(
            name="set",
            metavar="NAME=VALUE,...",
            help="Train with each value of a knob of the variant or a setting.",
        ),
    ]
]
MOST_LEVELS = 10**6  # that each agent is evaluated on


def sweep(
    settings: Grouped,
    preset: Preset = "small",
    axes: Axes = (),
    seeds: int = 1,
    test_levels: Annotated[int, arg(name="num_test_levels")] = 1000,
    shift: Shift = None,
    longest: Longest = None,
    out: Annotated[Path | None, otherwise("sweeps/<game>-<variant>")] = None,
    workers: Workers = None,
    on: Place = "here",
    track: Annotated[Tracking | None, otherwise("none")] = None,
) -> None:
    """Train agents for every combination of settings, and report which goals they pursue.

    The same command resumes an interrupted sweep; more values or seeds extend it. Finished
    trainings are kept.

    Example: astray sweep maze corner-small --set lr=1e-4,5e-4 --set largest=5,7 --seeds 3

    Args:
        preset: Preset that gives the other settings their defaults.
        seeds: Number of agents per combination, with consecutive seeds.
        test_levels: Number of levels to evaluate each agent on: the first ones that its training
            does not draw from.
        out: Folder for the runs and their outcomes.
        on: Place of the trainings: this machine, or a Ray cluster whose nodes share the folder.
        track: Tracker of the trainings' metrics.
    """
    from astray.experiments.sweep.run import run_sweep
    from astray.experiments.sweep.settings import Sweep
    from astray.experiments.sweep.settings import axes as read_axes

    bounded("num_test_levels", test_levels, 1, MOST_LEVELS)
    config = ungrouped(settings)
    there = out or Path("sweeps") / f"{config.game}-{config.variant}"
    as_text = getattr(config.training_variant(), "texts", ())  # of a World
    wanted = Sweep(config, read_axes(axes, as_text), seeds, test_levels, shift, longest)
    command = command_of("astray", *sys.argv[1:])  # a World's name alone would not find it
    print(run_sweep(wanted, there, workers=workers, on=on, track=track, command=command))
