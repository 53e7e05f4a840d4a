"""Maze: a mouse walks one cell per step; the goal object is worth 10 and ends the level."""

import numpy as np

from astray.kernel.grid import ACTIONS as ACTIONS
from astray.kernel.grid import push
from astray.kernel.jit import kernel
from astray.kernel.maze import is_wall
from astray.record import first, state_dtype

LARGEST = 31  # cells a side of the largest world
EMPTY, GOAL, OTHER, BOTH = 0, 2, 3, 4  # what is in a cell, if not WALL; BOTH: goal on other
REWARD = 10.0

EVENTS = ("reached_goal", "reached_corner", "reached_other")
STATE = state_dtype(
    ("cell", np.uint8, (LARGEST, LARGEST)),  # at [y, x]; the world is [:world, :world]
    ("world", np.int64),  # cells a side
    ("maze_size", np.int64),  # cells a side of the maze, in the middle of the world
    ("window", np.int64),  # cells a side of the window around the mouse; 0: the whole world
    ("x", np.float64), ("y", np.float64),  # the mouse's centre, in cells
    ("faces_right", np.bool_),
    ("goal_x", np.int64), ("goal_y", np.int64),  # its cell; NEVER where there is none
    ("other_x", np.int64), ("other_y", np.int64),
    ("corner_x", np.int64), ("corner_y", np.int64),  # the maze's upper right cell
    ("goal_shape", np.int64), ("goal_colour", np.int64),
    ("other_shape", np.int64), ("other_colour", np.int64),
    ("walls", np.int64),  # their look
    ("background", np.int64),
    ("background_offset", np.float64),  # from 0 to 1: which part of the floor is seen
    events=EVENTS,
)  # fmt: skip


@kernel
def step(s, action):
    """Move the mouse; return the reward and whether the goal was reached."""
    dx, dy = push(action)
    if dx != 0:
        dy = 0  # the original steps in x first, and then no more
        s.faces_right = dx > 0
    x, y = int(s.x) + dx, int(s.y) + dy
    if not is_wall(s, x, y):
        s.x, s.y = x + 0.5, y + 0.5
    note_arrivals(s)
    reached = s.reached_goal == s.time
    if reached:
        s.cell[s.goal_y, s.goal_x] = OTHER if s.cell[s.goal_y, s.goal_x] == BOTH else EMPTY
    return REWARD * reached, reached


@kernel
def note_arrivals(s):
    """Record the step of each event that happens for the first time."""
    x, y = int(s.x), int(s.y)
    s.reached_goal = first(s, s.reached_goal, x == s.goal_x and y == s.goal_y)
    s.reached_corner = first(s, s.reached_corner, x == s.corner_x and y == s.corner_y)
    s.reached_other = first(s, s.reached_other, x == s.other_x and y == s.other_y)
