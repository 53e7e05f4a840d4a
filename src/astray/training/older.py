"""Conversion of settings from older versions."""

import json
from dataclasses import MISSING, fields
from typing import Any

from astray.agents.names import renamed_network
from astray.game import Variant
from astray.validation import renamed, shown

# Settings as older run folders have them, and what they are called now.
RENAMED = {
    "environments": "num_envs",
    "rollout": "num_steps",
    "kernels": "fused_cpu",
    "compiled": "compile",
    "graphs": "cudagraphs",
    "share": "fraction",
}


def settings(data: Any) -> dict[str, Any]:
    """Return a file's settings under today's names; raise ValueError if they are invalid."""
    if not isinstance(data, dict):
        raise ValueError(f"settings must be an object; got {shown(data)}")
    values: dict[str, Any] = dict(data)
    values.pop("training_variant", None)
    values = renamed(values, RENAMED, "a file of settings")
    if "network" in values:
        values["network"] = renamed_network(values["network"])
    return values


def same_levels(told: Any, now: Variant) -> bool:
    """Return whether a variant written by any version has the same levels as `now`."""
    today = json.loads(json.dumps(now.to_json()))
    return _levels_of(_with_later_knobs(told, now)) == _levels_of(today)


def _with_later_knobs(told: Any, now: Variant) -> Any:
    """Return a written variant with the defaults of knobs that its version lacked."""
    if not isinstance(told, dict):
        return told
    later = {f.name: f.default for f in fields(now) if f.default is not MISSING}
    if told.get("shifted") is not None and now.shifted is not None:
        told = told | {"shifted": _with_later_knobs(told["shifted"], now.shifted)}
    return later | told


def _levels_of(variant: Any) -> Any:
    """Return the fields of a written variant that affect its levels, without an unused shift."""
    if isinstance(variant, dict) and variant.get("shift_probability") == 0:
        return variant | {"shifted": None}
    return variant
