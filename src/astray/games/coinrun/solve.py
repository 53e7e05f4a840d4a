"""Ways through a level, from a search with the real physics and the real walkers."""

import functools
from collections.abc import Callable
from typing import Any

import numpy as np

from astray.games.coinrun import rules
from astray.games.coinrun.cells import truths
from astray.games.coinrun.reach import explore
from astray.games.coinrun.rules import (
    COIN,
    EMPTY,
    INVISIBLE,
    NOTHING,
    REWARD,
    TIES,
    WORLD,
    F,
    act,
    step,
)
from astray.games.coinrun.variants import GOALS
from astray.kernel.grid import ACTIONS, STAY
from astray.kernel.jit import entry, kernel
from astray.kernel.rng import below
from astray.record import NEVER, check_record
from astray.validation import finite, one_of

TRIED = np.array([ACTIONS.index(a) for a in ("right-up", "right", "left-up", "left", "up", "stay",
                                              "down")])  # fmt: skip
HELD = 3  # steps for which the search holds an action
NODES = 100_000  # the search gives up after so many
LONGEST = HELD * NODES  # steps of the way to the last of them, at most
SLOTS = 1 << 18  # of the table of what the search has seen
COIN_GOAL, END_GOAL, WALL_GOAL, BEYOND_GOAL = range(4)  # GOALS, in their order
GREED = 1.5  # how much a step still to go weighs against one gone: more finds worse ways faster

check = functools.partial(check_record, rules=rules, truths=truths)


def expert(s: Any, goal: str) -> Callable[[Any], int]:
    """Return a policy that leads to `goal` from the runner's place in this episode.

    A plan is kept while the runner follows it, and replaced if somebody else moves the runner. The
    first plan, from `s`, is stored, because many episodes may begin there.
    """
    check(s)
    ways = [_Way(s, goal)]

    def action(now: Any) -> int:
        check(now)
        for way in ways:
            if way.leads_on(now):
                return way.action(now)
        ways[1:] = [_Way(now, goal)]
        return ways[1].action(now)

    return action


class _Way:
    """The actions of a plan, those of waiting after it, and the motions along it."""

    def __init__(self, s: Any, goal: str) -> None:
        planned = plan(s, goal)
        self.begin = int(s.time)
        left = min(int(s.time_limit) - self.begin, LONGEST)
        self.actions = np.full(max(left, 1), STAY)
        self.actions[: len(planned)] = planned
        self.motions = follow(_where(s, goal), self.actions)

    def leads_on(self, now: Any) -> bool:
        """Return whether everything that moves is where the plan has it at this time."""
        t = int(now.time) - self.begin
        return 0 <= t < len(self.actions) and moves_as(now, self.motions[t])

    def action(self, now: Any) -> int:
        return int(self.actions[int(now.time) - self.begin])


def optimal_return(s: Any, goal: str, gamma: float = 1.0) -> float:
    """Return the discounted reward of `expert`'s way to `goal`, as if that were rewarded.

    It is gamma ** (steps - 1) * 10, or 0 if no way is found in time, or the goal was reached. The
    way is short, but not always the shortest.
    """
    finite("gamma", gamma, 0, 1)
    check(s)
    steps = len(plan(s, goal))
    return REWARD * gamma ** (steps - 1) if steps else 0.0


def plan(s: Any, goal: str) -> np.ndarray:
    """Return the actions [K] of a short way from `s` to `goal`; empty if there is none to go.

    For goals other than the coin, coins are removed first. A way that avoids coins, which end the
    level, would bias the base rate of accidental pickups.
    """
    one_of("goal", goal, GOALS)
    event = GOALS[goal]
    coin = goal == "coin" and not (s.cell == COIN).any()
    beyond = goal == "beyond" and s.permeable == 0
    if s[event] != NEVER or s.ended or coin or beyond:
        return np.empty(0, np.int64)
    left = min(int(s.time_limit - s.time), LONGEST)
    return search(_where(s, goal), tuple(GOALS).index(goal), left)


def _where(s: Any, goal: str) -> Any:
    """Return a copy [1] of `s` to search in, with coins only if they are the goal."""
    states: Any = np.array([s], s.dtype).view(np.recarray)
    if goal != "coin":
        states.cell[states.cell == COIN] = EMPTY
    return states


def reachable(s: Any) -> np.ndarray:
    """Return the cells that the runner could touch if no walker stopped it, [WORLD, WORLD] bool.

    Cells that hold a standing or walking thing count as reachable.
    """
    check(s)
    touched = all_touched(np.array([s], s.dtype).view(np.recarray))
    touched |= (s.thing != NOTHING) | (s.cell == INVISIBLE)
    for k in range(s.walkers):
        touched[int(s.walker_y[k]), int(s.walker_x[k])] = True
    return touched


@entry
def all_touched(states):
    """Return the cells that the runner can touch, [WORLD, WORLD] bool."""
    touched = np.zeros((WORLD, WORLD), np.bool_)
    explore(states[0], NEVER, NEVER, touched)
    return touched


@entry
def follow(states, actions):
    """Return the motion before each of `actions` [N] from `states[0]`, which is overwritten."""
    s = states[0]
    motions = empty_motions(s, len(actions))
    for t in range(len(actions)):
        note_motion(s, motions[t])
        s.time += 1
        step(s, actions[t])
    return motions


@entry
def moves_as(s, motion):
    """Return whether the motion of `s` is `motion`."""
    now = empty_motions(s, 1)[0]
    note_motion(s, now)
    return len(now) == len(motion) and (now == motion).all()


@entry
def search(states, goal, left):
    """Find the actions from `states[0]`, which is overwritten, to `goal` in `left` steps."""
    s = states[0]
    ties = np.empty(left, np.bool_)
    for t in range(left):
        ties[t] = below(s, TIES) % 2 == 0
    targets = columns(s, goal)
    begin, seen = s.time, np.zeros(SLOTS, np.int64)
    motions = empty_motions(s, NODES)
    when, parent, how = np.zeros((3, NODES), np.int64)
    # Nodes wait in lists, one for each cost in steps: the first of a list, and the one after.
    first, after = np.full(left + 8 * WORLD, -1), np.full(NODES, -1)
    note_motion(s, motions[0])
    first[0], count, cost = 0, 1, 0
    while cost < len(first) and count + len(TRIED) <= NODES:
        node = first[cost]
        if node < 0:
            cost += 1
            continue
        first[cost] = after[node]
        for action in TRIED:
            give_motion(s, motions[node])
            s.took_coin, s.reached_end, s.touched_wall, s.passed_wall = NEVER, NEVER, NEVER, NEVER
            time, ended = when[node], False
            for _ in range(min(HELD, left - time)):
                time += 1
                s.time = begin + time
                _, ended = act(s, action, ties[time - 1])
                if has_reached(s, goal):
                    return unwind(node, action, time, when, parent, how)
                if ended:
                    break
            if not ended and time < left and is_new(s, time, seen):
                price = min(time + int(GREED * steps_left(s, goal, targets)), len(first) - 1)
                note_motion(s, motions[count])
                when[count], parent[count], how[count] = time, node, action
                after[count], first[price] = first[price], count
                cost = min(cost, price)
                count += 1
    return np.empty(0, np.int64)


@kernel
def empty_motions(s, count):
    """Allocate `count` motions: x, y, vx, vy, on a crate; x of all walkers, then their vx.

    Walkers are included since the runner can affect them, though rarely.
    """
    return np.empty((count, 5 + 2 * s.walkers), np.float32)


@kernel
def note_motion(s, motion):
    """Write the motion of the runner and the walkers."""
    motion[0], motion[1], motion[2], motion[3] = s.x, s.y, s.vx, s.vy
    motion[4] = 1 if s.on_crate else 0
    for i in range(s.walkers):
        motion[5 + i], motion[5 + s.walkers + i] = s.walker_x[i], s.walker_vx[i]


@kernel
def give_motion(s, motion):
    """Set the motion of the runner and the walkers."""
    s.x, s.y, s.vx, s.vy = motion[0], motion[1], motion[2], motion[3]
    s.on_crate = motion[4] > 0
    for i in range(s.walkers):
        s.walker_x[i], s.walker_vx[i] = motion[5 + i], motion[5 + s.walkers + i]


@kernel
def has_reached(s, goal):
    """Return whether the goal's event has happened."""
    return (
        (goal == COIN_GOAL and s.took_coin != NEVER)
        or (goal == END_GOAL and s.reached_end != NEVER)
        or (goal == WALL_GOAL and s.touched_wall != NEVER)
        or (goal == BEYOND_GOAL and s.passed_wall != NEVER)
    )


@kernel
def columns(s, goal):
    """Return the possible columns of the goal, in cells to the right."""
    if goal == COIN_GOAL:
        return (np.argwhere(s.cell == COIN)[:, 1] + 0.5).astype(np.float32)
    far = s.end_x + 1.5 + s.permeable if goal == BEYOND_GOAL else s.end_x + 0.5
    return np.full(1, F(far))


@kernel
def steps_left(s, goal, targets):
    """Return a lower bound of the steps to the goal, at two per cell."""
    least = F(2 * WORLD)
    for k in range(len(targets)):
        away = F(2) * abs(targets[k] - s.x)
        if goal != COIN_GOAL and s.x > targets[k]:
            away = F(0)
        least = min(least, away)
    return least


@kernel
def is_new(s, time, seen):
    """Mark this motion as visited; return whether the search has not been near it before.

    With walkers about, the time distinguishes motions, since waiting can help.
    """
    key = (
        int(s.x * 4)
        + (int(s.y * 4) << 8)
        + (int(s.vx * 10 + 20) << 16)
        + (int(s.vy * 5 + 10) << 22)
    )
    key = (key << 2) + (2 if s.on_crate else 0) + 1
    if s.walkers > 0:
        key += (time // 8) << 32
    slot = (key * 2654435761 >> 7) % SLOTS
    for _ in range(64):
        if seen[slot] == key:
            return False
        if seen[slot] == 0:
            seen[slot] = key
            return True
        slot = (slot + 1) % SLOTS
    return False


@kernel
def unwind(node, action, time, when, parent, how):
    """Return the actions up to `node`, then `action` until `time`."""
    actions = np.empty(time, np.int64)
    actions[when[node] : time] = action
    while when[node] > 0:
        before = parent[node]
        actions[when[before] : when[node]] = how[node]
        node = before
    return actions
