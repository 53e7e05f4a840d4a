"""Verbs for lists, experiments and benchmarks."""

import os
import sys
import threading
from pathlib import Path
from typing import Annotated, Any, Literal

from rich.markup import escape
from rich.table import Table
from tyro.conf import Positional, arg

from astray import games
from astray.cli.arguments import MOST_WORKERS, Json, Workers, print_json, show
from astray.experiments import catalogue
from astray.experiments.spec import Place, Size
from astray.game import OWN, Game
from astray.training import folders
from astray.training.config import PRESETS, Device, Tracking
from astray.training.settings import otherwise
from astray.validation import bounded, brief, printable

Benchmark = Literal["environments", "train", "networks", "costs", "eyes", "agency", "insight",
                    "lab", "start", "worlds"]  # fmt: skip


def list_(json: Json = False) -> None:
    """List games, variants, shifts, experiments, pretrained and imported agents, and presets.

    Example: astray list
    """
    threads = threading.active_count()
    _print_list(json)
    if threading.active_count() > threads:  # a stranger's, for which Python would wait
        sys.stdout.flush()
        os._exit(0)


def _print_list(json: bool) -> None:
    described, broken = games.survey(_game)
    found = {
        "games": described | {name: {"error": reason} for name, reason in broken.items()},
        "experiments": {name: catalogue.title(name) for name in catalogue.NAMES},
        "agents": {name: _agent(name) for name in folders.names()},
        "presets": list(PRESETS),
    }
    if json:
        return print_json(found)
    for name, game in described.items():
        table = Table("variant", "levels", box=None, padding=(0, 2))
        for variant, about in game["variants"].items():
            table.add_row(_plain(variant), _plain(about))
        show(f"[bold]{_plain(name)}[/]: {_plain(game['about'])}", table)
        for shift, what in game["shifts"].items():
            goals = f"{', or '.join((what['intended'], *what['proxies']))}?"
            show(_plain(f"  shift {shift}: {what['train']} -> {what['test']}: {goals}"))
    for name, reason in broken.items():
        show(f"[bold]{_plain(name)}[/]: broken: {_plain(reason)}")
    show("[bold]experiments[/]")
    for name, title in found["experiments"].items():
        show(f"  {name}: {title}")
    show("[bold]agents[/]")
    for name, config in found["agents"].items():
        about = config.get("error") or f"{config['game']}, trained on {config['variant']}"
        show(_plain(f"  {name}: {about}"))


def _plain(text: str) -> str:
    """Return a stranger's text without markup or control characters, cut off if it is long."""
    return escape(printable(brief(text)))


def _game(game: Game) -> dict[str, Any]:
    return {
        "about": game.about,
        "variants": {k: v.about for k, v in game.variants.items()},
        "goals": list(game.goals),
        "shifts": {k: vars(v) for k, v in game.shifts.items()},
    }


def _agent(name: str) -> dict[str, Any]:
    """Return the settings of an available agent, or the error in reading them."""
    try:
        return folders.read_config(folders.find(name)).flat()
    except (ValueError, OSError) as error:
        return {"error": str(error)}


Names = Positional[
    Annotated[
        tuple[str, ...],
        arg(
            help="Names of experiments in `astray list`, or all; for your own, module:OBJECT or a "
            "Python file that defines EXPERIMENT. If one of several fails, the next one begins.",
            help_behavior_hint="(required)",
        ),
    ]
]


def reproduce(
    names: Names,
    size: Size = "smoke",
    out: Path = Path("reports"),
    workers: Workers = None,
    on: Place = "here",
    device: Annotated[Device | None, otherwise("the size's")] = None,
    art: str = OWN,
    track: Annotated[Tracking | None, otherwise("none")] = None,
) -> None:
    """Reproduce figures and tables: train agents, evaluate them and write a report.

    The same command continues an interrupted run.

    Example: astray reproduce maze-corner --size smoke

    Args:
        size: Size of the study: smoke (minutes to two hours on two cores), pixels (images, about
            an hour per agent on two cores), night (the paper's worlds on two cores; prints an
            estimate first), hour (on a GPU), paper, or published (others' agents, see `astray
            agents`).
        out: Folder of reports: this one is written to <name>-<size>, and all share the agents.
        on: Place of the trainings: this machine, or a Ray cluster whose nodes share the folder.
        device: Device of the trainings.
        art: Art that images are drawn with: own or original.
        track: Tracker of the trainings' metrics and of the report.

    Raises:
        ValueError: If no study is named.
    """
    from astray.experiments import run

    if not names:
        raise ValueError("name an experiment, as `astray list` has them, or all")
    if workers is not None:
        bounded("workers", workers, 1, MOST_WORKERS)
    how: dict[str, Any] = dict(workers=workers, on=on, device=device, art=art, track=track)
    if len(names) == 1 and names[0] != run.ALL:
        print(run.reproduce(names[0], size, out, **how))
    else:
        print(run.reproduce_each(names, size, out, **how))


def bench(
    what: Positional[Benchmark] = "environments", markdown: bool = False, device: Device = "cpu"
) -> None:
    """Measure speed in ratios within one run, and against other libraries where possible.

    The benchmarks need a clone of the repository. "eyes" compares what networks learn to see in
    equal times.

    Example: astray bench environments

    Args:
        what: Benchmark to run.
        markdown: Print the result as a table for benchmarks/README.md.
        device: Device for training; everything else is measured on a CPU.

    Raises:
        ValueError: If the device cannot be used, or this is not a clone.
    """
    from importlib import import_module

    import astray
    from astray.agents.policy import usable

    if not usable(device):
        raise ValueError(f"there is no device {device!r} that torch can use")
    if device != "cpu" and what != "train":
        raise ValueError(f"device is {device!r}; {what} is measured on a CPU")
    checkout = Path(astray.__file__).parents[2]
    if not (checkout / "benchmarks" / "tables.py").is_file():
        raise ValueError("astray bench needs a clone of astray's repository: pip install -e CLONE")
    sys.path.insert(0, str(checkout))
    module, tables = import_module(f"benchmarks.{what}"), import_module("benchmarks.tables")
    rows = module.measure(device=device) if what == "train" else module.measure()
    if markdown:
        print(tables.markdown(rows))
    else:
        show(tables.table(rows))
