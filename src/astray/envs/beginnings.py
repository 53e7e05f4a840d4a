"""Environments whose levels are given, and the initial states of levels."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from astray import games
from astray.envs.vector import GameVectorEnv, quickest
from astray.envs.worlds import WorldVectorEnv
from astray.game import OWN, Game, Variant
from astray.level import Level
from astray.record import level_numbers
from astray.validation import of_kind
from astray.world import World

Levels = Sequence[int] | np.ndarray | range | Mapping[str, Level]
CHUNK = 1000  # levels begun at once


def without_autoreset(
    game: str | Game | World,
    variant: Any,
    n: int,
    observation: Any,
    art: str = OWN,
    longest: int | None = None,
) -> Any:
    """Return `n` environments of a game or a `World`, in which a reset alone begins an episode."""
    if isinstance(game, World):
        return WorldVectorEnv(game, game.variant(variant), n, longest)
    return GameVectorEnv(
        game, variant, n, observation=observation, art=art, autoreset_mode="Disabled"
    )


def initial_states(game: str | Game, variant: str | Variant, levels: Levels) -> np.recarray:
    """Return the initial states [N] of `levels`.

    Raises:
        ValueError: If a level number or a drawn level is invalid.
    """
    return np.concatenate([*in_chunks(game, variant, levels)]).view(np.recarray)


def in_chunks(game: str | Game, variant: str | Variant, levels: Levels) -> Iterator[np.recarray]:
    """Yield the initial states of `levels`, CHUNK at a time, so that memory does not grow.

    Raises:
        ValueError: If a level number or a drawn level is invalid.
    """
    rules = games.find(game)
    option, begin = beginnings(levels, rules.state)
    env = GameVectorEnv(rules, variant, min(CHUNK, len(begin)), observation=quickest(rules))
    for first in range(0, len(begin), env.num_envs):
        some = np.arange(first, first + env.num_envs) % len(begin)
        env.reset(seed=0, options={option: begin[some]})
        yield env.get_state()[: len(begin) - first].view(np.recarray)
    env.close()


def beginnings(levels: Levels, dtype: np.dtype) -> tuple[str, np.ndarray]:
    """Return the reset option that begins each of `levels`, and its values [N].

    Raises:
        ValueError: If a level number or a drawn level is invalid.
    """
    if not isinstance(levels, Mapping) or not levels:
        return "level", level_numbers(levels)
    for level in levels.values():
        of_kind("a level by name", level, Level)
        if level.game.state != dtype:
            raise ValueError(f"levels must be of one game; one is of {level.game.name}")
    states = np.array([level.state(solvable=False) for level in levels.values()], dtype)
    states["level"] = np.arange(len(states))
    return "state", states
