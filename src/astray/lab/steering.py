"""Interventions on an agent's layers, as requested by a page."""

from collections.abc import Mapping
from contextlib import AbstractContextManager
from typing import Any

from astray.analysis.trained import AnyModel
from astray.insight.interventions import ablate, patch, steer
from astray.insight.vectors import object_vectors
from astray.lab.worlds import World
from astray.validation import finite, of_kind, one_of, shown

FIELDS = {"what", "layer", "thing", "coefficient", "channels", "value"}
VECTOR, ABLATE, PATCH = "vector", "ablate", "patch"
STRONGEST = 1e6  # of a coefficient or a value


def change(
    agent: AnyModel, world: World, wanted: Mapping[str, Any]
) -> AbstractContextManager[AnyModel]:
    """Return the intervention on an agent that a message describes.

    "vector" adds `coefficient` times the layer's activation with `thing` minus without it.
    "ablate" sets `channels` (none: all) to 0, "patch" sets them to `value`.

    Raises:
        ValueError: If that is impossible.
    """
    if unknown := sorted(wanted.keys() - FIELDS):
        raise ValueError(f"unknown field {shown(unknown[0])} of steering")
    layer: Any = wanted.get("layer")
    of_kind("a layer", layer, str)
    channels = wanted.get("channels")
    if channels is not None:
        of_kind("channels", channels, list)
    what = wanted.get("what")
    one_of("steering", what, (VECTOR, ABLATE, PATCH))
    if what == VECTOR:
        thing = wanted.get("thing", next(iter(world.game.editing.OBJECTS)))
        vectors = object_vectors(agent, world.variant, {"here": world.level}, layer, thing)
        return steer(agent, {layer: vectors.mean}, _number("coefficient", wanted))
    if what == ABLATE:
        return ablate(agent, layer, channels)
    return patch(agent, layer, channels, _number("value", wanted))


def _number(name: str, wanted: Mapping[str, Any]) -> float:
    number: Any = wanted.get(name, 1.0)
    finite(name, number, -STRONGEST, STRONGEST)
    return float(number)
