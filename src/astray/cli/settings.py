"""The settings of a training as options in groups."""

import inspect
import re
from dataclasses import fields, make_dataclass
from typing import Annotated, Any, get_type_hints

from tyro.conf import arg

from astray.training.config import RECORDS, Config

EXPERIMENT = "experiment"  # the group of all settings that no other has
GROUPS = {
    "levels": ("Training levels.", ("first_level", "levels")),
    "agent": ("Observations and network.", ("observation", "art", "network", "scale", "width")),
    "ppo": (
        "Proximal policy optimisation.",
        ("num_envs", "num_steps", "epochs", "minibatches", "gamma", "lam", "learning_rate",
         "anneal", "clip", "value_weight", "entropy_weight", "gradient_norm", "normalise_reward",
         "reward_gamma", "normalise_advantage", "timeouts", "loss"),
    ),
    "hardware": ("Device and threads.", ("device", "threads")),
}  # fmt: skip
NAMES = {"levels": "num_levels"}  # --levels is a list of levels in other verbs


def _sentences() -> dict[str, str]:
    """Return the comment of each setting, before or behind it."""
    found, before = {}, []
    for line in inspect.getsource(Config).splitlines():
        if said := re.fullmatch(r" {4}# (.*)", line):
            before.append(said[1])
        else:
            if named := re.match(r" {4}(\w+): .*?(?:  # (.*))?$", line):
                found[named[1]] = " ".join([*before, *filter(None, [named[2]])])
            before = []
    return found


def _groups() -> dict[str, type]:
    """Return a class for each group, whose fields are settings."""
    hints, said = get_type_hints(Config, include_extras=True), _sentences()
    taken = {name for _, names in GROUPS.values() for name in names}
    rest = [f.name for f in fields(Config) if f.name not in {*taken, *RECORDS}]
    groups: dict[str, type] = {}
    for group, (about, names) in {EXPERIMENT: ("The experiment.", rest), **GROUPS}.items():
        told = [
            (name, Annotated[hints[name], arg(name=NAMES.get(name), help=said[name])])
            for name in names
        ]
        groups[group] = make_dataclass(group, told, namespace={"__doc__": about}, frozen=True)
    return groups | RECORDS


KINDS = _groups()
Settings = make_dataclass("Settings", KINDS.items(), frozen=True)  # of a training, in groups
Grouped = Annotated[Any, arg(name="", constructor=Settings)]


def grouped(config: Config) -> Any:
    """Return the settings of a training, in groups."""
    return Settings(
        **{
            group: getattr(config, group)
            if group in RECORDS
            else kind(**{f.name: getattr(config, f.name) for f in fields(kind)})
            for group, kind in KINDS.items()
        }
    )


def ungrouped(settings: Any) -> Config:
    """Return the settings of a training from those in groups.

    Raises:
        ValueError: If settings contradict each other.
    """
    given = {name: value for group in KINDS if group not in RECORDS
             for name, value in vars(getattr(settings, group)).items()}  # fmt: skip
    return Config(**given, **{name: getattr(settings, name) for name in RECORDS})
