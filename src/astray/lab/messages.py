"""Messages of a page, with checks of every field."""

import json
from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from astray.validation import MOST, bounded, check_words, of_kind, shown

LARGEST = 2**18  # characters of a message; a level of CoinRun as JSON has some 20,000
LONGEST = 2000  # steps of an episode that a page plays
MOST_DRAWS = 20  # episodes for each place of a splay
NAME = 4096  # characters of a name; that of an agent may be its path

Kind = Literal[
    "hello", "art", "level", "fields", "play", "posterior", "splay", "attribution", "route", "view",
    "reading", "distinguishes",
]  # fmt: skip
Mode = Literal["sampled", "greedy"]
Method = Literal["occlusion", "gradients", "integrated gradients"]


@dataclass(frozen=True)
class Message:
    """A question of the page. `level` is a number, a drawing, or an object of `Level.to_json`.

    Attributes:
        actions: Action numbers from the beginning of the level to the state in question.
        steps: Number of further steps by the agent.
        thing: Object to splay: "agent", or the object at `cell`.
        layer: Layer for probes.
        effects: Whether to mark equivalent actions.
        slot: A newer question of the same kind and slot cancels this one.
    """

    id: int
    kind: Kind
    game: str = ""
    variant: str = ""
    knobs: Mapping[str, Any] = field(default_factory=dict)
    level: int | str | Mapping[str, Any] = 0
    agent: str = ""
    mode: Mode = "sampled"
    seed: int = 0
    actions: tuple[int, ...] = ()
    steps: int = 0
    thing: str = ""
    cell: tuple[int, int] | None = None
    goal: str = ""
    layer: str = ""
    slot: str = ""
    draws: int = 1
    effects: bool = False
    method: Method = "occlusion"
    steering: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        bounded("id", self.id, 0, 2**53)
        check_words(self)
        for name in ("game", "variant", "agent", "thing", "goal", "layer", "slot"):
            if len(text := getattr(self, name)) > NAME:
                raise ValueError(f"{name} must be at most {NAME} characters; got {shown(text)}")
        of_kind("knobs", self.knobs, Mapping)
        of_kind("steering", self.steering, Mapping)
        of_kind("level", self.level, int | str | Mapping)
        if isinstance(self.level, bool):
            raise ValueError(f"level must be a number, a drawing or an object; got {self.level}")
        bounded("seed", self.seed, 0, MOST)
        bounded("steps", self.steps, 0, LONGEST)
        bounded("draws", self.draws, 1, MOST_DRAWS)
        if len(self.actions) > LONGEST:
            raise ValueError(f"actions must be at most {LONGEST}; got {len(self.actions)}")
        for action in self.actions:
            bounded("an action", action, 0, 255)


def read(text: Any) -> Message:
    """Parse a message.

    Raises:
        ValueError: If it is invalid.
    """
    of_kind("a message", text, str)
    if len(text) > LARGEST:
        raise ValueError(f"a message must be at most {LARGEST:,} characters; got {len(text):,}")
    try:
        data = json.loads(text, parse_constant=_refused)
    except (ValueError, RecursionError) as error:
        raise ValueError(f"a message must be JSON; {error}") from None
    of_kind("a message", data, Mapping)
    known = {f.name for f in fields(Message)}
    if unknown := sorted(data.keys() - known):
        raise ValueError(f"unknown field {shown(unknown[0])} of a message")
    if missing := {"id", "kind"} - data.keys():
        raise ValueError(f"a message must have a field {min(missing)!r}")
    if "actions" in data:
        of_kind("actions", data["actions"], list)
        data["actions"] = tuple(data["actions"])
    if data.get("cell") is not None:
        data["cell"] = _cell(data["cell"])
    return Message(**data)


def number_of(text: Any) -> int:
    """Return the id of any message; 0 if it has none."""
    try:
        found = json.loads(text)["id"]
        return found if type(found) is int and 0 <= found <= 2**53 else 0
    except (ValueError, TypeError, KeyError, IndexError, RecursionError):
        return 0


def _cell(given: Any) -> tuple[int, int]:
    if not isinstance(given, list) or len(given) != 2 or any(type(n) is not int for n in given):
        raise ValueError(f"cell must be two integers, x and y; got {shown(given)}")
    return given[0], given[1]


def _refused(word: str) -> Any:
    raise ValueError(f"a message's numbers must be finite; got {word}")
