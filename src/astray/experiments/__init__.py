"""Experiments: a file in `catalogue` is one figure or table. Nothing lists them.

Others' live in their own modules or files; `find` takes them too.
"""

from __future__ import annotations

import importlib
import importlib.util
import pkgutil
import re
from pathlib import Path

from astray import imports
from astray.bounds import brief
from astray.experiments import catalogue
from astray.experiments.spec import Experiment
from astray.files import see_readable

LARGEST = 2**20  # bytes of a file of Python

NAMES = tuple(
    sorted(module.name.replace("_", "-") for module in pkgutil.iter_modules(catalogue.__path__))
)


def load(name: str) -> Experiment:
    """The experiment called `name`."""
    if name not in NAMES:
        raise ValueError(f"unknown experiment {name!r}; there are: {', '.join(NAMES)}")
    return importlib.import_module(
        f"astray.experiments.catalogue.{name.replace('-', '_')}"
    ).EXPERIMENT


def find(experiment: str | Experiment) -> tuple[str, Experiment]:
    """An experiment, and the name that its report has.

    experiment  the name of one in the catalogue; or one of your own: the object, "module:OBJECT",
                or the path of a Python file that defines EXPERIMENT, which is run

    Raises ValueError where there is none.
    """
    if isinstance(experiment, Experiment):
        return _slug(experiment.title), experiment
    if imports.is_name(experiment):
        name, found = experiment.partition(":")[0].rpartition(".")[2], imports.find(experiment)
    elif experiment.endswith(".py"):
        name, found = Path(experiment).stem, _run(Path(experiment))
    else:
        return experiment, load(experiment)
    if not isinstance(found, Experiment):
        raise ValueError(f"{experiment} must be an Experiment; got {found!r}")
    return _slug(name), found


def _run(path: Path) -> object:
    """What a Python file defines as EXPERIMENT."""
    spec = importlib.util.spec_from_file_location(path.stem, path)
    if not path.is_file() or spec is None or spec.loader is None:
        raise ValueError(f"there is no experiment at {path}")
    see_readable(path, LARGEST)
    module = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except SyntaxError as error:
        raise ValueError(f"{path} must be a file of Python; {brief(error)}") from error
    if not hasattr(module, "EXPERIMENT"):
        raise ValueError(f"{path} must define EXPERIMENT")
    return module.EXPERIMENT


def _slug(text: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", text.lower()).strip("-")
