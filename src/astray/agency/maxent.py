"""Maximum-entropy agents: shorter ways are more likely, without being greedy.

Every step costs c = -ln w, and the agent trades cost against deviation from a random walk (a
linearly solvable decision problem, Todorov 2006; the likelihood p ~ exp(R) of Langosco et al.,
Section 2). w -> 1 is the random walk; w -> 0 takes all shortest ways equally often.
"""

import numpy as np

from astray.agency.gridworld import Trajectory, World
from astray.validation import NUMBERS, of_kind


def log_likelihood(
    world: World, trajectory: Trajectory, w: float, *, legal: bool = False
) -> np.ndarray:
    """Return log p(trajectory | goal, w) for every free cell as goal, [F]; -inf without a way.

    The policy is P(a|s) w z(s') / z(s) with z = 1 on the goal, where P is the random walk. The
    result therefore depends only on the trajectory's ends and length. After the first visit to the
    goal the policy is the random walk.

    Args:
        w: Weight of a step, in (0, 1).
        legal: Whether only moves that change the cell are actions.

    Raises:
        ValueError: If w is out of range, or the trajectory is of another world.
    """
    if not isinstance(w, NUMBERS) or not 0 < w < 1:
        raise ValueError(f"w must be between 0 and 1; got {w}")
    of_kind("legal", legal, bool)
    world.check(trajectory)
    cells, steps = trajectory.cells, len(trajectory)
    log_z = _log_z(world, w, legal)
    actions = world.legal.sum(1) if legal else np.full(len(world), world.legal.shape[1])
    log_walk = -np.log(actions[cells[:-1]])
    if legal and (cells[1:] == cells[:-1]).any():
        raise ValueError("only moves that change the cell are actions; see `World.moves`")
    visited = cells[:, None] == np.arange(len(world))
    hit = np.where(visited.any(0), visited.argmax(0), steps)  # [F] steps to the first visit
    goals = np.arange(len(world))
    log_end, log_start = log_z[cells[hit], goals], log_z[cells[0]]
    reachable = np.isfinite(world.distance[cells[0]])
    with np.errstate(invalid="ignore"):
        pursued = hit * np.log(w) + log_end - log_start
    return np.where(reachable, log_walk.sum() + pursued, -np.inf)


def _log_z(world: World, w: float, legal: bool) -> np.ndarray:
    """Return log z [F, F] of each cell for each goal: z = G(s, g) / G(g, g), G = (I - w P)^-1."""
    count = len(world)
    walk = np.zeros((count, count))
    here = np.broadcast_to(np.arange(count)[:, None], world.after.shape)
    used = world.legal if legal else np.ones_like(world.legal)
    fraction = used / np.maximum(used.sum(1, keepdims=True), 1)
    np.add.at(walk, (here, world.after), fraction)
    green = np.linalg.inv(np.eye(count) - w * walk)
    lost = np.isfinite(world.distance) & (green < 1e-290)
    if lost.any():
        far = world.distance[lost].min()
        raise ValueError(f"w = {w:.2g} is too small for ways of {far:g} steps in this world")
    with np.errstate(divide="ignore"):
        return np.log(np.where(np.isfinite(world.distance), green, 0.0) / np.diag(green))
