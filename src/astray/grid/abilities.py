"""Abilities of every grid world: levels as data, places and cells, scripts that walk to a goal."""

import functools
import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any

import numpy as np

from astray.game import Variant
from astray.grid.rules import ACTIONS, DX, DY, NOWHERE, STAY, seed_by
from astray.kernel.grid import UNREACHABLE, distances
from astray.kernel.jit import entry, kernel
from astray.kernel.rng import RNG_FIELDS
from astray.protocols import Rules
from astray.record import NEVER, check_record, fresh, record_dtype, within
from astray.validation import finite, one_of

MOST_KNOWN = 100_000  # returns that a solver keeps, and steps of a way
OVER = 16  # a mover's code counts so much in a level's grid
SPARE = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789*"  # of movers on things


@dataclass(frozen=True)
class World:
    """Description of a grid world for its abilities; see `astray.grid.world`."""

    rules: Rules
    side: int
    things: Mapping[str, str]
    movers: Mapping[str, str]
    solid: Sequence[str]
    hazards: Sequence[str]
    stood: str
    agents: Sequence[str]
    events: Mapping[str, str]
    seek: Mapping[str, Callable]
    furnish: Callable | None
    looks: Mapping[str, int]
    bounds: Mapping[str, tuple[int, int]]

    def codes(self, names: Sequence[str]) -> list[int]:
        """Return the codes of kinds, by name."""
        all_names = [*self.things.values(), *self.movers.values()]
        return [1 + all_names.index(name) for name in names]

    def legend(self) -> dict[str, int]:
        """Return the characters of drawings: for nothing, things, movers, and movers on things."""
        first = 1 + len(self.things)
        things = {char: code for code, char in enumerate(self.things, 1)}
        movers = {char: OVER * code for code, char in enumerate(self.movers, first)}
        open_things = [c for c, name in self.things.items() if name not in self.solid]
        spare = iter(c for c in SPARE if c not in (*things, *movers))
        both = {
            next(spare): movers[mover] + things[thing]
            for mover, thing in itertools.product(movers, open_things)
        }
        return {".": 0} | things | movers | both

    def pictures(self) -> dict[str, tuple[str, ...]]:
        """Return the names of the kinds that a character of a drawing stands for."""
        kinds = [*self.things.values(), *self.movers.values()]
        return {
            char: tuple(kinds[part - 1] for part in reversed(divmod(code, OVER)) if part)
            for char, code in self.legend().items()
        }

    def truths(self, s: np.ndarray) -> dict[str, np.ndarray]:
        """Return facts [N] about states `s` [N] that compiled code relies on."""
        things, kinds = len(self.things), len(self.things) + len(self.movers)
        x, y = (np.clip(s[axis], 0, self.side - 1) for axis in "xy")
        beneath = s["cell"][np.arange(len(s)), y, x]
        mover = (s["mover"] == 0) | ((s["mover"] > things) & (s["mover"] <= kinds))
        return {
            "cell": (s["cell"] <= things).all((1, 2)),  # pyrefly: ignore
            "mover": mover.all((1, 2)),
            "x": within(s["x"], 0, self.side),
            "y": within(s["y"], 0, self.side),
            "cell of the agent": ~np.isin(beneath, self.codes(self.solid)),
            "held": within(s["held"], 0, len(self.agents)),
            "mt": (s["mt"] != 0).any(1),  # else all that is drawn is 0
        } | {name: within(s[name], *ends) for name, ends in self.bounds.items()}

    def check(self, s: Any) -> None:
        check_record(s, self.rules, self.truths)

    @functools.cached_property
    def targets(self) -> dict[str, Callable]:
        """The functions of `target_of`, by goal."""
        return {goal: target_of(seek) for goal, seek in self.seek.items()}

    @functools.cached_property
    def is_free(self) -> np.ndarray:
        """Whether an agent may stand without harm on each code, [256] bool."""
        return ~np.isin(np.arange(256), self.codes([*self.solid, *self.hazards]))


def editing(world: World) -> Any:
    """Return the ability to describe and build levels; raise ValueError for invalid ones."""
    legend = world.legend()
    names = {n: c for c, n in {**world.things, **world.movers}.items() if n not in world.solid}
    under = {0, *(sum(divmod(legend[char], OVER)) for char in world.stood)}
    stood = "".join(c for c, code in legend.items() if code and {*divmod(code, OVER)} <= under)

    def grid(s: Any) -> np.ndarray:
        return (s.cell + OVER * s.mover).astype(np.uint8)

    def centre(s: Any) -> list[float]:
        return [float(s.x) + 0.5, float(s.y) + 0.5]

    def describe(s: Any) -> dict[str, Any]:
        told = {name: int(s[name]) for name in world.looks}
        return {"grid": grid(s).tolist(), "agent": centre(s), "looks": told}

    def build(cells: np.ndarray, at: tuple[int, int], looks: Mapping, variant: Variant) -> Any:
        if cells.shape != (world.side, world.side):
            raise ValueError(f"the level is {cells.shape}; it must be {world.side} cells a side")
        s: Any = fresh(world.rules)[0]
        s.cell[:], s.mover[:] = cells % OVER, cells // OVER
        s.time_limit, (s.x, s.y) = variant.time_limit, at
        (twister,) = np.zeros(1, record_dtype(RNG_FIELDS))  # one type for all worlds
        _settle(twister, s.cell, s.mover)
        s.mt[:], s.mt_next = twister.mt, twister.mt_next
        if world.furnish:
            world.furnish(s, variant.records()[0])
        for name, usual in world.looks.items():
            s[name] = looks.get(name, usual)
        return s

    return SimpleNamespace(
        LEGEND=legend, OBJECTS=names, STOOD_ON=stood,
        grid=grid, centre=centre, describe=describe, build=build,
    )  # fmt: skip


@entry
def _settle(twister, cell, mover):
    """Do as `settle`, for which Python takes more than a millisecond."""
    seed_by(twister, cell, mover)


def cells(world: World) -> Any:
    """Return the ability `cells`."""

    def target(s: Any, goal: str) -> tuple[int, int] | None:
        x, y = world.targets[goal](s) if goal in world.targets else (NEVER, NEVER)
        return None if x == NEVER else (int(x), int(y))

    return SimpleNamespace(free=functools.partial(walkable, world), target=target)


def target_of(seek: Callable) -> Callable:
    """Make a function (s) -> the only cell (x, y) that a script goes to, NEVER, NEVER without one.

    A mover has none.
    """

    @kernel
    def target(s):
        side, found, x, y = s.cell.shape[0], 0, NEVER, NEVER
        there = np.full((side, side), NOWHERE)
        seek(s, there)
        for row in range(side):
            for column in range(side):
                if there[row, column] != NOWHERE:
                    found, x, y = found + 1, column, row
        return (x, y) if found == 1 and s.mover[y, x] == 0 else (NEVER, NEVER)

    return target


def walkable(world: World, s: Any) -> np.ndarray:
    """Return the cells that an agent can walk on, hazards too, [H, W] bool."""
    return ~np.isin(s.cell, world.codes(world.solid))


def solver(world: World) -> Any:
    """Return the shortest ways to what `seek` returns; raise ValueError for endless ones."""
    # Returns of states whose way draws nothing, since they hold for any level and random numbers.
    known: dict[tuple, float] = {}
    drawn = [name for name, *_ in RNG_FIELDS]
    unseen = {"level", "seed", "turn", "shifted", *drawn}
    seen = [name for name in world.rules.STATE.names or () if name not in unseen]

    def expert(s: Any, goal: str) -> Callable[[Any], int]:
        one_of("goal", goal, world.events)
        world.check(s)

        def action(now: Any) -> int:
            world.check(now)
            return scripted(world, now, goal)

        return action

    def optimal_return(s: Any, goal: str, gamma: float = 1.0) -> float:
        finite("gamma", gamma, 0, 1)
        one_of("goal", goal, world.events)
        world.check(s)
        now = np.array([s], world.rules.STATE)[0]
        total, way, is_whole = 0.0, [], True
        while is_whole and not is_over(world, now, goal):
            key = goal, gamma, *(now[name].tobytes() for name in seen)
            if key in known:
                total = known[key]
                break
            action = scripted(world, now, goal)
            now["time"] += 1
            reward, done = world.rules.step(now, action)
            now["ended"] = done or now["time"] >= now["time_limit"]
            way.append((key, float(reward)))
            is_whole = gamma ** len(way) > 1e-9  # less changes nothing
            if len(way) == MOST_KNOWN:
                raise ValueError(f"{goal!r} takes {MOST_KNOWN:,} steps: lower gamma or time_limit")
        for key, reward in reversed(way):
            total = reward + gamma * total
            if is_whole and len(known) < MOST_KNOWN and now[drawn] == s[drawn]:
                known[key] = total
        return total

    def reached(s: Any) -> np.ndarray:
        """Return the cells that the agent can reach, through hazards if need be, [H, W] bool."""
        world.check(s)
        return distances(walkable(world, s), int(s.x), int(s.y)) != UNREACHABLE

    return SimpleNamespace(reachable=reached, expert=expert, optimal_return=optimal_return)


def is_over(world: World, s: Any, goal: str) -> bool:
    """Return whether a level has ended or its goal was reached."""
    return bool(s["ended"] or s[world.events[goal]] != NEVER)


def scripted(world: World, s: Any, goal: str) -> int:
    """Return the action of the script of a goal in a valid state."""
    cell, x, y = s["cell"], int(s["x"]), int(s["y"])
    there = np.full(cell.shape, NOWHERE)
    if not is_over(world, s, goal):
        world.seek[goal](s, there)
    action = int(there[y, x])
    return action if action > STAY else towards(there, cell, s["mover"], x, y, world.is_free)


@entry
def towards(there, cell, mover, x, y, is_free):
    """Return the action that leads to the nearest target around hazards, or "stay".

    Args:
        there: [H, W] int64, NOWHERE but in targets.
        cell, mover: [H, W] codes.
        x, y: Cell of the agent.
        is_free: [256] bool, whether an agent may stand on each code.
    """
    height, width = there.shape
    free = np.empty((height, width), np.bool_)
    for v in range(height):
        for u in range(width):
            may_stand = is_free[cell[v, u]] and is_free[mover[v, u]]
            free[v, u] = may_stand or there[v, u] != NOWHERE or (u == x and v == y)
    away = distances(free, x, y)
    near, nearest = UNREACHABLE, (x, y)
    for u in range(width):
        for v in range(height):
            steps = away[v, u] if there[v, u] != NOWHERE else UNREACHABLE
            if steps != UNREACHABLE and (near == UNREACHABLE or steps < near):
                near, nearest = steps, (u, v)
    left = distances(free, nearest[0], nearest[1])
    for action in range(1, len(ACTIONS)):
        u, v = x + DX[action], y + DY[action]
        inside = 0 <= u < width and 0 <= v < height
        if inside and left[v, u] == left[y, x] - 1 and left[v, u] != UNREACHABLE:
            return action
    return STAY
