"""astray finds out which goal a trained agent really pursues.

This package exports the names that most users need; the submodules hold the rest.
"""

import importlib
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from astray import envs, imports
from astray.envs import register as register

if TYPE_CHECKING:
    from astray.analysis.adapters import Function as Function
    from astray.analysis.estimates import Estimate as Estimate
    from astray.analysis.evaluate import evaluate as evaluate
    from astray.analysis.runs import evaluate_policies as evaluate_policies
    from astray.analysis.runs import evaluate_runs as evaluate_runs
    from astray.analysis.runs import load_agent as load_agent
    from astray.analysis.trained import Network as Network
    from astray.envs.single import GameEnv as GameEnv
    from astray.envs.vector import GameVectorEnv as GameVectorEnv
    from astray.experiments.audit import audit as audit
    from astray.experiments.run import reproduce as reproduce
    from astray.game import Game as Game
    from astray.game import Shift as Shift
    from astray.game import Variant as Variant
    from astray.level import Level as Level
    from astray.training.config import PRESETS as PRESETS
    from astray.training.config import Config as Config
    from astray.training.loop import iterate as iterate
    from astray.training.loop import train as train
    from astray.training.settings import Sampling as Sampling
    from astray.world import World as World

__version__ = version("astray")

# Where each is: imported when it is first asked for, as torch alone takes a second.
FACE = {
    "audit": "astray.experiments.audit:audit",
    "Config": "astray.training.config:Config",
    "Estimate": "astray.analysis.estimates:Estimate",
    "evaluate": "astray.analysis.evaluate:evaluate",
    "evaluate_policies": "astray.analysis.runs:evaluate_policies",
    "evaluate_runs": "astray.analysis.runs:evaluate_runs",
    "Function": "astray.analysis.adapters:Function",
    "Game": "astray.game:Game",
    "GameEnv": "astray.envs.single:GameEnv",
    "GameVectorEnv": "astray.envs.vector:GameVectorEnv",
    "iterate": "astray.training.loop:iterate",
    "Level": "astray.level:Level",
    "load_agent": "astray.analysis.runs:load_agent",
    "reproduce": "astray.experiments.run:reproduce",
    "train": "astray.training.loop:train",
    "Network": "astray.analysis.trained:Network",
    "PRESETS": "astray.training.config:PRESETS",
    "Sampling": "astray.training.settings:Sampling",
    "Shift": "astray.game:Shift",
    "Variant": "astray.game:Variant",
    "World": "astray.world:World",
}


def __getattr__(name: str) -> Any:
    if name not in FACE:
        raise AttributeError(f"module 'astray' has no {name!r}; it has: {', '.join(__dir__())}")
    module, _, attribute = FACE[name].partition(":")
    try:
        return getattr(importlib.import_module(module), attribute)
    except ModuleNotFoundError as error:
        raise imports.needed_by(f"astray.{name}", error) from None


def __dir__() -> list[str]:
    return sorted([*FACE, "register"])


envs.register_own()
