"""The critic's values and the policy along episodes, and in edited states.

    rows, states = visit(agent, "coin-anywhere", range(200_000, 201_000), per_episode=5,
                         measures={"stage": measures.stage, "coin": measures.coin_in_view})
    bars = group_means(rows, "value", ["stage", "coin"])
    pairs = counterfactual(agent, "coin-anywhere", states, edits.without_coin)

Values have the unit of the training's rewards: with `normalise_reward`, standard deviations of
returns, as in the paper. An agent with memory remembers its episode in `visit`; elsewhere it is
asked as at the beginning of one.
"""

import heapq
from collections.abc import Callable, Mapping
from functools import partial
from itertools import accumulate
from typing import Any

import numpy as np
import polars as pl

from astray.acting import Asking, Levels, steps
from astray.analysis.evaluate import Measure, check_measures, measured
from astray.analysis.policies import episode_noise
from astray.analysis.trained import Agent, Model, Opaque, check_network
from astray.envs.beginnings import without_autoreset
from astray.envs.restarting import as_seen
from astray.envs.vector import GameVectorEnv
from astray.game import Variant
from astray.record import count_levels
from astray.validation import MOST, bounded, finite, of_kind
from astray.world import SEEN, World, find

STEP_SALT = 2**33  # no agent has this seed, or a larger one

Edit = Callable[[np.ndarray], np.ndarray]  # states [N] -> edited copies [N]


def visit(
    agent: Model,
    variant: str | Variant,
    levels: Levels,
    *,
    per_episode: int | None = None,
    gamma: float | None = None,
    measures: Mapping[str, Measure] | None = None,
    seed: int = 0,
    batch: int = 256,
    longest: int | None = None,
) -> tuple[pl.DataFrame, np.ndarray]:
    """Return a table with a row per step of the agent's episodes, and the states [rows].

    Columns: level, step, value (of the state before the step), action, reward, and the measures.
    Rows are in the order of `levels`, then of steps, and do not depend on `batch`.

    Args:
        levels: Level numbers, or drawn levels by name, which are numbered from 0.
        per_episode: Most steps per episode, drawn with `seed`; None for all. One takes up to 17 kB.
        gamma: Discount of a further column "future", the return from the step on.
        measures: Further columns, functions of the states.
        longest: Steps after which an episode is truncated; None for no limit.

    Raises:
        ValueError: If an argument is invalid.
    """
    check_network(agent)
    count = count_levels(levels)
    if per_episode is not None:
        bounded("per_episode", per_episode, 1, MOST)
    bounded("seed", seed, 0, MOST)
    if gamma is not None:
        finite("gamma", gamma, 0, 1)
    heaps: list[list[tuple]] = [[] for _ in range(count)]  # (-noise, step, state, action, reward)
    limit = np.full(count, np.inf)  # the steps with the least noise are kept
    rewards: list[list[float]] = [[] for _ in levels]
    shown: dict[int, list[np.ndarray]] = {}  # to an agent with memory; its values are `along` them
    along: dict[int, np.ndarray] = {}
    found: Any = find(agent.game)
    world = found.in_every_step if isinstance(found, World) else None
    game = world or found
    trained = agent.trained if world and isinstance(agent, Agent) else None
    for step in steps(agent, game, variant, levels, batch=batch, longest=longest):
        seen = step.observations
        if trained is not None:  # a World's agent sees these as in its training
            seen = as_seen(trained, "symbolic", seen)
        before = world.shown(step.before, seen) if world else step.before
        for k, level in enumerate(step.level):
            rewards[level].append(float(step.rewards[k]))
            if agent.caveat:
                shown.setdefault(level, []).append(seen[k].copy())
                if step.ended[k]:
                    whole = np.stack(shown.pop(level))
                    along[level] = policy_and_value(agent, whole, episode=True)[1]
        noise = episode_noise(seed, step.before, 1, STEP_SALT)
        for i in np.flatnonzero(noise[:, 0] < limit[step.level]):
            heap, one = heaps[step.level[i]], slice(i, i + 1)
            state = before[one].copy()
            row = -noise[i], state["time"], state, step.actions[one], step.rewards[one]
            (heapq.heappushpop if len(heap) == per_episode else heapq.heappush)(heap, row)
            if len(heap) == per_episode:
                limit[step.level[i]] = -heap[0][0][0]
    rows = [row for heap in heaps for row in sorted(heap, key=lambda row: row[1])]
    *_, states, action, reward = (np.concatenate(column) for column in zip(*rows, strict=True))
    states = states.view(np.recarray)
    for name in {"seed", "turn"} & {*(states.dtype.names or ())} if world is None else ():
        states[name] = 0  # about later levels, which depend on the batch; of a World, a measure
    kept = [sorted(int(row[1][0]) for row in heap) for heap in heaps]  # steps
    if agent.caveat:
        value = np.concatenate([along[level][where] for level, where in enumerate(kept)])
    else:
        value = policy_and_value(agent, observe(agent, variant, states))[1]
    columns = {"value": value, "action": action, "reward": reward}
    if gamma is not None:
        futures = []
        for where, one in zip(kept, rewards, strict=True):
            sums = [*accumulate(reversed(one), lambda after, reward: reward + gamma * after)]
            futures += [sums[-1 - step] for step in where]
        columns["future"] = np.array(futures)
    return _table(states, columns, measures), states


def counterfactual(
    agent: Model,
    variant: str | Variant,
    states: np.ndarray,
    edit: Edit,
    *,
    measures: Mapping[str, Measure] | None = None,
) -> pl.DataFrame:
    """Compare values and policy in states [N] with those in edited states, one row each.

    Columns: level, step, value and value_edited; change, of the value; seen, whether the edit
    changes the observation; policy and policy_edited, probabilities [A]; policy_change, their
    total variation distance (0 to 1); and the measures of the states before the edit.

    Raises:
        ValueError: If `edit` does not return as many states.
    """
    shown, edited = observe(agent, variant, states), observe(agent, variant, _edited(states, edit))
    policy, value = policy_and_value(agent, shown)
    policy_edited, value_edited = policy_and_value(agent, edited)
    columns = {
        "value": value,
        "value_edited": value_edited,
        "change": value_edited - value,
        "seen": (shown != edited).reshape(len(shown), -1).any(1),
        "policy": policy,
        "policy_edited": policy_edited,
        "policy_change": abs(policy_edited - policy).sum(1) / 2,
    }
    return _table(states, columns, measures)


def sees(agent: Model, variant: str | Variant, edit: Edit) -> Measure:
    """Return the measure of whether `edit` changes the observation; it may raise ValueError."""

    def seen(states: np.ndarray) -> np.ndarray:
        edited = observe(agent, variant, _edited(states, edit))
        return (observe(agent, variant, states) != edited).reshape(len(states), -1).any(1)

    return seen


def policy_and_value(
    agent: Model, observations: np.ndarray, *, episode: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return action probabilities [N, A] and values [N], float64, for `observations` [N, ...].

    Args:
        episode: Whether these are all observations of one episode from its first step on; an agent
            with memory then remembers the earlier ones.
    """
    logits, values = agent.outputs(observations, episode=episode)
    return logits.double().softmax(-1).numpy(force=True), values.double().numpy(force=True)


def ask(
    agent: Model | Opaque, variant: str | Variant, states: np.ndarray, *, episode: bool = False
) -> tuple[np.ndarray, np.ndarray]:
    """Return action probabilities [N, A] and values [N] of any policy in `states` [N].

    A policy without a network has probability 1 for the action that it takes, and values NaN.

    Args:
        episode: As in `policy_and_value`.

    Raises:
        ValueError: If the states are not those of the agent's game.
    """
    if isinstance(agent, Opaque):
        chances = partial(agent.chances, asking=Asking(agent) if episode else None)
        policy = _each(agent, variant, states, 1 if episode else 64, chances)
        return policy, np.full(len(states), np.nan)
    return policy_and_value(agent, observe(agent, variant, states), episode=episode)


def observe(
    agent: Model | Opaque, variant: str | Variant, states: np.ndarray, *, batch: int = 64
) -> np.ndarray:
    """Return the agent's observations of `states` [N]: [N, 64, 64, 3] or [N, C, H, W] uint8.

    Raises:
        ValueError: If the states are not those of the agent's game.
    """
    of_kind("agent", agent, Model | Opaque)
    return _each(agent, variant, states, batch, lambda env, seen: seen)


def _each(
    agent: Model | Opaque,
    variant: str | Variant,
    states: np.ndarray,
    batch: int,
    told: Callable[[GameVectorEnv, np.ndarray], np.ndarray],
) -> np.ndarray:
    """Return the results [N, ...] of `told` in states [N], given observations and environments."""
    of_kind("states", states, np.ndarray)
    if not np.size(states):
        raise ValueError("no states are given")
    bounded("batch", batch, 1, MOST)
    if isinstance(game := find(agent.game), World):
        game.check(states, variant)
        return states[SEEN]
    n = min(batch, len(states))
    env = without_autoreset(agent.game, variant, n, agent.observation, agent.art)
    shown = np.concatenate(
        [
            told(env, env.set_state(states[np.arange(first, first + n) % len(states)]))
            for first in range(0, len(states), n)
        ]
    )
    env.close()
    return shown[: len(states)]


def _edited(states: np.ndarray, edit: Edit) -> np.ndarray:
    of_kind("states", states, np.ndarray)
    of_kind("edit", edit, Callable)
    edited = edit(states.copy())
    of_kind("what an edit returns", edited, np.ndarray)
    if edited.shape != states.shape or edited.dtype != states.dtype:
        raise ValueError(f"an edit returns as many states as it is given, {len(states)}")
    return edited


def _table(
    states: np.ndarray, columns: dict[str, np.ndarray], measures: Mapping[str, Measure] | None
) -> pl.DataFrame:
    """Return `columns` with the states' levels, steps and measures."""
    told = {"level": states["level"], "step": states["time"]} | columns
    check_measures(measures, told)
    return pl.DataFrame(told | {n: measured(n, m, states) for n, m in (measures or {}).items()})
