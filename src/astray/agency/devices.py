"""Devices: tables from observation to action, with a fraction eps of random actions."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, get_args

import numpy as np
from scipy.special import logsumexp

from astray.agency.gridworld import ACTIONS, Trajectory, World
from astray.agency.steps import KIND, Rule, log_product
from astray.validation import one_of

# What a device sees. "type": the type of the cell faced in the direction of the last action;
# "type+last": and the last action; "ego": the type, its actions being turns from the last one;
# "egowalls": the walls around, ahead first, likewise; "abswalls": the walls around, by compass;
# "abswalls+last": and the last action; "pos": the cell; "none": nothing.
Observation = Literal[
    "type", "type+last", "ego", "egowalls", "abswalls", "abswalls+last", "pos", "none"
]
OBSERVATIONS: tuple[Observation, ...] = get_args(Observation)
# Before the first action: "null", an observation of its own; "skip": the first action is not
# assessed; or facing a direction.
First = Literal["null", "skip", "up", "down", "left", "right"]

HEADLESS = ("abswalls", "pos", "none")  # seen without a last action, so before the first too

EMPTY, WALL, START, GOAL = range(4)
UNSEEN = -1  # before the first action
CLOCKWISE = np.array([0, 2, 3, 1])  # action -> quarter turns from up
COMPASS = np.argsort(CLOCKWISE)  # quarter turns from up -> action
A = len(ACTIONS)


@dataclass(frozen=True, eq=False)
class Seen:
    """Observations of a device at T steps, and the kind of step under each table entry."""

    observation: np.ndarray  # [T] int64, any codes
    kinds: np.ndarray  # [T, 4] uint8, the kind of the step if the entry is b
    same: np.ndarray  # [T, 4] bool, whether the step is what the entry b says

    def __len__(self) -> int:
        return len(self.observation)


def see(
    world: World,
    trajectory: Trajectory,
    goal: int | None,
    what: Observation = "type",
    first: First = "null",
    *,
    legal: bool = False,
) -> Seen:
    """Return a device's observations along `trajectory`; raise ValueError for an unknown class.

    Args:
        goal: Number of the cell where the goal is shown; None for nowhere.
        legal: Whether only moves that change the cell are actions. A table entry that points into
            a wall then stands for any of them.
    """
    one_of("observation", what, Observation)
    one_of("first", first, First)
    before, taken = trajectory.cells[:-1], trajectory.actions
    facing = ACTIONS.index(first) if first in ACTIONS else 0
    last = np.append(facing, taken[:-1])[: len(taken)]
    entries = np.broadcast_to(np.arange(A), (len(taken), A))
    if what in ("ego", "egowalls"):
        entries = COMPASS[(entries + CLOCKWISE[last][:, None]) % A]
    codes = _codes(world, before, last, goal, what)
    if first == "null" and len(codes) and what not in HEADLESS:
        codes[0] = UNSEEN
    same = entries == taken[:, None]
    possible = world.legal[before].sum(1) if legal else np.full(len(before), A)
    kinds = KIND[same.astype(int), 1, possible[:, None]]
    if legal:
        blocked = ~np.take_along_axis(world.legal[before], entries, 1)
        kinds = np.where(blocked, KIND[1, possible, possible][:, None], kinds)
    assessed = slice(1 if first == "skip" else 0, None)
    return Seen(codes[assessed], kinds[assessed], same[assessed])


def _codes(
    world: World, before: np.ndarray, last: np.ndarray, goal: int | None, what: Observation
) -> np.ndarray:
    """Return [T] int64 codes of the observations, except the first one's."""
    if what == "pos":
        return before.copy()
    if what == "none":
        return np.zeros(len(before), np.int64)
    walls = ~world.legal[before]
    if what.startswith("abswalls"):
        codes = walls @ (1 << np.arange(A))
    elif what == "egowalls":
        around = COMPASS[(np.arange(A) + CLOCKWISE[last][:, None]) % A]
        codes = np.take_along_axis(walls, around, 1) @ (1 << np.arange(A))
    else:
        codes = _faced(world, before, last, goal)
    return codes * A + last if what.endswith("+last") else codes


def _faced(world: World, before: np.ndarray, last: np.ndarray, goal: int | None) -> np.ndarray:
    """Return [T] int64, the type of the cell ahead: wall before goal before start before empty."""
    faced = world.after[before, last]
    codes = np.where(faced == before[:1], START, EMPTY)
    codes = np.where(faced == (-1 if goal is None else goal), GOAL, codes)
    return np.where(world.legal[before, last], codes, WALL)


def join(seen: Sequence[Seen]) -> Seen:
    """Concatenate the steps of several trajectories of one device."""
    parts = zip(*((one.observation, one.kinds, one.same) for one in seen), strict=True)
    return Seen(*(np.concatenate(part) for part in parts))


def log_mixture(seen: Seen, rule: Rule, table: np.ndarray) -> float:
    """Return log p_dev in nats, with all tables equally likely and eps distributed as `rule`.

    Args:
        table: [kinds, N] of `steps.log_table`. Unseen observations cancel.
    """
    _, row = np.unique(seen.observation, return_inverse=True)
    entries = log_product(seen.kinds, table, row[:, None] * A + np.arange(A))
    rows = np.logaddexp.reduce(entries.reshape(-1, A, len(rule.eps)), axis=1) - np.log(A)
    return float(rule.integrate(rows.sum(0)))


def log_mixture_online(seen: Seen, rule: Rule, table: np.ndarray) -> np.ndarray:
    """Return `log_mixture` of the first t steps for t = 0 to T, [T + 1]; `table` is [kinds, N]."""
    entries: dict[int, np.ndarray] = {}
    rows = [np.zeros(len(rule.eps))]
    for code, kinds in zip(seen.observation.tolist(), seen.kinds, strict=True):
        old = entries.get(code, np.zeros((A, len(rule.eps))))
        entries[code] = old + table[kinds]
        gained = logsumexp(entries[code], axis=0) - logsumexp(old, axis=0)
        rows.append(rows[-1] + gained)
    return rule.integrate(np.array(rows))


def table_of(seen: Seen) -> np.ndarray:
    """Return [V, 4] int64, how often each action followed each of V observations."""
    _, row = np.unique(seen.observation, return_inverse=True)
    counts = np.zeros((row.max(initial=-1) + 1, A), np.int64)
    np.add.at(counts, row, seen.same)
    return counts
