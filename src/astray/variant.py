"""Variants of a game: its knobs, which make a distribution of levels."""

from __future__ import annotations

import contextlib
import functools
import json
import typing
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields, replace
from typing import Annotated, Any, Self

import numpy as np

from astray.record import record_dtype
from astray.validation import MOST, bounded, finite, of_kind, one_of, plain, shown

KINDS = {int: np.int64, float: np.float64, bool: np.bool_}


@dataclass(frozen=True, kw_only=True)
class Variant:
    """A distribution of levels. Each game adds its own knobs: numbers with units, and choices.

    An integer may have bounds: `boxes: Annotated[int, (0, 3)]`.

    Examples:
        >>> variant = astray.games.find("maze").variant("anywhere")
        >>> variant.with_knobs({"time_limit": 100}).time_limit
        100

    Attributes:
        shifted: Another distribution of the same game, from which some levels come.

    Raises:
        ValueError: If a knob has another type, or is out of its bounds.
    """

    about: str
    time_limit: int  # steps until an episode is truncated
    shift_probability: float = 0.0  # that a level comes from `shifted`
    shifted: Variant | None = None

    def __post_init__(self) -> None:
        for name, kind in knobs(type(self)).items():  # to which compiled code casts
            choices, given = typing.get_args(kind), plain(getattr(self, name))
            object.__setattr__(self, name, given)
            if choices:
                one_of(name, given, choices)
            elif kind is bool:
                of_kind(name, given, bool)
            elif kind is int:
                bounded(name, given, *_bounds(type(self)).get(name, (-MOST, MOST)))
            else:
                finite(name, given)
        finite("shift_probability", self.shift_probability, 0, 1)
        if self.shift_probability and self.shifted is None:
            raise ValueError("shift_probability needs a `shifted` variant to shift to")
        if self.shifted is not None and type(self.shifted) is not type(self):
            raise ValueError("`shifted` is a variant of another game")
        bounded("time_limit", self.time_limit, 1, MOST)

    def with_knobs(self, changes: Mapping[str, Any]) -> Self:
        """Return the variant with some knobs changed; text is parsed as the knob's type.

        The variant that it shifts to changes too, except for the knobs that make the shift.

        Raises:
            ValueError: If there is no such knob, or it cannot have the value.
        """
        of_kind("knobs", changes, Mapping)
        kinds = {n: k if isinstance(k, type) else str for n, k in knobs(type(self)).items()}
        values = {name: _as_knob(name, value, kinds) for name, value in changes.items()}
        if self.shifted is not None:
            try:
                values["shifted"] = replace(self.shifted, **self.alike(values, self.shifted))
            except ValueError:  # which matters only where levels come from it
                if values.get("shift_probability", self.shift_probability):
                    raise
                values["shifted"] = None
        return replace(self, **values)

    def alike(self, changes: Mapping[str, Any], other: Variant) -> dict[str, Any]:
        """Return those `changes` whose knobs have equal values in this variant and `other`."""
        alike = {n: v for n, v in changes.items() if getattr(self, n) == getattr(other, n)}
        alike.pop("shift_probability", None)  # the other has nothing of its own to shift to
        return alike

    def unlike(self, other: Variant) -> dict[str, Any]:
        """Return the knobs whose values differ from those of `other`, of the same class."""
        own = {name: getattr(self, name) for name in knobs(type(self))}
        return {name: value for name, value in own.items() if value != getattr(other, name)}

    def to_json(self) -> dict[str, Any]:
        """Return all knobs, as files of settings have them."""
        return asdict(self)

    def records(self) -> np.ndarray:
        """Return the knobs for compiled code, [2] records: of this variant and of `shifted`."""
        kinds = knobs(type(self))
        dtype = record_dtype([(n, KINDS.get(k, np.int64)) for n, k in kinds.items()])
        records = np.zeros(2, dtype)
        for record, variant in zip(records, (self, self.shifted or self), strict=True):
            for name, kind in kinds.items():
                record[name] = _number(getattr(variant, name), kind)
        return records


@functools.cache
def knobs(variant: type[Variant]) -> Mapping[str, Any]:
    """Return the fields of a variant that compiled code sees, with their types."""
    hints = typing.get_type_hints(variant)
    return {f.name: hints[f.name] for f in fields(variant) if f.name not in ("about", "shifted")}


@functools.cache
def _bounds(variant: type[Variant]) -> Mapping[str, tuple[int, int]]:
    """Return the least and the largest value of knobs that have such."""
    hints = typing.get_type_hints(variant, include_extras=True)
    return {n: h.__metadata__[0] for n, h in hints.items() if typing.get_origin(h) is Annotated}


def _as_knob(name: str, value: Any, kinds: Mapping[str, type]) -> Any:
    """Return `value` converted to the type of the knob called `name`."""
    one_of("knob", name, kinds)
    value, kind = plain(value), kinds[name]
    if isinstance(value, str) and kind is not str:
        with contextlib.suppress(json.JSONDecodeError, RecursionError):
            value = json.loads(value.lower())
    value = float(value) if type(value) is int and kind is float else value
    if type(value) is not kind:
        raise ValueError(f"{name} must be of type {kind.__name__}; got {shown(value)}")
    return value


def _number(value: Any, kind: Any) -> Any:
    choices = typing.get_args(kind)
    return choices.index(value) if choices else value
