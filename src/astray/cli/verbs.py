"""The verbs of the command line, and how they are read from it."""

from __future__ import annotations

import argparse
import functools
import sys
from importlib.metadata import version

import tyro

from astray.cli import (
    agents,
    art,
    cache,
    dataset,
    distil,
    experiments,
    hub,
    insight,
    lab,
    levels,
    published,
    sweep,
)  # fmt: skip
from astray.training.config import PRESETS

VERBS = {
    "list": experiments.list_,
    "play": levels.play,
    "lab": lab.lab,
    "train": agents.train,
    "distil": distil.distil,
    "evaluate": agents.evaluate,
    "reproduce": experiments.reproduce,
    "sweep": sweep.sweep,
    "keep": agents.keep,
    "push": hub.push,
    "pull": hub.pull,
    "record": agents.record,
    "export": dataset.export,
    "level": levels.level,
    "replay": levels.replay,
    "overlap": levels.overlap,
    "agency": agents.agency,
    "explain": insight.explain,
    "art": art.art,
    "cache": cache.cache,
    "import": published.import_,
    "agents": published.agents,
    "bench": experiments.bench,
}


def run() -> None:
    """Do what the command line says."""
    if sys.argv[1:] == ["--version"]:
        print(version("astray"))
        return
    # The preset gives the other settings their defaults, so it is read before them.
    first = argparse.ArgumentParser(add_help=False, allow_abbrev=False, exit_on_error=False)
    first.add_argument("--preset", nargs="?")
    preset = first.parse_known_args()[0].preset
    defaults = PRESETS.get(preset, PRESETS["small"])  # tyro refuses an unknown one
    verbs = VERBS | {
        "train": functools.partial(agents.train, config=defaults),
        "sweep": functools.partial(sweep.sweep, config=defaults),
    }
    tyro.extras.subcommand_cli_from_dict(
        verbs, prog="astray", description="Find out which goal a trained agent really pursues."
    )
