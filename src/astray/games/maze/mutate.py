"""Small edits of Maze levels: walls, the mouse, the objects."""

import functools

import numpy as np

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
from astray.validation import bounded, integers, of_kind, one_of

CONSTANT, IDENTITY, BINOMIAL = range(len(MUTATIONS))
WEIGHTS = 12  # of a binomial edit: 1 the goal, 1 the mouse, 10 a wall


def mutate(
    states: np.ndarray, variant: Variant, seeds: np.ndarray, edits: int, kind: Mutation
) -> np.ndarray:
    """Return copies of initial states [N] with `edits` edits each; their level is NEVER.

    An edit toggles a cell of the maze; or moves the mouse or the other object, or toggles a wall,
    with equal probability; or places the goal as a new level of `variant` does, shifted with its
    shift_probability. A goal on a dish moves with the dish. Walls that would cut the mouse off
    from the goal, the other object or the corner are not built. A maze keeps these, or none.

    Args:
        seeds: [N] uint32, which determine the edits.
        kind: "constant" edits walls, and with the last two edits the mouse and the goal;
            "identity" is the same without the goal; "binomial" draws each edit, goal and mouse 1
            in 12 each.

    Raises:
        ValueError: If states are invalid, or there is not one seed per state.
    """
    of_kind("variant", variant, Maze)
    check_states(states, "maze", rules, functools.partial(invariants, variant=variant))
    numbers = integers(seeds, "seeds")
    if numbers.shape != states.shape:
        raise ValueError(f"seeds must be {len(states)}, one for each state; got {numbers.shape}")
    for seed in map(int, (numbers.min(initial=0), numbers.max(initial=0))):
        bounded("seeds", seed, 0, 2**32 - 1)  # the twister takes a larger one as another
    bounded("edits", edits, 0, MOST_EDITS)
    one_of("kind", kind, Mutation)
    changed, numbers = np.array(states, STATE), numbers.astype(np.int64)
    edit_all(changed, variant.records(), numbers, int(edits), MUTATIONS.index(kind))
    return changed


@entry
def edit_all(states, params, seeds, edits, kind):
    """Edit each of `states` with its own seed."""
    for i in range(states.shape[0]):
        edit_level(states[i], params, seeds[i], edits, kind)


@shared
def edit_level(s, params, seed, edits, kind):
    """Make `edits` edits of the level that `s` begins in."""
    seed_twister(s, seed)
    s.level = NEVER
    right, top = upper_right(s)
    for k in range(edits):
        drawn = below(s, WEIGHTS) if kind == BINOMIAL else edits - 1 - k
        if drawn == 0:
            if kind != IDENTITY:
                edit_goal(s, params)
        elif drawn == 1:
            edit_mouse(s, params[0], right, top)
        else:
            edit_wall(s, right, top)
    s.reached_goal, s.reached_corner, s.reached_other = NEVER, NEVER, NEVER
    note_arrivals(s)


@kernel
def edit_wall(s, right, top):
    """Open a cell of the maze, or close it if it is empty and everything stays reachable.

    The maze ends at column `right` and row `top`, which stay as they are if their common cell is
    wall: there is no corner then, and edits must not make one.
    """
    columns, rows = min(s.maze_size, right + 1), min(s.maze_size, top + 1)
    x, y = right + 1 - columns + below(s, columns), top + 1 - rows + below(s, rows)
    if s.corner_x == NEVER and (x == right or y == top):
        return
    if s.cell[y, x] == WALL:
        s.cell[y, x] = EMPTY
    elif s.cell[y, x] == EMPTY and (x != int(s.x) or y != int(s.y)):
        s.cell[y, x] = WALL
        if not is_whole(s):
            s.cell[y, x] = EMPTY


@kernel
def upper_right(s):
    """Return the last column and the highest row of a maze, which may be anywhere in the world."""
    x, y = s.corner_x, s.corner_y
    if x == NEVER:  # there is wall
        free = np.argwhere(s.cell[: s.world, : s.world] != WALL)
        x, y = free[:, 1].max(), free[-1, 0]
    return x, y


@kernel
def edit_mouse(s, p, right, top):
    """Move the mouse, if it can start anywhere, or the other object, or toggle a wall."""
    moves_mouse, moves_other = p.start != 0, s.other_x != NEVER
    pick = below(s, 1 + moves_mouse + moves_other)
    if pick == 0:
        edit_wall(s, right, top)
        return
    x, y = free_cell(s, 0, 0)
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
    """Place the goal as in a new level; it stays if its new place is taken or cut off."""
    if s.goal_x == NEVER:
        return
    is_alike = (params[0].other_shape > 0) == (params[1].other_shape > 0)  # else it keeps its kind
    shifted = unit(s) < params[0].shift_probability if is_alike else s.shifted
    p = params[1] if shifted else params[0]
    was_x, was_y = s.goal_x, s.goal_y
    was = s.cell[was_y, was_x]
    s.cell[was_y, was_x] = OTHER if was == BOTH else EMPTY
    if p.placement == CORNER:
        x, y = s.corner_x, s.corner_y
    elif p.placement == ON_OTHER:
        x, y = s.other_x, s.other_y
    elif p.placement == ANYWHERE:
        x, y = free_cell(s, 0, 0)
    else:
        x, y = free_cell(s, s.corner_x + 1 - p.region, s.corner_y + 1 - p.region)
    steps = distances(s.cell[: s.world, : s.world] != WALL, int(s.x), int(s.y))
    wanted = OTHER if p.placement == ON_OTHER else EMPTY
    if x == NEVER or s.cell[y, x] != wanted or steps[y, x] <= 0:  # 0: where the mouse is
        s.cell[was_y, was_x] = was
        return
    furnish(s, p)
    s.time_limit, s.shifted = p.time_limit, shifted
    s.cell[y, x] = BOTH if s.cell[y, x] == OTHER else GOAL
    s.goal_x, s.goal_y = x, y


@kernel
def is_whole(s):
    """Return whether the mouse can reach the goal, the other object and the corner, if present."""
    steps = distances(s.cell[: s.world, : s.world] != WALL, int(s.x), int(s.y))
    for x, y in ((s.goal_x, s.goal_y), (s.other_x, s.other_y), (s.corner_x, s.corner_y)):
        if x != NEVER and steps[y, x] == UNREACHABLE:
            return False
    return True


@kernel
def free_cell(s, left, low):
    """Draw an empty cell that the mouse can reach, from `left` and `low` on; or NEVER, NEVER."""
    cells, left, low = s.cell[: s.world, : s.world], max(left, 0), max(low, 0)
    steps = distances(cells != WALL, int(s.x), int(s.y))
    free = np.argwhere((steps > 0) & (cells == EMPTY))  # 0: where the mouse is
    free = free[(free[:, 0] >= low) & (free[:, 1] >= left)]
    if len(free) == 0:
        return NEVER, NEVER
    k = below(s, len(free))
    return free[k, 1], free[k, 0]
