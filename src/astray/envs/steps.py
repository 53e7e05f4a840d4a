"""A step of several episodes, what it is worth, and rows of what episodes have."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.spaces import Discrete

from astray.imports import guarded
from astray.validation import shown


@dataclass(frozen=True, eq=False)
class Step:
    """One step of each running episode, [n].

    An episode's first step is the one after its level began; `ended` is true in its last one.

    Attributes:
        level: [n], position of the level in the given order.
        before: [n] states in which the step began; the policy saw `observations` of them.
        after: [n] states after the step, valid until the next step; `seen` are observations of
            them.
        extra: Arrays [n] that the policy recorded with the step, by name.
    """

    level: np.ndarray
    before: np.ndarray
    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    after: np.ndarray
    seen: np.ndarray
    terminated: np.ndarray
    ended: np.ndarray  # terminated, truncated, or an event of `until` happened
    extra: Mapping[str, np.ndarray]

    def of(self, which: np.ndarray) -> Step:
        """Return the step restricted to some episodes, `which` [n] bool."""
        return Step(**rows(vars(self), which))


# A reward of one's own, for training and evaluation: the rewards [n] of a step. The game's are
# `step.rewards`, which it may replace or add to.
Reward = Callable[[Step], np.ndarray]


def paid(reward: Reward, step: Step) -> np.ndarray:
    """Return a reward of the user's own, [n] float64.

    Raises:
        ValueError: If it is anything but n finite numbers.
    """
    with guarded(f"the reward {shown(reward)}", ValueError, ImportError):
        given = reward(copy.deepcopy(step))  # it may write to it
    found, n = np.asarray(given), len(step.rewards)  # which forgets a mask
    fits = found.shape == (n,) and found.dtype.kind in "biuf" and not np.ma.is_masked(given)
    if not fits or not np.isfinite(found).all():
        raise ValueError(
            f"a reward must return {n} finite numbers, one for each episode of the step; got "
            f"{shown(given)}"
        )
    return found.astype(np.float64)


def choices(who: str, chosen: Any, n: int, space: Discrete) -> np.ndarray:
    """Return actions [n] int64; raise ValueError, naming the policy `who`, if any is invalid."""
    chosen, low, high = np.asarray(chosen), int(space.start), int(space.start + space.n) - 1
    if chosen.shape != (n,) or not np.issubdtype(chosen.dtype, np.integer):
        raise ValueError(
            f"{who} must return integers [{n}], an action for each observation; got "
            f"{chosen.dtype} of shape {chosen.shape}"
        )
    if n and (chosen.min() < low or chosen.max() > high):
        raise ValueError(
            f"actions of {who} must be from {low} to {high}; got {chosen.min()} to {chosen.max()}"
        )
    return chosen.astype(np.int64)  # few bits overflow where an environment computes with them


def rows(memory: Any, kept: np.ndarray) -> Any:
    """Return the rows `kept` [n] of a policy's memory [N, ...]."""
    if isinstance(memory, Mapping):
        return {name: rows(part, kept) for name, part in memory.items()}
    if isinstance(memory, tuple | list):
        parts = [rows(part, kept) for part in memory]
        return type(memory)(*parts) if hasattr(memory, "_fields") else type(memory)(parts)
    return None if memory is None else memory[kept]


def check_rows(memory: Any, n: int) -> None:
    """Raise ValueError unless a policy's memory has one row for each of `n` episodes."""
    if isinstance(memory, Mapping | tuple | list):
        for part in memory.values() if isinstance(memory, Mapping) else memory:
            check_rows(part, n)
    elif memory is not None and tuple(getattr(memory, "shape", ()))[:1] != (n,):
        raise ValueError(
            f"a policy's memory must be arrays or tensors of {n} rows, one per episode; got "
            f"{getattr(memory, 'shape', shown(memory))}"
        )
