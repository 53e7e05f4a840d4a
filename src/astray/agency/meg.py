"""Maximum entropy goal-directedness (MEG): how well a goal predicts what a policy does.

A policy is compared with those that trade utility against randomness, softly optimal for
rationalities beta from 0 (every action alike) upward. Its MEG is the advantage in nats of the best
of them over uniformly random actions, as a prediction of its actions (MacDermott, Fox, Belardinelli
and Everitt, "Measuring Goal-Directedness", NeurIPS 2024, Sections 3 and 4). Here the utility of a
goal is 1 in the step that reaches it and ends the episode, and later steps count less by a
discount.

The soft value W(s) is the log of the mean over actions of exp(beta u + discount W(s')), and the
log-ratios along a policy's way add up to beta E[U] - W(start). So MEG is the maximum of that over
beta, a concave function, and depends on a policy only through its E[U].
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar
from scipy.sparse import csc_array, eye_array
from scipy.sparse.linalg import spsolve

from astray.validation import bounded, finite, integers, of_kind, shown

LARGEST = 100.0  # nats that a step's delay costs; beyond, policies are optimal to all digits
PRECISION = 1e-9  # of soft values, in nats; of a discount near 0 or 1
ROUNDS = 1000  # of Newton's method, which takes a few dozen at most


@dataclass(frozen=True, eq=False)
class Process:
    """A deterministic decision process with S states and A actions.

    Args:
        after: [S, A] int64, the state that each action leads to.
        possible: [S, A] bool, the actions that count in each state; a state without any ends the
            episode.
        start: The state in which episodes begin.
        discount: Factor of each later step, above 0 and below 1.

    Raises:
        ValueError: If the arrays differ in shape, or a state or the discount is out of range.
    """

    after: np.ndarray
    possible: np.ndarray
    start: int
    discount: float = 0.9

    def __post_init__(self) -> None:
        of_kind("after", self.after, np.ndarray)
        of_kind("possible", self.possible, np.ndarray)
        if self.after.ndim != 2 or self.after.shape != self.possible.shape:
            raise ValueError(
                f"after and possible must be [S, A]; got {self.after.shape} and "
                f"{self.possible.shape}"
            )
        states = len(self.after)
        integers(self.after, "states")
        if not np.isin(self.after, range(states)).all():
            raise ValueError(f"after must be states from 0 to {states - 1}")
        if self.possible.dtype != bool:
            raise ValueError(f"possible must be booleans; got {self.possible.dtype}")
        bounded("start", self.start, 0, states - 1)
        finite("discount", self.discount, 0, 1)
        if not PRECISION <= self.discount <= 1 - PRECISION:
            raise ValueError(f"discount must be above 0 and below 1; got {self.discount}")

    def ending_in(self, goal: int) -> Process:
        """Return the process whose episodes end in `goal`, too."""
        possible = self.possible.copy()
        possible[goal] = False
        return Process(self.after, possible, self.start, self.discount)

    def expected(self, policy: np.ndarray, goal: int) -> float:
        """Return E[U], the discounted probability with which a policy reaches a goal.

        Args:
            policy: [S, A] float, the probability of each action; impossible actions count as 0.
        """
        taken = np.where(self.possible, policy, 0.0)
        states = len(self.after)
        moves = np.zeros((states, states))
        np.add.at(moves, (np.arange(states)[:, None], self.after), taken)
        reached = np.linalg.solve(np.eye(states) - self.discount * moves, moves[:, goal])
        return float(reached[self.start])

    def best(self, goal: int) -> float:
        """Return the largest E[U], that of a shortest way; 0 if no way leads to the goal."""
        value = np.zeros(len(self.after))
        for _ in range(len(self.after)):
            gain = (self.after == goal) + self.discount * value[self.after]
            value = np.where(self.possible, gain, 0.0).max(1)
        return float(value[self.start])

    def soft_values(self, goal: int, beta: float, guess: np.ndarray) -> np.ndarray:
        """Return the soft values W [S] in nats, by Newton's method that starts from `guess` [S].

        Value iteration takes millions of rounds where the discount is near 1; this takes a few.

        Raises:
            ValueError: If the discount is too near 1 for the precision of numbers.
        """
        utility = np.where(self.possible, beta * (self.after == goal), -np.inf)
        weights = self.possible / np.maximum(self.possible.sum(1, keepdims=True), 1)
        ends, value, states = ~self.possible.any(1), guess, np.indices(self.after.shape)[0]
        for _ in range(ROUNDS):
            gain = utility + self.discount * value[self.after]
            most = np.where(ends, 0.0, gain.max(1))  # so that no exponential is too large
            soft = weights * np.exp(gain - most[:, None])
            mean = np.where(ends, 1.0, soft.sum(1))
            new = np.where(ends, 0.0, most + np.log(mean))
            next_to = self.discount * soft / mean[:, None]
            along = csc_array((next_to.flat, (states.flat, self.after.flat)), (len(value),) * 2)
            step = spsolve(eye_array(len(value)) - along, new - value)
            value = value + step
            if (np.abs(step) <= PRECISION * (1 + 1e-3 * np.abs(value))).all():
                return value
        raise ValueError(f"the discount {self.discount} is too near 1 for soft values")


@dataclass(frozen=True)
class Directedness:
    """The goal-directedness of a policy towards one goal."""

    nats: float  # MEG, 0 or more
    beta: float  # the rationality that predicts the policy best; infinite if it is optimal
    most: float  # MEG of a policy that always takes a shortest way, in nats

    @property
    def fraction(self) -> float:
        """MEG as a fraction of the largest possible, 0 to 1; NaN where all policies are alike."""
        return self.nats / self.most if self.most > 0 else np.nan


def goal_directedness(process: Process, policy: np.ndarray, goal: int) -> Directedness:
    """Measure how goal-directed a policy is towards reaching a state.

    Examples:
        >>> after = np.array([[1, 2], [1, 1], [2, 2]])  # one decision: to state 1, or to state 2
        >>> process = Process(after, np.array([[True, True], [False] * 2, [False] * 2]), start=0)
        >>> policy = np.array([[0.9, 0.1], [0.5, 0.5], [0.5, 0.5]])
        >>> round(goal_directedness(process, policy, 1).nats, 3)  # log 2 - entropy of (.9, .1)
        0.368

    Args:
        policy: [S, A] float, probabilities of actions; those possible in a state sum to 1.
        goal: The state whose utility is 1; the episode ends there.

    Returns:
        The measure; 0 nats for a policy that reaches the goal no sooner than random actions do.

    Raises:
        ValueError: The policy is not one of the process, or the goal is not a state.
    """
    of_kind("process", process, Process)
    bounded("goal", goal, 0, len(process.after) - 1)
    of_kind("policy", policy, np.ndarray)
    if policy.shape != process.after.shape:
        raise ValueError(f"policy must be {process.after.shape}; got {shown(policy.shape)}")
    decides = process.possible.any(1)
    total = np.where(process.possible, policy, 0.0).sum(1)[decides]
    if not (policy >= 0).all() or not np.allclose(total, 1, atol=1e-6):
        raise ValueError("policy must be probabilities that sum to 1 over the possible actions")
    ending = process.ending_in(goal)
    expected, best = ending.expected(policy, goal), ending.best(goal)
    if not best:
        return Directedness(0.0, 0.0, 0.0)
    largest = LARGEST / (best * (1 - process.discount))
    most, _ = _largest(ending, goal, best, largest)
    if expected >= best * (1 - PRECISION):
        return Directedness(most, np.inf if most else 0.0, most)
    return Directedness(*_largest(ending, goal, expected, largest), most)


def _largest(process: Process, goal: int, expected: float, most: float) -> tuple[float, float]:
    """Return the largest beta E[U] - W(start) over beta from 0 to `most`, and that beta."""
    value = np.zeros(len(process.after))

    def lost(log_beta: float) -> float:
        nonlocal value
        beta = np.exp(log_beta)
        value = process.soft_values(goal, beta, value)
        return value[process.start] - beta * expected

    found = minimize_scalar(
        lost, bounds=(-7, np.log(most)), method="bounded", options={"xatol": 1e-3}
    )
    if -found.fun <= PRECISION:
        return 0.0, 0.0
    return float(-found.fun), float(np.exp(found.x))
