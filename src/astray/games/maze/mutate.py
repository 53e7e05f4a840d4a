"""Levels of Maze made of others by small edits: walls, the mouse, the objects."""

from __future__ import annotations

import functools

import numpy as np

from astray.bounds import bounded, integers, of_kind
from astray.game import MOST_EDITS, MUTATIONS, Mutation, Variant
from astray.games.maze import rules
from astray.games.maze.levels import ANYWHERE, CORNER, ON_OTHER, furnish, invariants
from astray.games.maze.rules import BOTH, EMPTY, GOAL, OTHER, STATE, note_arrivals
from astray.games.maze.variants import Maze
from astray.kernel.grid import UNREACHABLE, distances
from astray.kernel.jit import entry, kernel, shared
from astray.kernel.maze import WALL
from astray.kernel.rng import below, seed_twister, unit
from astray.record import NEVER, check_states
from astray.words import check_word

CONSTANT, IDENTITY, BINOMIAL = range(len(MUTATIONS))
WEIGHTS = 12  # of a binomial edit: 1 the goal, 1 the mouse, 10 a wall


def mutate(
    states: np.ndarray, variant: Variant, seeds: np.ndarray, edits: int, kind: Mutation
) -> np.ndarray:
    """Copies of states [N] that levels begin in, each with `edits` edits; their level is NEVER.

    An edit opens or closes a cell of the maze; moves the mouse or the other object, or a wall, as
    likely; or places the goal as a new level of `variant` does, in its shifted place with its
    shift_probability. A goal on a dish goes with the dish. No edit leaves the goal, the other
    object or the corner out of the mouse's reach: a wall that would is not built.

    seeds  [N] uint32, which decide the edits
    kind   "constant": all edits but the last two are of walls, then the mouse, then the goal;
           "identity": the same, but the goal is left as it is; "binomial": each edit is drawn,
           the goal and the mouse 1 in 12 each

    Raises ValueError where states are none of the variant, or there is not a seed for each.
    """
    of_kind("variant", variant, Maze)
    check_states(states, "maze", rules, functools.partial(invariants, variant=variant))
    numbers = integers(seeds, "seeds").astype(np.int64)
    if numbers.shape != states.shape:
        raise ValueError(f"seeds must be {len(states)}, one for each state; got {numbers.shape}")
    bounded("edits", edits, 0, MOST_EDITS)
    check_word("kind", kind, Mutation)
    changed = np.array(states, STATE)
    edit_all(changed, variant.records(), numbers, int(edits), MUTATIONS.index(kind))
    return changed


@entry
def edit_all(states, params, seeds, edits, kind):
    """Edit every one of `states`, each by its own seed."""
    for i in range(states.shape[0]):
        edit_level(states[i], params, seeds[i], edits, kind)


@shared
def edit_level(s, params, seed, edits, kind):
    """Make `edits` edits of the level that `s` begins in."""
    seed_twister(s, seed)
    s.level = NEVER
    left, low = lower_left(s)
    for k in range(edits):
        drawn = below(s, WEIGHTS) if kind == BINOMIAL else edits - 1 - k
        if drawn == 0:
            if kind != IDENTITY:
                edit_goal(s, params)
        elif drawn == 1:
            edit_mouse(s, params[0], left, low)
        else:
            edit_wall(s, left, low)
    s.reached_goal, s.reached_corner, s.reached_other = NEVER, NEVER, NEVER
    note_arrivals(s)


@kernel
def edit_wall(s, left, low):
    """Open a cell of the maze, or close it if nothing is in it and all is still in reach.

    left, low  the maze's lower left cell
    """
    x, y = left + below(s, s.maze_size), low + below(s, s.maze_size)
    if s.cell[y, x] == WALL:
        s.cell[y, x] = EMPTY
    elif s.cell[y, x] == EMPTY and not is_taken(s, x, y):
        s.cell[y, x] = WALL
        if not is_whole(s):
            s.cell[y, x] = EMPTY


@kernel
def lower_left(s):
    """The lower left cell of the maze, which may be anywhere in the world where it was drawn."""
    x, y = s.corner_x, s.corner_y
    if x == NEVER:  # there is wall
        for row in range(s.world):
            for column in range(s.world):
                if s.cell[row, column] != WALL:
                    x, y = max(x, column), row
    return max(x - s.maze_size + 1, 0), max(y - s.maze_size + 1, 0)


@kernel
def edit_mouse(s, p, left, low):
    """Move the mouse, where it may start anywhere, or the other object, or change a wall."""
    moves_mouse, moves_other = p.start != 0, s.other_x != NEVER
    pick = below(s, 1 + moves_mouse + moves_other)
    if pick == 0:
        edit_wall(s, left, low)
        return
    x, y = free_cell(s)
    if x == NEVER:
        return
    if moves_mouse and pick == 1:
        s.x, s.y = x + 0.5, y + 0.5
        return
    what = s.cell[s.other_y, s.other_x]
    s.cell[s.other_y, s.other_x], s.cell[y, x] = EMPTY, what
    s.other_x, s.other_y = x, y
    if what == BOTH:
        s.goal_x, s.goal_y = x, y


@kernel
def edit_goal(s, params):
    """Place the goal as a new level does; it stays where the mouse is in its new place."""
    if s.goal_x == NEVER:
        return
    shifted = unit(s) < params[0].shift_probability
    p = params[1] if shifted else params[0]
    was_x, was_y = s.goal_x, s.goal_y
    was = s.cell[was_y, was_x]
    s.cell[was_y, was_x] = OTHER if was == BOTH else EMPTY
    if p.placement == CORNER:
        x, y = s.corner_x, s.corner_y
    elif p.placement == ON_OTHER:
        x, y = s.other_x, s.other_y
    elif p.placement == ANYWHERE:
        x, y = free_cell(s)
    else:
        x, y = free_cell_in(s, s.corner_x + 1 - p.region, s.corner_y + 1 - p.region)
    if x == NEVER or (x == int(s.x) and y == int(s.y)) or s.cell[y, x] == WALL:
        s.cell[was_y, was_x] = was
        return
    furnish(s, p)
    s.time_limit, s.shifted = p.time_limit, shifted
    s.cell[y, x] = BOTH if s.cell[y, x] == OTHER else GOAL
    s.goal_x, s.goal_y = x, y


@kernel
def is_taken(s, x, y):
    """The mouse is in cell (x, y), or it is the corner, which stays a proxy for the goal."""
    return (x == int(s.x) and y == int(s.y)) or (x == s.corner_x and y == s.corner_y)


@kernel
def is_whole(s):
    """The mouse can reach the goal, the other object and the corner, those that there are."""
    steps = distances(s.cell[: s.world, : s.world] != WALL, int(s.x), int(s.y))
    for x, y in ((s.goal_x, s.goal_y), (s.other_x, s.other_y), (s.corner_x, s.corner_y)):
        if x != NEVER and steps[y, x] == UNREACHABLE:
            return False
    return True


@kernel
def free_cell(s):
    """A cell drawn from those with nothing in them that the mouse can reach; NEVER, NEVER: none."""
    return free_cell_in(s, 0, 0)


@kernel
def free_cell_in(s, left, low):
    """`free_cell` of those from column `left` and row `low` on."""
    steps = distances(s.cell[: s.world, : s.world] != WALL, int(s.x), int(s.y))
    count = 0
    for y in range(max(low, 0), s.world):
        for x in range(max(left, 0), s.world):
            count += steps[y, x] > 0 and s.cell[y, x] == EMPTY  # 0: where the mouse is
    if count == 0:
        return NEVER, NEVER
    pick = below(s, count)
    for y in range(max(low, 0), s.world):
        for x in range(max(left, 0), s.world):
            if steps[y, x] > 0 and s.cell[y, x] == EMPTY:
                if pick == 0:
                    return x, y
                pick -= 1
    return NEVER, NEVER
