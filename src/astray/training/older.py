"""Variants as older versions wrote them."""

import json
from dataclasses import MISSING, fields
from typing import Any

from astray.game import Variant


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
