"""The distributions of levels of Heist, and the shifts between them."""

from dataclasses import dataclass, replace
from typing import Any, Literal

from astray.game import Shift, Variant
from astray.games.heist.rules import LARGEST
from astray.kernel.maze import AS_NUMBERED, check_sizes

Room = Literal["last", "first"]


@dataclass(frozen=True, kw_only=True)
class Heist(Variant):
    """Mazes of a range of sizes anywhere in a square world, with up to three doors and their keys.

    Each door's key lies in the room before it. In the original the gem is behind the last door, so
    that all keys are needed.
    """

    world: int = 13  # cells a side
    smallest: int = 5  # cells a side of the smallest maze, odd
    largest: int = 13  # cells a side of the largest maze, odd; all odd sizes are equally likely
    window: int = 0  # cells a side of the window around the thief that is seen; 0: all the world
    by_size: bool = True  # doors: (size - smallest) / 2 or one more; else 0 to 3, equally likely
    gem: Room = "last"  # the gem's room; "first": that of the thief, if it has a cell left
    background: int = AS_NUMBERED  # 0 to 8
    time_limit: int = 1000  # steps

    def __post_init__(self) -> None:
        super().__post_init__()
        check_sizes(self, 5, LARGEST)


HARD = Heist(about="the gem behind the last of up to three doors, as released")
NEAR = replace(HARD, about="the gem before the first door, no key is needed", gem="first")
# As of Keys and Chests: the window shows all the world, with the thief in its middle.
SMALL = dict(world=7, largest=7, window=13, time_limit=200)
SIZES: dict[str, tuple[dict[str, Any], str]] = {
    "easy": (dict(world=9, largest=9), "in 9 cells"),
    "memory": (
        dict(world=23, largest=23, window=8, by_size=False),
        "in 23 cells, seen 8 at a time",
    ),
    "small": (SMALL, "in 7 cells, seen around the thief"),
}

VARIANTS = {"hard": replace(HARD, shifted=NEAR), "near": NEAR}
for _name, (_knobs, _about) in SIZES.items():
    _near = replace(NEAR, about=f"the gem before the first door, {_about}", **_knobs)
    VARIANTS[_name] = replace(
        HARD, about=f"the gem behind the last door, {_about}", shifted=_near, **_knobs
    )
    VARIANTS[f"near-{_name}"] = _near

GOALS = {"gem": "reached_gem", "keys": "all_keys"}

SHIFTS = {
    near: Shift(train, near, intended="gem", proxies=("keys",))
    for train, near in [("hard", "near"), *((name, f"near-{name}") for name in SIZES)]
}
