"""One episode from within: value, policy, advantage and visible objects, step by step.

found = along(agent, "coin-anywhere", 200_003)
found.table  # a row for each step
figure(found)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import matplotlib
import numpy as np
import polars as pl
import torch
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from astray import games
from astray.acting import steps
from astray.analysis.critic import policy_and_value
from astray.analysis.given import Measure, measured
from astray.analysis.trained import Agent
from astray.bounds import finite, of_kind
from astray.game import Variant
from astray.level import Level
from astray.report.style import FAINT, INK, OTHERS, STYLE, WIDTH
from astray.training import ppo

GAMMA, LAMBDA = 0.999, 0.95  # the paper's
LIKELY = 0.02  # mean probability that an action has to be drawn by itself
MOST_SHOWN = 5  # actions


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


def along(
    agent: Agent,
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
    of_kind("agent", agent, Agent)
    finite("gamma", gamma, 0, 1)
    finite("lam", lam, 0, 1)
    if deviation is not None:
        finite("deviation", deviation, 1e-9)
    game = games.find(agent.game)
    levels = {"level": level} if isinstance(level, Level) else [level]
    played = list(steps(agent, game, variant, levels, batch=1))
    before = np.concatenate([step.before for step in played])
    rewards = np.concatenate([step.rewards for step in played])
    learned = rewards
    if deviation is not None:
        learned = ppo.RewardNormaliser(1, variance=deviation**2).scaled(rewards)
    actions = np.concatenate([step.actions for step in played])
    last = played[-1]
    policy, value = policy_and_value(
        agent, np.concatenate([s.observations for s in played] + [last.seen])
    )
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
        | {name: policy[:-1, k] for k, name in enumerate(game.actions)}
    )
    final = last.after[0]
    events = {e: int(final[e]) if final[e] >= 0 else None for e in game.events}
    return Course(table, before, events, tuple(known), tuple(game.actions))


def _advantages(
    rewards: np.ndarray, value: np.ndarray, terminated: bool, gamma: float, lam: float
) -> np.ndarray:
    """Return generalised advantages [T], given values [T + 1] including the last state's."""
    count = len(rewards)
    ends = torch.zeros((count, 1), dtype=torch.bool)
    ends[-1] = terminated
    cut = torch.zeros_like(ends)
    cut[-1] = not terminated
    found = ppo.advantages(
        torch.from_numpy(rewards)[:, None],
        torch.from_numpy(value[:-1])[:, None],
        torch.from_numpy(value[1:])[:, None],
        ends,
        cut,
        gamma,
        lam,
    )
    return found[:, 0].numpy()


@matplotlib.rc_context(STYLE)
def figure(course: Course) -> Figure:
    """Draw value, advantage and policy along an episode.

    Bars below show visible objects, lines show events.
    """
    table, marks = course.table, course.marks
    shown = Figure(figsize=(WIDTH, 5.6 + 0.22 * len(marks)))
    heights = [1.3, 1, 1.3, max(0.2 * len(marks), 0.05)]
    value, advantage, policy, view = shown.subplots(4, 1, sharex=True, height_ratios=heights)
    step = table["step"].to_numpy()
    value.plot(step, table["value"], color=OTHERS[0], linewidth=1.8)
    value.set_title("value")
    advantage.bar(
        step, table["advantage"], 1.0, color=np.where(table["advantage"] >= 0, OTHERS[0], OTHERS[1])
    )
    advantage.axhline(0, color=INK, linewidth=0.8)
    advantage.set_title("advantage of the action taken")
    _policy(policy, table, course.actions)
    for k, name in enumerate(marks):
        spans = _spans(table[name].to_numpy(), step)
        view.broken_barh(spans, (len(marks) - 1 - k + 0.15, 0.7), color=OTHERS[k % len(OTHERS)])
    view.set_yticks([len(marks) - 0.5 - k for k in range(len(marks))], list(marks))
    view.set_ylim(0, max(len(marks), 1))
    view.tick_params(length=0)
    view.spines[["left"]].set_visible(False)
    view.set_xlabel("step")
    for name, when in course.events.items():
        if when is not None:
            for axes in (value, advantage, policy, view):
                axes.axvline(when, color=INK, linestyle=":", linewidth=1)
            value.annotate(
                name.replace("_", " "),
                (when, 1.0),
                (-3, -2),
                ha="right",
                va="top",
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                fontsize=8.5,
                rotation=90,
            )
    value.set_xlim(step[0], step[-1] + 1)
    return shown


def _policy(axes: Axes, table: pl.DataFrame, names: Sequence[str]) -> None:
    """Draw the most likely actions as stacked bands, and the others as one."""
    chances = table.select(names).to_numpy().T
    order = np.argsort(-chances.mean(1))[:MOST_SHOWN]
    order = [k for k in order if chances[k].mean() >= LIKELY]
    bands = [chances[k] for k in order] + [1 - sum(chances[k] for k in order)]
    colours = [*[*OTHERS, "#4c9f8a"][: len(order)], FAINT]
    axes.stackplot(
        table["step"],
        *bands,
        labels=[*(str(names[k]) for k in order), "others"],
        colors=colours,
        step="post",
    )
    axes.set_ylim(0, 1)
    axes.set_title("policy")
    axes.legend(loc="upper left", bbox_to_anchor=(1, 1.05), fontsize=8.5)


def _spans(true: np.ndarray, step: np.ndarray) -> list[tuple[int, int]]:
    """Return the runs in which `true` [T] holds, as (first step, length)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(int)))
    return [(int(step[a]), int(b - a)) for a, b in edges.reshape(-1, 2)]
