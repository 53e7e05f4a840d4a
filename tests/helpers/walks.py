"""An environment that is walked about in, also by processes of their own."""

import numpy as np

from astray.envs.vector import GameVectorEnv

STEPS = 50


def walk(env, seed=3):
    """All that an environment shows in some steps, as bytes."""
    first, _ = env.reset(seed=seed)
    actions = np.random.default_rng(seed).integers(
        len(env.game.actions), size=(STEPS, env.num_envs)
    )
    return first.tobytes() + b"".join(env.step(action)[0].tobytes() for action in actions)


def made(threads=2):
    return GameVectorEnv("maze", "anywhere", 8, threads=threads, autoreset_mode="SameStep")


def walk_and_send(pipe, env):
    pipe.send_bytes(walk(env or made()))
    pipe.close()
