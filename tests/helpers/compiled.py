"""Compile what most tests ask for, on two cores: python -m helpers.compiled games, then rest

Games need astray's core alone; the rest imports more.
Of two processes that compile one game one waits for the other, as would the workers of the tests;
and each of these would compile the rules of pages for itself.
"""

import gc
import sys
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

import numpy as np

from astray import games
from astray.art import original
from astray.envs.compiled import compiled_loop
from astray.envs.vector import GameVectorEnv
from astray.game import OWN

INTERPRETED = "heist", "keys"  # which `make test` draws as the original without compiling that


def main(what: str) -> None:
    # Garbage is looked for less often, which saves a twentieth.
    how = {"initializer": gc.set_threshold, "initargs": (100_000,)}
    with ProcessPoolExecutor(2, get_context("spawn"), **how) as pool:
        part = compile_game if what == "games" else compile_rest_of_game
        begun = [pool.submit(part, name) for name in games.OWN]
        if what != "games":
            begun.append(pool.submit(compile_losses))
        for one in begun:
            one.result()


def compile_game(name: str) -> None:
    """Compile a game, its solver and its mutation, which the core does."""
    game = games.find(name)
    compiled_loop(game, OWN)
    env = GameVectorEnv(game, game.benchmark.variant, observation="symbolic")
    env.reset(seed=0)
    for goal in game.event_goals:
        game.solver.optimal_return(env.states[0], goal, 0.9)
    if game.mutation:
        seeds = np.zeros(1, np.uint32)
        game.mutation.mutate(env.get_state(), env.variant, seeds, 1, "constant")


def compile_rest_of_game(name: str) -> None:
    """Compile a game's rules for pages, and the game with the original's art, if that is there."""
    from astray.lab import rules

    game = games.find(name)
    rules.module(game)
    missing = set(original.missing()) - set(original.FORK_ALONE)
    if "original" in game.looks and name not in INTERPRETED and not missing:
        compiled_loop(game, "original")


def compile_losses() -> None:
    """Compile the losses of training, the sparse layer, and what all pages call."""
    import torch

    from astray.agents.mlp import MLP
    from astray.lab import rules
    from astray.training.fast import fused, sparse
    from astray.training.ppo import Samples

    planes, one = torch.ones((1, 1, 1, 1), dtype=torch.uint8), torch.ones(1)
    batch = Samples(planes, torch.zeros(1, dtype=torch.int64), one, one, one, one)
    for between in (torch.float32, torch.bfloat16):
        outputs = sparse.outputs(MLP((1, 1, 1), [1], 2), planes, between)
        loss, _ = fused.loss(outputs, batch, (0.2, 0.5, 0.01))
        loss.backward()
    rules.shared()


if __name__ == "__main__":
    main(sys.argv[1])
