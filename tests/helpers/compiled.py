"""Compile what most tests ask for, while linters keep another core busy: python -m helpers.compiled

Of two processes that compile a game one waits for the other, as would the workers of the tests.
"""

import numpy as np

from astray import games
from astray.art import original
from astray.envs.compiled import compiled_loop
from astray.envs.vector import GameVectorEnv
from astray.game import OWN
from astray.training.fast import fused, sparse


def main() -> None:
    arts = (OWN, *(() if set(original.missing()) - set(original.FORK_ALONE) else ("original",)))
    for name in games.OWN:
        game = games.find(name)
        for art in arts:
            if art in game.looks:
                compiled_loop(game, art)
        env = GameVectorEnv(game, game.benchmark.variant, observation="symbolic")
        env.reset(seed=0)
        for goal in game.event_goals:
            game.solver.optimal_return(env.states[0], goal, 0.9)
        if game.mutation:
            seeds = np.zeros(1, np.uint32)
            game.mutation.mutate(env.get_state(), env.variant, seeds, 1, "constant")
    fused.ensure_compiled()
    sparse.ensure_compiled()


if __name__ == "__main__":
    main()
