"""Policies at play: the one loop that all episodes of all studies come from.

for step in steps(policy, "maze", "anywhere", range(1000)):
    lengths[step.level[step.ended]] = step.after["time"][step.ended]
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence, Sized
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from astray import games
from astray.analysis.given import see_policy
from astray.bounds import MOST, bounded, of_kind
from astray.envs.vector import GameVectorEnv
from astray.game import Game, Variant
from astray.level import Level
from astray.record import level_numbers

if TYPE_CHECKING:  # levels are printed without torch, which takes seconds to import
    from astray.analysis.policies import Policy

Levels = Sequence[int] | np.ndarray | range | Mapping[str, Level]
CHUNK = 1000  # levels begun at once


@dataclass(frozen=True, eq=False)
class Step:
    """One step of each of the episodes under way, [n].

    level   which of the levels, by its place in the order that they were given in
    before  the states that the step began in; `observations` of them are what the policy saw
    after   those that it led to, which are valid till the next step, and `seen` of them

    An episode's first step comes once its level is begun, its last one with `ended`.
    """

    level: np.ndarray
    before: np.ndarray
    observations: np.ndarray
    actions: np.ndarray
    rewards: np.ndarray
    after: np.ndarray
    seen: np.ndarray
    terminated: np.ndarray
    ended: np.ndarray  # terminated, or the time was up, or what was played until happened


def steps(
    policy: Policy,
    game: str | Game,
    variant: str | Variant,
    levels: Levels,
    *,
    batch: int = 256,
    until: Sequence[str] = (),
) -> Iterator[Step]:
    """Play each of `levels` once, `batch` at a time, and yield after every step of all of them.

    levels  numbers, or levels that were drawn, by name; those are numbered from 0 on
    until   events of the game: with the first of them an episode is left, as if it ended there

    What happens in a level depends neither on `batch` nor on the other levels.
    """
    see_policy(policy)
    of_kind("levels", levels, Sized)
    if not len(levels):
        raise ValueError("no levels to play")
    bounded("batch", batch, 1, MOST)
    env = _environments(policy, game, variant, min(batch, len(levels)))
    unknown = [event for event in until if event not in env.game.events]
    if unknown:
        there = ", ".join(env.game.events)
        raise ValueError(f"unknown event {unknown[0]!r} of {env.game.name}; there are: {there}")
    option, begin = beginnings(levels, env.game.state)
    playing = np.arange(env.num_envs)  # which of the levels each environment plays
    following, live = env.num_envs, np.ones(env.num_envs, bool)
    observations, _ = env.reset(seed=0, options={option: begin[playing]})
    while True:
        before, actions = env.get_state(), policy.actions(env, observations)
        seen, rewards, terminated, truncated, _ = env.step(actions)
        ended = terminated | truncated
        for event in until:
            ended |= env.states[event] >= 0
        which = slice(None) if live.all() else live
        yield Step(
            playing[which].copy(),
            before[which],
            observations[which],
            actions[which],
            rewards[which],
            env.states[which],
            seen[which],
            terminated[which],
            ended[which],
        )
        observations = seen
        if not ended.any():
            continue
        for i in np.flatnonzero(ended & live):
            live[i] = following < len(begin)  # else it plays its level again, unseen
            playing[i] = following if live[i] else playing[i]
            following += live[i]
        if not live.any():
            break
        observations, _ = env.reset(options={option: begin[playing], "reset_mask": ended})
        if 2 * live.sum() <= len(live):  # fewer go on, as who sees images takes time for each
            states, playing = env.get_state()[live], playing[live]
            env.close()
            env, live = _environments(policy, game, variant, len(playing)), live[live]
            observations = env.set_state(states)
    env.close()


def initial_states(game: str | Game, variant: str | Variant, levels: Levels) -> np.recarray:
    """The states that `levels` begin in, [N]."""
    of_kind("levels", levels, Sized)
    if not len(levels):
        raise ValueError("no levels to begin")
    shown = "symbolic" if games.find(game).symbols else "image"  # symbols take less time
    env = GameVectorEnv(game, variant, min(CHUNK, len(levels)), observation=shown)
    option, begin = beginnings(levels, env.game.state)
    found = []
    for first in range(0, len(begin), env.num_envs):
        some = np.arange(first, first + env.num_envs) % len(begin)
        env.reset(seed=0, options={option: begin[some]})
        found.append(env.get_state()[: len(begin) - first])
    env.close()
    return np.concatenate(found).view(np.recarray)


def beginnings(levels: Levels, dtype: np.dtype) -> tuple[str, np.ndarray]:
    """The option of a reset that begins each of `levels`, and its values."""
    if not isinstance(levels, Mapping):
        return "level", level_numbers(levels)
    for level in levels.values():
        of_kind("a level by name", level, Level)
        if level.game.state != dtype:
            raise ValueError(f"levels must be of one game; one is of {level.game.name}")
    states = np.array([level.state(solvable=False) for level in levels.values()], dtype)
    states["level"] = np.arange(len(states))
    return "state", states


def _environments(policy: Policy, game: Any, variant: Any, n: int) -> GameVectorEnv:
    return GameVectorEnv(
        game, variant, n, observation=policy.observation, art=policy.art, autoreset_mode="Disabled"
    )
