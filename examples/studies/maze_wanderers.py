"""Rates at which three simple wanderers reach the cheese in the memory mazes.

In `anywhere-memory`, a maze has 3 to 31 cells a side, and a mouse sees 8 x 8 of them. All three
wanderers take the shortest way to a cheese that is in view. Otherwise the first forgets everything
and steps anywhere, the second does not turn back unless it must, and the third keeps a hand on the
wall. The mice of `astray reproduce maze-memory --size night` are tested in the same levels.

    python examples/studies/maze_wanderers.py
"""

import numpy as np

from astray.analysis.estimates import Estimate, estimate_mean
from astray.envs.beginnings import initial_states
from astray.experiments import catalogue
from astray.experiments.levels import levels_of
from astray.games.maze.solve import steps_to
from astray.kernel.grid import UNREACHABLE

VARIANT = "anywhere-memory"
STEPS = ((1, 0), (0, 1), (-1, 0), (0, -1))  # right, up, left, down: x to the right, y upward
BACK = 2  # turns of a quarter


def forgets(heading: int, rng: np.random.Generator) -> list[int]:
    """Return directions in the order of preference: none is preferred."""
    return rng.permutation(4).tolist()


def turns_back_last(heading: int, rng: np.random.Generator) -> list[int]:
    """Return any order in which going back comes last."""
    back = (heading + BACK) % 4
    return [*(way for way in rng.permutation(4).tolist() if way != back), back]


def keeps_to_the_wall(heading: int, rng: np.random.Generator) -> list[int]:
    """Return the order of a mouse with its left hand on the wall."""
    return [(heading + turn) % 4 for turn in (1, 0, 3, BACK)]


def reaches(state, wanderer, rng: np.random.Generator) -> bool:
    """Return whether a wanderer comes to the cheese before the time is up."""
    away = steps_to(state, "cheese")
    x, y, heading = int(state.x), int(state.y), int(rng.integers(4))
    half = int(state.window) // 2
    for _ in range(int(state.time_limit)):
        sees = -half <= state.goal_x - x < half and -half <= state.goal_y - y < half
        order = range(4) if sees else wanderer(heading, rng)
        there = [(way, x + STEPS[way][0], y + STEPS[way][1]) for way in order]
        open_ = [
            (way, i, j)
            for way, i, j in there
            if 0 <= i < state.world and 0 <= j < state.world and away[j, i] != UNREACHABLE
        ]
        heading, x, y = min(open_, key=lambda one: away[one[2], one[1]]) if sees else open_[0]
        if away[y, x] == 0:
            return True
    return False


def rate(wanderer, levels: range | np.ndarray, seed: int = 0) -> Estimate:
    """Estimate how often a wanderer reaches the cheese, with an interval over levels."""
    states = initial_states("maze", VARIANT, levels)
    rng = np.random.default_rng(seed)
    return estimate_mean(np.array([[reaches(state, wanderer, rng) for state in states]]))


if __name__ == "__main__":
    plan = catalogue.load("maze-memory").sizes["night"]
    (test,) = plan.tests.values()
    levels = levels_of(plan, test)
    for wanderer in (forgets, turns_back_last, keeps_to_the_wall):
        found = rate(wanderer, levels)
        told = f"{100 * found.mean:.1f} % ({100 * found.low:.1f} to {100 * found.high:.1f})"
        print(f"{wanderer.__name__.replace('_', ' ')}: {told}")
