"""The environments that a training plays in, of a game or a `World`."""

import contextlib
from typing import Any

import numpy as np
from gymnasium import Space

from astray.acting import Answer
from astray.envs.restarting import Restarting
from astray.envs.steps import Step
from astray.envs.vector import GameVectorEnv
from astray.envs.worlds import WorldVectorEnv
from astray.training.config import Config
from astray.world import WorldVariant


def environments(config: Config, variant: Any, n: int, levels: range) -> Any:
    """Return `n` environments of a variant, of a game or a `World`, that draw from `levels`."""
    if isinstance(variant, WorldVariant):
        game: Any = config.find_game()
        game = game.in_every_step if config.reward else game
        made = Restarting(game, variant, n, levels, config.observation)
        if str(variant) != str(config.training_variant()):
            made.trained = shown_in_training(config)
        return made
    return GameVectorEnv(
        config.game,
        variant,
        n,
        observation=config.observation,
        art=config.art,
        levels=levels,
        autoreset_mode="SameStep",
        threads=config.threads,
    )


def shown_in_training(config: Config) -> Space:
    """Return the space of observations in a training in a `World`, whose bounds scale integers."""
    game, variant = config.find_game(), config.training_variant()
    with contextlib.closing(WorldVectorEnv(game, variant, 1)) as env:  # pyrefly: ignore
        return env.single_observation_space


def whole_step(
    env: Any, before: tuple[np.ndarray, np.ndarray], answer: Answer, taken: tuple[Any, ...]
) -> Step:
    """Return a step in the form of evaluation, with the final states of restarted episodes.

    Args:
        env: Environments after the step.
        before: States [n] and observations [n, ...] before it.
        answer: The actor's answer.
        taken: Result of `env.step`.
    """
    seen, reward, terminated, truncated, info = taken
    (states, observations), after, ended = before, env.get_state(), terminated | truncated
    if ended.any():
        seen = seen.copy()
        after[ended], seen[ended] = env.final_states[ended], np.stack(info["final_obs"][ended])
    own = env.actions[answer.actions] if isinstance(env, Restarting) else answer.actions
    return Step(
        states["level"],
        states,
        observations,
        own,
        reward,
        after.view(np.recarray),
        seen,
        terminated,
        ended,
        answer.extra,
    )
