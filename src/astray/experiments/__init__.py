"""Experiments: a file in `catalogue` is one figure or table. Nothing lists them."""

import importlib
import pkgutil

from astray.experiments import catalogue
from astray.experiments.spec import Experiment

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
