"""One episode from within: value, policy, advantage and visible objects, step by step.

`along(agent, "coin-anywhere", 200_003).table` has a row for each step, and `figure` draws it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import polars as pl
import torch
from matplotlib.figure import Figure

from astray import games
from astray.acting import steps
from astray.analysis.critic import policy_and_value
from astray.analysis.evaluate import Measure, measured
from astray.analysis.trained import Model, Opaque
from astray.figures import charts
from astray.figures.axes import name_rows
from astray.game import Variant
from astray.level import Level
from astray.training import ppo
from astray.validation import finite, of_kind

GAMMA, LAMBDA = 0.999, 0.95  # the paper's
LIKELY = 0.02  # mean probability that an action has to be drawn by itself
MOST_SHOWN = 5  # actions
STILL = 8  # steps in one or two places, after which the rest of an episode there is not drawn
ADVANTAGE, POLICY, TRUE = "advantage of the action taken", "policy", "labels that hold"


@dataclass(frozen=True, eq=False)
class Course:
    """An episode of T steps with the agent's outputs.

    Attributes:
        table: A row per step: step, x and y (of the agent before it, in cells), value, reward,
            advantage (generalised, of the taken action), action, its name, the marks, and each
            action's probability under its name.
        states: [T] states before each step.
        events: Step at which each first happened; None for never.
        marks: Columns of the table for visible objects.
        actions: Columns of probabilities.
    """

    table: pl.DataFrame
    states: np.ndarray
    events: Mapping[str, int | None]
    marks: tuple[str, ...]
    actions: tuple[str, ...]

    @property
    def idle(self) -> int:
        """Number of last steps, beyond the first few, that it stays in its last two places."""
        if not {"x", "y"} <= {*self.table.columns}:
            return 0
        places = self.table.select("x", "y").rows()
        elsewhere = [k for k, place in enumerate(places) if place not in places[-2:]]
        return max(0, len(places) - 1 - max(elsewhere, default=-1) - STILL)


def along(
    agent: Model | Opaque,
    variant: str | Variant,
    level: int | Level,
    *,
    marks: Mapping[str, Measure] | None = None,
    gamma: float = GAMMA,
    lam: float = LAMBDA,
    deviation: float | None = None,
) -> Course:
    """Play an agent's episode in a level and record its outputs at every step.

    Args:
        marks: Boolean functions of states, such as whether a coin is in view; None for the game's
            boolean labels.
        deviation: Reward-normalisation scale of its training (`AgentFolder.deviation`), the unit
            of values and advantages; None if rewards were not normalised.

    Raises:
        ValueError: If a mark is not boolean.
    """
    of_kind("agent", agent, Model | Opaque)
    finite("gamma", gamma, 0, 1)
    finite("lam", lam, 0, 1)
    if deviation is not None:
        finite("deviation", deviation, 1e-9)
    game = games.find(agent.game)  # pyrefly: ignore
    levels = {"level": level} if isinstance(level, Level) else [level]
    played = list(steps(agent, game, variant, levels, batch=1))
    before = np.concatenate([step.before for step in played])
    rewards = np.concatenate([step.rewards for step in played])
    learned = rewards
    if deviation is not None:
        learned = ppo.RewardNormaliser(1, variance=deviation**2).scaled(rewards)
    actions = np.concatenate([step.actions for step in played])
    last = played[-1]
    if isinstance(agent, Opaque):  # all that is known is what it did
        policy, value = np.eye(len(game.actions))[actions], np.full(len(actions) + 1, np.nan)
    else:
        shown = np.concatenate([s.observations for s in played] + [last.seen])
        policy, value = policy_and_value(agent, shown, episode=True)
    given = dict(game.labels) if marks is None else dict(marks)
    known = {name: measured(name, mark, before) for name, mark in given.items()}
    odd = [name for name, column in known.items() if column.dtype != pl.Boolean]
    if marks is not None and odd:
        raise ValueError(f"marks must be true or false; {', '.join(odd)} are not")
    known = {name: column for name, column in known.items() if name not in odd}
    one = {axis: before[axis] for axis in "xy" if axis in (before.dtype.names or ())}
    table = pl.DataFrame(
        {"step": before["time"]}
        | one
        | {
            "value": value[:-1],
            "reward": rewards,
            "advantage": _advantages(learned, value, bool(last.terminated[0]), gamma, lam),
            "action": actions,
            "name": [game.actions[k] for k in actions],
        }
        | known
        | {name: policy[: len(actions), k] for k, name in enumerate(game.actions)}
    )
    final = last.after[0]
    events = {e: int(final[e]) if final[e] >= 0 else None for e in game.events}
    return Course(table, before, events, tuple(known), tuple(game.actions))


def _advantages(
    rewards: np.ndarray, value: np.ndarray, terminated: bool, gamma: float, lam: float
) -> np.ndarray:
    """Return generalised advantages [T], given values [T + 1] including the last state's."""
    last = torch.from_numpy(np.arange(len(rewards))[:, None] == len(rewards) - 1)
    ends, cut = last & terminated, last & (not terminated)
    reward, now, after = (torch.from_numpy(x)[:, None] for x in (rewards, value[:-1], value[1:]))
    return ppo.advantages(reward, now, after, ends, cut, gamma, lam)[:, 0].numpy()


def figure(course: Course) -> Figure:
    """Plot value, advantage, policy and visible objects along an episode."""
    table = course.table.head(len(course.table) - course.idle)
    marks = [name for name in course.marks if table[name].any()]
    chances = table.select(course.actions).to_numpy().T
    order = np.argsort(-chances.mean(1))[:MOST_SHOWN]
    likely = {course.actions[k]: chances[k] for k in order if chances[k].mean() >= LIKELY}
    lines: dict[tuple[str, str], Any] = {}
    if not table["value"].is_nan().all():
        lines = {("value", "value"): table["value"], (ADVANTAGE, ADVANTAGE): table["advantage"]}
    lines |= {(POLICY, name): chance for name, chance in likely.items()}
    lines[POLICY, "other actions"] = np.ones(len(table)) - sum(likely.values())
    parts = [_line(*names, table["step"], values) for names, values in lines.items()]
    for k, name in enumerate(marks):  # a row each, from each step to the next
        seen = np.where(table[name], k, np.nan)  # broken where it is not so
        ends = np.stack([table["step"], table["step"] + 1], 1).ravel()
        parts.append(_line(TRUE, name, ends, seen.repeat(2)))
    happened = {
        name.replace("_", " "): k
        for name, k in course.events.items()
        if k is not None and k <= len(table)
    }
    drawn = charts.curves(
        pl.concat(parts), x="step", line="line", panel="panel", label="", x_label="step",
        at=happened, columns=1, sharey=False,
    )  # fmt: skip
    if marks:
        name_rows(drawn.axes[-1], marks)
    return drawn


def _line(panel: str, name: str, step: Any, values: Any) -> pl.DataFrame:
    mean = np.asarray(values, float)
    return pl.DataFrame({"step": step, "mean": mean, "panel": panel, "line": name})
